"""The one exception that every error of this package derives from, and its one line."""

_LONGEST = 300
"""Characters of another library's error that are shown: some hold half a damaged file."""


class TopometricError(Exception):
    """Something a user can act on; the message is one line and carries the offending values.

    The command line prints it and exits with status 2; the nodes log it, add a diagnostics entry
    and keep the state they had.
    """


class ConfigurationError(TopometricError):
    """A parameter has an unknown name, a wrong type or a value outside its range."""


def one_line(error: BaseException) -> str:
    """Return what another library says on one line, cut where it is long; its name if nothing."""
    text = " ".join(str(error).split()) or type(error).__name__
    if isinstance(error, KeyError):
        text = f"{text} is missing"
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]} ..."
