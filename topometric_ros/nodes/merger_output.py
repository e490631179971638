"""What the merger publishes: the fused map in all its forms, and the alignments behind it."""

from __future__ import annotations

from collections import deque
from collections.abc import Hashable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2
from topometric_msgs.msg import AlignmentArray
from topometric_msgs.msg import TopometricMap as MapMessage
from visualization_msgs.msg import MarkerArray

from topometric_ros.alignment import MergeResult, Placed
from topometric_ros.fusion.changes import told
from topometric_ros.nodes import qos
from topometric_ros.nodes.grids import GridError, storey_grid
from topometric_ros.nodes.markers import map_markers
from topometric_ros.nodes.running import TopometricNode
from topometric_ros.runtime.alignment_codec import alignments_to_message
from topometric_ros.runtime.cloud_message import map_cloud
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.merger_state import version_of
from topometric_ros.runtime.message_codec import map_to_message
from topometric_ros.topometric_map import TopometricMap

_OWN_REMEMBERED = 16


@dataclass(frozen=True)
class Shown:
    """What of a session's state a reader would see, to tell what has changed since."""

    maps: Hashable = None
    """Which versions of the agents' maps, whose place is known, and how they are fused."""
    places: Hashable = None
    alignments: Hashable = None

    @classmethod
    def of(cls, session: MergerSession, stale: Sequence[str]) -> Shown:
        """Return what is to be seen of a session now."""
        if session.placed is None:
            return cls()
        agents, found = session.placed.agents, session.placed.alignments
        versions = tuple(
            (agent.id, version_of(session.maps[agent.id]), agent.T_global_agent is not None)
            for agent in agents
            if agent.id in session.maps
        )
        maps = (versions, session.config.fuse)
        places = tuple(agent.T_group_agent.tobytes() for agent in agents)
        verdicts = tuple(
            (x.agents, x.status, x.reason, _bytes(x.T_a_b), _bytes(x.covariance)) for x in found
        )
        return cls(maps, places, (maps, places, verdicts, tuple(stale)))


class MergerOutput:
    """The publishers of a merger's results.

    Parameters
    ----------
    node : the merger
    classes : namespace of message classes
    """

    def __init__(self, node: TopometricNode, classes: Any) -> None:
        self._node = node
        self._classes = classes
        self._maps = node.create_publisher(MapMessage, "global_map", qos.SNAPSHOT)
        self._cloud = node.create_publisher(PointCloud2, "global_cloud", qos.SNAPSHOT)
        self._grid = node.create_publisher(OccupancyGrid, "global_grid", qos.SNAPSHOT)
        self._alignments = node.create_publisher(AlignmentArray, "alignments", qos.SNAPSHOT)
        self._markers = node.create_publisher(MarkerArray, "global_markers", qos.SNAPSHOT)
        self._own: deque[Hashable] = deque(maxlen=_OWN_REMEMBERED)
        self._grid_failure = ""
        self._changes_said: set[Hashable] = set()

    def publish_map(self, result: MergeResult, grid_storey: int) -> tuple[str, ...]:
        """Publish the global map, as message, cloud, markers and grid of a storey.

        Return in words what has changed between the agents' visits; it is logged once a pair.
        """
        fused = result.global_map
        observers = tuple(agent.id for agent in result.agents)
        stamp = Time(nanoseconds=fused.map.stamp).to_msg()
        self._maps.publish(map_to_message(fused.map, self._classes, fused.agents, observers))
        self._cloud.publish(map_cloud(fused.map, self._classes, fused.map.stamp, fused.agents))
        self._markers.publish(map_markers(fused.map, stamp))
        self.publish_grid(result, grid_storey)
        changes = tuple(told(fused.changes, observers))
        for change, line in zip(fused.changes, changes, strict=True):
            pair = (observers[change.holder], observers[change.witness])
            said = (*pair, change.gone, change.ordered)
            if said not in self._changes_said:
                self._node.get_logger().info(line)
            self._changes_said.add(said)
        return changes

    def publish_alignments(
        self,
        placed: Placed,
        maps: Mapping[str, TopometricMap],
        stale: Sequence[str],
        changes: Sequence[str] = (),
    ) -> None:
        """Publish where the agents stand; `maps` are those that the alignments are of.

        What has changed between visits is told with the warnings.
        """
        placed = replace(placed, warnings=(*placed.warnings, *changes))
        now = self._node.get_clock().now().nanoseconds
        message = alignments_to_message(placed, self._classes, now, maps, stale)
        self._own.append(_mark(message))
        self._alignments.publish(message)

    def is_own(self, message: AlignmentArray) -> bool:
        """Whether alignments that were received on the topic are what was published here."""
        return _mark(message) in self._own

    def others_publish(self) -> bool:
        """Whether another merger publishes alignments on the same topic."""
        return bool(self._node.count_publishers(self._alignments.topic_name) > 1)

    def publish_grid(self, result: MergeResult, storey: int) -> None:
        """Publish the grid of one storey, by its id or -1; say where there is none."""
        try:
            grid = storey_grid(result.global_map.map, storey, result.global_frame)
        except GridError as error:
            if str(error) != self._grid_failure:
                self._node.get_logger().error(str(error))
            self._grid_failure = str(error)
            return
        self._grid_failure = ""
        if grid is not None:
            self._grid.publish(grid)


def _bytes(matrix: NDArray[np.float64] | None) -> bytes:
    return b"" if matrix is None else matrix.tobytes()


def _mark(message: AlignmentArray) -> Hashable:
    stamp = (message.header.stamp.sec, message.header.stamp.nanosec)
    agents = tuple((agent.id, agent.session, int(agent.sequence)) for agent in message.agents)
    return stamp, agents, tuple(int(alignment.status) for alignment in message.alignments)
