"""Extract, match and merge topometric maps of indoor environments (see README.md)."""

__version__ = "0.1.0"
