"""Message types for bags: those of ROS 2 Jazzy and our own, without a ROS installation."""

from __future__ import annotations

from functools import cache
from types import SimpleNamespace
from typing import Any

from rosbags.interfaces import (
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from topometric_ros.io.schemas import message_definitions

CLOUD_TYPE = "sensor_msgs/msg/PointCloud2"
TRANSFORM_TYPE = "tf2_msgs/msg/TFMessage"
MAP_TYPE = "topometric_msgs/msg/TopometricMap"
ALIGNMENTS_TYPE = "topometric_msgs/msg/AlignmentArray"

_PACKAGES = (
    "builtin_interfaces",
    "geometry_msgs",
    "sensor_msgs",
    "std_msgs",
    "tf2_msgs",
    "topometric_msgs",
    "visualization_msgs",
)


@cache
def typestore() -> Typestore:
    """Return the types of ROS 2 Jazzy and of `topometric_msgs`."""
    store = get_typestore(Stores.ROS2_JAZZY)
    types = {}
    for name, text in message_definitions().items():
        types.update(get_types_from_msg(text, name))
    store.register(types)
    return store


@cache
def message_classes() -> SimpleNamespace:
    """Return rosbags' message classes by bare name, as the runtime's codec wants them."""
    classes: dict[str, Any] = {}
    for name, message_class in typestore().types.items():
        package, _, bare = name.split("/")
        if package in _PACKAGES:
            classes.setdefault(bare, message_class)
    return SimpleNamespace(**classes)


def quality_of_service(*, latched: bool) -> Qos:
    """Return the profile that rosbag2 records of a reliable publisher.

    It is always given explicitly: a player without one falls back to volatile, and a late joiner
    would then miss maps that were published once.
    """
    forever = QosTime(9223372036, 854775807)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1 if latched else 10,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE,
        deadline=forever,
        lifespan=forever,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )
