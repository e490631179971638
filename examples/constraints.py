"""Turn the merger's alignments into constraints that any pose-graph back end can read.

    python examples/constraints.py --ros-args -p use_sim_time:=false

Every accepted alignment becomes a nav_msgs/Odometry on `constraints`: the pose of the map frame of
agent b (`child_frame_id`) in that of agent a (`header.frame_id`), with its covariance. It is sent
again only when it changed; one that no longer holds is sent once more with -1 as the first number
of its covariance. A late back end gets what is latched. See docs/pose-graph.md.
"""

from __future__ import annotations

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from scipy.spatial.transform import Rotation
from topometric_msgs.msg import Alignment, AlignmentArray

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
ALL_PAIRS = QoSProfile(depth=500, durability=DurabilityPolicy.TRANSIENT_LOCAL)

Pair = tuple[str, str]
GONE = -1.0
"""In the place of the first variance: take the constraint of these two frames out."""


def constraints(array: AlignmentArray) -> list[Odometry]:
    """Return a constraint for every accepted alignment whose agents' frames are known."""
    frames = {agent.id: agent.frame_id for agent in array.agents}
    found = []
    for x in array.alignments:
        if x.status != Alignment.ACCEPTED or not x.has_covariance:
            continue
        T = np.array(x.t_a_b).reshape(4, 4)
        edge = Odometry(child_frame_id=frames[x.agent_b])
        edge.header.stamp, edge.header.frame_id = array.header.stamp, frames[x.agent_a]
        at, turned = edge.pose.pose.position, edge.pose.pose.orientation
        at.x, at.y, at.z = T[:3, 3].tolist()
        turned.x, turned.y, turned.z, turned.w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
        # Both are over x, y, z and the turns about the fixed axes of frame a, in m and rad.
        edge.pose.covariance = x.covariance
        found.append(edge)
    return found


def updates(sent: dict[Pair, Odometry], edges: list[Odometry]) -> list[Odometry]:
    """Return what is to be sent so that a back end holds just these edges, and note it in `sent`.

    What changed comes first, then what does not hold any more, with a covariance of -1.
    """
    now = {(edge.header.frame_id, edge.child_frame_id): edge for edge in edges}
    changed = [e for pair, e in now.items() if pair not in sent or sent[pair].pose != e.pose]
    gone = [edge for pair, edge in sent.items() if pair not in now]
    sent.clear()
    sent.update(now)
    for edge in gone:
        edge.pose.covariance[0] = GONE
    return [*changed, *gone]


class Constraints(Node):
    """Subscribes `alignments`, publishes `constraints`."""

    def __init__(self) -> None:
        super().__init__("constraints")
        self._sent: dict[Pair, Odometry] = {}
        self._publisher = self.create_publisher(Odometry, "constraints", ALL_PAIRS)
        self.create_subscription(AlignmentArray, "alignments", self._take, LATCHED)

    def _take(self, array: AlignmentArray) -> None:
        for edge in updates(self._sent, constraints(array)):
            self._publisher.publish(edge)


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(Constraints())
