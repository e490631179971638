"""`/tf` and `/tf_static` without tf2_ros."""

from __future__ import annotations

from collections.abc import Callable

from rclpy.node import Node
from rclpy.publisher import Publisher
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


def without_parent(message: TFMessage, frame: str) -> TFMessage:
    """Return the transforms of a message but for those from a child of `frame`."""
    kept = [t for t in message.transforms if t.header.frame_id.lstrip("/") != frame.lstrip("/")]
    return TFMessage(transforms=kept)


def create_publisher(node: Node) -> Publisher:
    """Return a publisher of dynamic transforms.

    They are not static: a static one stays for ever, and a moved one would be ignored by many.
    """
    return node.create_publisher(TFMessage, "/tf", qos.TRANSFORMS)
