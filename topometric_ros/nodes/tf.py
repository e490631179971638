"""`/tf` and `/tf_static` without tf2_ros: transforms in, into the runtime's buffer, and out."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Quaternion, TransformStamped, Vector3
from numpy.typing import NDArray
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from tf2_msgs.msg import TFMessage

from topometric_ros.nodes import qos


def listen(node: Node, receive: Callable[[TFMessage, bool], None]) -> None:
    """Call `receive(message, is_static)` for everything on `/tf` and `/tf_static`.

    Both names can be remapped, for robots that keep a tree of their own (``-r /tf:=tf``).
    """
    node.create_subscription(TFMessage, "/tf", lambda m: receive(m, False), qos.TRANSFORMS)
    node.create_subscription(
        TFMessage, "/tf_static", lambda m: receive(m, True), qos.STATIC_TRANSFORMS
    )


class TransformBroadcaster:
    """Publishes transforms on dynamic `/tf`; what is no longer published ages out by itself."""

    def __init__(self, node: Node) -> None:
        self._publisher = node.create_publisher(TFMessage, "/tf", qos.TRANSFORMS)

    def send(self, transforms: Iterable[tuple[str, str, NDArray[np.float64]]], stamp: Time) -> None:
        """Publish `(target, source, T_target_source)`; nothing at all where there is none."""
        message = TFMessage(transforms=[to_message(*entry, stamp) for entry in transforms])
        if message.transforms:
            self._publisher.publish(message)


def to_message(
    target: str, source: str, T_target_source: NDArray[np.float64], stamp: Time
) -> TransformStamped:
    """Return a transform as geometry_msgs/TransformStamped: parent `target`, child `source`."""
    message = TransformStamped(child_frame_id=source)
    message.header.frame_id = target
    message.header.stamp = stamp
    x, y, z = T_target_source[:3, 3].tolist()
    message.transform.translation = Vector3(x=x, y=y, z=z)
    qx, qy, qz, qw = Rotation.from_matrix(T_target_source[:3, :3]).as_quat().tolist()
    message.transform.rotation = Quaternion(x=qx, y=qy, z=qz, w=qw)
    return message
