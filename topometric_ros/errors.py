"""The one exception that every error of this package derives from."""


class TopometricError(Exception):
    """Something a user can act on; the message is one line and carries the offending values.

    The command line prints it and exits with status 2; the nodes log it, add a diagnostics entry
    and keep the state they had.
    """


class ConfigurationError(TopometricError):
    """A parameter has an unknown name, a wrong type or a value outside its range."""
