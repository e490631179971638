"""The agents' places on /tf: `global_frame` to the map frame of each agent that is placed."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.nodes import tf
from topometric_ros.nodes.messages import message_classes
from topometric_ros.nodes.running import TopometricNode
from topometric_ros.runtime.frames import published_frames, transforms_message
from topometric_ros.runtime.merger_session import MergerSession


class Places:
    """What is known of where agents are, stamped anew as often as :meth:`publish` is called."""

    def __init__(self, node: TopometricNode) -> None:
        self._node = node
        self._classes = message_classes()
        self._transforms = tf.create_publisher(node)
        self._known: tuple[str, dict[str, NDArray[np.float64]], dict[str, str]] = ("", {}, {})

    def note(self, session: MergerSession, global_frame: str) -> None:
        """Note the transforms to publish: those of agents whose place is known now."""
        own = {agent: m.frame_id for agent, m in session.maps.items()}
        frames = published_frames(own, global_frame)
        former = self._known[2]
        for agent, frame in frames.items():
            if frame != own[agent].lstrip("/") and former.get(agent) != frame:
                why = "is in use already" if own[agent] else "is empty"
                self._node.get_logger().warning(
                    f"{agent}: its map frame's name {own[agent]} {why}; on /tf it is {frame}"
                )
        placed = {agent: T for agent, T in session.transforms().items() if agent in frames}
        self._known = (global_frame, placed, frames)

    def publish(self) -> None:
        """Publish them with the present time."""
        parent, placed, frames = self._known
        if placed:
            now = self._node.get_clock().now().nanoseconds
            self._transforms.publish(transforms_message(self._classes, now, parent, placed, frames))
