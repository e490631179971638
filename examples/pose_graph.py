"""A pose-graph back end in a page: where the agents' map frames are, by all constraints at once.

    python examples/pose_graph.py --ros-args -p anchor:=robot1/map

It knows nothing of topometric_msgs: it reads nav_msgs/Odometry on `constraints`, weighs each by its
covariance, takes it out where that begins with -1, and logs where every frame lies in the anchor.
See docs/pose-graph.md.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rclpy
from nav_msgs.msg import Odometry
from numpy.typing import NDArray
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

Pair = tuple[str, str]
Edge = tuple[NDArray[np.float64], NDArray[np.float64]]
"""`T_a_b` (4, 4) and the upper root of its information (6, 6)."""


def edge_of(message: Odometry) -> tuple[Pair, Edge | None]:
    """Return a constraint's frames, its transform and how much it weighs; None: it is gone."""
    pair = (message.header.frame_id, message.child_frame_id)
    if message.pose.covariance[0] < 0:
        return pair, None
    at, turned = message.pose.pose.position, message.pose.pose.orientation
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat([turned.x, turned.y, turned.z, turned.w]).as_matrix()
    T[:3, 3] = at.x, at.y, at.z
    information = np.linalg.inv(np.array(message.pose.covariance).reshape(6, 6))
    return pair, (T, np.linalg.cholesky(information).T)


def matrix(pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return x, y, z and a rotation vector as a (4, 4) matrix."""
    T = np.eye(4)
    T[:3, 3], T[:3, :3] = pose[:3], Rotation.from_rotvec(pose[3:]).as_matrix()
    return T


def solve(edges: Mapping[Pair, Edge], anchor: str) -> dict[str, NDArray[np.float64]]:
    """Return where every frame that hangs together with the anchor lies in it, (4, 4) each."""
    found = {anchor: np.eye(4)}
    while True:  # the first estimate: along a tree of constraints
        for (a, b), (T, _) in edges.items():
            if a in found and b not in found:
                found[b] = found[a] @ T
            elif b in found and a not in found:
                found[a] = found[b] @ np.linalg.inv(T)
            else:
                continue
            break
        else:
            break
    names = [name for name in found if name != anchor]
    if not names:
        return found
    start = [[*found[n][:3, 3], *Rotation.from_matrix(found[n][:3, :3]).as_rotvec()] for n in names]

    def residuals(flat: NDArray[np.float64]) -> NDArray[np.float64]:
        at = {anchor: np.eye(4)}
        at |= {name: matrix(pose) for name, pose in zip(names, flat.reshape(-1, 6), strict=True)}
        rows = []
        for (a, b), (T, root) in edges.items():
            if a in at and b in at:
                D = np.linalg.inv(at[a]) @ at[b]
                turn = Rotation.from_matrix(D[:3, :3] @ T[:3, :3].T).as_rotvec()
                rows.append(root @ np.concatenate([D[:3, 3] - T[:3, 3], turn]))
        return np.concatenate(rows)

    poses = least_squares(residuals, np.ravel(start), loss="huber").x.reshape(-1, 6)
    return {anchor: np.eye(4), **{n: matrix(p) for n, p in zip(names, poses, strict=True)}}


class PoseGraph(Node):
    """Optimises again after every constraint."""

    def __init__(self) -> None:
        super().__init__("pose_graph")
        self._anchor = str(self.declare_parameter("anchor", "robot1/map").value)
        self._edges: dict[Pair, Edge] = {}
        profile = QoSProfile(depth=500, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.create_subscription(Odometry, "constraints", self._take, profile)

    def _take(self, message: Odometry) -> None:
        pair, edge = edge_of(message)
        if edge is None:
            self._edges.pop(pair, None)
        else:
            self._edges[pair] = edge
        for name, T in solve(self._edges, self._anchor).items():
            yaw = np.degrees(np.arctan2(T[1, 0], T[0, 0]))
            x, y, z = T[:3, 3]
            self.get_logger().info(f"{name}: {x:.3f} {y:.3f} {z:.3f} m, {yaw:.2f} degrees")


if __name__ == "__main__":
    rclpy.init()
    rclpy.spin(PoseGraph())
