"""The error that extraction raises."""

from topometric_ros.errors import TopometricError


class ExtractionError(TopometricError):
    """A cloud that no topometric map can be extracted from, such as one without a floor."""
