"""The text of our message definitions, so that bags can be read and written without ROS."""

from __future__ import annotations

from pathlib import Path

from topometric_ros.errors import TopometricError

PACKAGE = "topometric_msgs"

_TOPOMETRIC_ROS = Path(__file__).resolve().parents[1]
_PLACES = (
    _TOPOMETRIC_ROS / "schemas",  # installed: setup.py ships the interface package's texts there
    _TOPOMETRIC_ROS.parent / "msg_schemas" / PACKAGE,  # a source tree
)


class SchemaError(TopometricError):
    """The message definitions that belong to this package are missing."""


def message_definitions() -> dict[str, str]:
    """Return the definitions of all messages of `topometric_msgs`.

    Returns
    -------
    dict from the type's name, such as ``topometric_msgs/msg/Room``, to the text of its .msg file

    Raises
    ------
    SchemaError
        The installation is incomplete.

    Examples
    --------
    >>> "int32 storey" in message_definitions()["topometric_msgs/msg/Room"]
    True
    """
    for place in _PLACES:
        files = sorted((place / "msg").glob("*.msg"))
        if files:
            return {f"{PACKAGE}/msg/{f.stem}": f.read_text(encoding="utf-8") for f in files}
    raise SchemaError(f"no .msg files in {' or '.join(str(place) for place in _PLACES)}")
