"""The message classes of rclpy, under the names by which the runtime's codec knows them."""

from __future__ import annotations

from types import SimpleNamespace

import builtin_interfaces.msg
import geometry_msgs.msg
import sensor_msgs.msg
import std_msgs.msg
import tf2_msgs.msg
import topometric_msgs.msg
import visualization_msgs.msg

_PACKAGES = (
    builtin_interfaces.msg,
    geometry_msgs.msg,
    sensor_msgs.msg,
    std_msgs.msg,
    tf2_msgs.msg,
    topometric_msgs.msg,
    visualization_msgs.msg,
)


def message_classes() -> SimpleNamespace:
    """Return every message class that a node reads or writes, by its bare name."""
    classes: dict[str, type] = {}
    for package in _PACKAGES:
        for name in dir(package):
            if not name.startswith("_"):
                classes.setdefault(name, getattr(package, name))
    return SimpleNamespace(**classes)
