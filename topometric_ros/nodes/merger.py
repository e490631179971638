"""The `merger` node: topometric maps in, one global map out. It converts, publishes and reports."""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from nav_msgs.msg import OccupancyGrid
from numpy.typing import NDArray
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2
from topometric_msgs.msg import AlignmentArray
from topometric_msgs.msg import TopometricMap as MapMessage
from visualization_msgs.msg import MarkerArray

from topometric_ros.alignment import MergeResult
from topometric_ros.errors import TopometricError
from topometric_ros.fusion.config import MergeConfig, merge_preset
from topometric_ros.nodes import parameters, qos, tf
from topometric_ros.nodes.agent_names import parse_agents
from topometric_ros.nodes.config import MergerNodeConfig
from topometric_ros.nodes.diagnostics import to_message
from topometric_ros.nodes.grids import GridError, storey_grid
from topometric_ros.nodes.markers import map_markers
from topometric_ros.nodes.merger_report import InputReport, MergerReport
from topometric_ros.nodes.merger_services import serve
from topometric_ros.nodes.merger_state import StateKeeper
from topometric_ros.nodes.messages import message_classes
from topometric_ros.nodes.running import TopometricNode, describe_failure, log_to, run
from topometric_ros.nodes.worker import Inbox, Worker
from topometric_ros.runtime.alignment_codec import alignments_to_message
from topometric_ros.runtime.cloud_message import map_cloud
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.frames import published_frames, transforms_message
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.message_codec import map_from_message, map_to_message
from topometric_ros.topometric_map import TopometricMap

_PACE_S = 0.2
_REPORT_S = 1.0
_END_S = 3.0

_CHANGEABLE_OF_NODE = ("max_rate", "grid_storey")


class Merger(TopometricNode):
    """A fleet's merger: a :class:`MergerSession` with topics and services around it.

    Subscriptions only fill the inboxes; `session` belongs to whoever holds `working`, the worker's
    thread or a service's.
    """

    def __init__(self) -> None:
        super().__init__("merger", automatically_declare_parameters_from_overrides=True)
        log_to(self)
        self._own, self._wanted = self._declare_parameters()
        self.agents = parse_agents(self._own.agents)
        self.session = MergerSession(self._wanted, tuple(self.agents))
        self._classes = message_classes()
        self.inboxes: dict[str, Inbox[MapMessage]] = {}
        self.report = MergerReport()
        self.working = threading.Lock()
        self.fresh = False
        self._last_merge = -float("inf")
        self._grid_failure = ""
        self._placed: dict[str, NDArray[np.float64]] = {}
        self._frames: dict[str, str] = {}
        self._worker = Worker(self._work, self.failed)
        self._keeper = StateKeeper(self._own.state_file, self.get_logger())
        self._keeper.restore(self.session)
        self.fresh = bool(self.session.maps)
        self._connect()
        serve(self)
        self.get_logger().info(f"merger of {', '.join(self.agents)}")

    def _declare_parameters(self) -> tuple[MergerNodeConfig, MergeConfig]:
        preset = parameters.override(self, "preset", "default")
        configs = (MergerNodeConfig(), merge_preset(preset))
        of_node = {info.name for info in parameters.infos(configs[:1])}
        fixed = of_node - set(_CHANGEABLE_OF_NODE) | {"global_frame"}
        configs = parameters.declare(self, configs, fixed)
        parameters.on_change(self, configs, self._change)
        return configs

    def _connect(self) -> None:
        for agent, namespace in self.agents.items():
            topic = f"{namespace}/topometric_map"
            self.inboxes[agent] = Inbox(1)
            self.report.inputs[agent] = InputReport(self.resolve_topic_name(topic))
            receive = self.inboxes[agent].put
            self.create_subscription(MapMessage, topic, receive, qos.SNAPSHOT)
        self._maps = self.create_publisher(MapMessage, "global_map", qos.SNAPSHOT)
        self._cloud = self.create_publisher(PointCloud2, "global_cloud", qos.SNAPSHOT)
        self._grid = self.create_publisher(OccupancyGrid, "global_grid", qos.SNAPSHOT)
        self._alignments = self.create_publisher(AlignmentArray, "alignments", qos.SNAPSHOT)
        self._markers = self.create_publisher(MarkerArray, "global_markers", qos.SNAPSHOT)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        self._transforms = tf.create_publisher(self)
        self.every(_PACE_S, self._tick)
        self.create_timer(1.0 / self._own.tf_rate, self._publish_transforms)
        self.every(_REPORT_S, self._publish_diagnostics)

    def close(self) -> bool:
        """Stop working; return False where a merge would not end in time."""
        return self._worker.stop(_END_S)

    def _change(self, configs: parameters.Configs) -> None:
        self._own, self._wanted = configs

    def _tick(self) -> None:
        if self.fresh or any(map(len, self.inboxes.values())):
            self._worker.wake()

    def _work(self) -> None:
        """Take in what has arrived and, when it is time, merge and publish."""
        with self.working:
            self.take_in()
            due = time.monotonic() - self._last_merge >= 1.0 / self._own.max_rate
            if self.fresh and due:
                self.merge()

    def take_in(self) -> None:
        for agent, inbox in self.inboxes.items():
            for message in inbox.take_all():
                self._take_map(agent, message)
        self.place()

    def _take_map(self, agent: str, message: MapMessage) -> None:
        """Give a map to the session, or refuse it with one line in the log."""
        entry = self.report.inputs[agent]
        entry.received += 1
        try:
            m = map_from_message(message).map
            self._require_agent(agent, m)
            is_new = self.session.add_map(m, entry.topic)
        except TopometricError as error:
            if entry.refuse(str(error)):
                self.get_logger().error(f"map on {entry.topic} refused: {error}")
            return
        entry.refusal = ""
        if is_new:
            entry.newest, entry.arrived = m, self.get_clock().now().nanoseconds
            self.fresh = True

    def _require_agent(self, agent: str, m: TopometricMap) -> None:
        """Refuse a map that claims to be of an agent whose maps come on another topic."""
        if m.agent == agent:
            return
        entries = self.report.inputs.items()
        heard = {entry.newest.agent for name, entry in entries if name != agent and entry.newest}
        if m.agent in heard or m.agent in self.agents:
            raise SessionError(f"a map of agent {m.agent!r}, whose maps come on another topic")

    def merge(self) -> None:
        """Merge and publish; raises what the session raises."""
        self.fresh = False
        self._last_merge = time.monotonic()
        self.session.config = self._wanted
        former = self.report.result.alignments if self.report.result else ()
        said = {(x.agents, x.status, x.reason) for x in former}
        result = self.session.merge()
        self.report.result, self.report.failure = result, ""
        for x in result.alignments:
            if (x.agents, x.status, x.reason) not in said:
                self.get_logger().info(f"{' and '.join(x.agents)}: {x.status}: {x.reason}")
        self.place()
        self._publish(result)
        self.remember()

    def remember(self) -> None:
        """Write the state file, if there is one; the caller holds `working`."""
        self.report.unsaved = self._keeper.keep(self.session)

    def _publish(self, result: MergeResult) -> None:
        now = self.get_clock().now()
        fused = result.global_map
        observers = tuple(agent.id for agent in result.agents)
        stamp = Time(nanoseconds=fused.map.stamp).to_msg()
        self._maps.publish(map_to_message(fused.map, self._classes, fused.agents, observers))
        self._cloud.publish(map_cloud(fused.map, self._classes, fused.map.stamp, fused.agents))
        self._markers.publish(map_markers(fused.map, stamp))
        self._publish_grid(fused.map)
        self._alignments.publish(
            alignments_to_message(
                result, self._classes, now.nanoseconds, self.session.maps, self.session.stale
            )
        )

    def _publish_grid(self, m: TopometricMap) -> None:
        try:
            grid = storey_grid(m, self._own.grid_storey, self._wanted.global_frame)
        except GridError as error:
            if str(error) != self._grid_failure:
                self.get_logger().error(str(error))
            self._grid_failure = str(error)
            return
        self._grid_failure = ""
        if grid is not None:
            self._grid.publish(grid)

    def place(self) -> None:
        """Note the transforms to publish: those of agents whose place is known now."""
        own = {agent: m.frame_id for agent, m in self.session.maps.items()}
        frames = published_frames(own, self._wanted.global_frame)
        for agent, frame in frames.items():
            if frame != own[agent] and self._frames.get(agent) != frame:
                self.get_logger().warning(
                    f"{agent}: its map frame's name {own[agent]} is in use already; on /tf it is "
                    f"{frame}"
                )
        self._frames, self._placed = frames, self.session.transforms()

    def _publish_transforms(self) -> None:
        placed, frames = self._placed, self._frames
        if placed:
            now, parent = self.get_clock().now().nanoseconds, self._wanted.global_frame
            known = {agent: T for agent, T in placed.items() if agent in frames}
            message = transforms_message(self._classes, now, parent, known, frames)
            self._transforms.publish(message)

    def failed(self, error: Exception) -> None:
        """Report what went wrong in the worker; the session keeps the result that it had."""
        text = describe_failure(error)
        if text != self.report.failure:
            self.get_logger().error(f"merging failed: {text}")
        self.report.failure = text

    def _publish_diagnostics(self) -> None:
        now = self.get_clock().now()
        statuses = self.report.statuses(self.get_fully_qualified_name(), now.nanoseconds)
        self._diagnostics.publish(to_message(statuses, "merger", now.to_msg()))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the merger until SIGINT or SIGTERM; the process's exit status follows."""
    sys.exit(run(Merger, arguments))


if __name__ == "__main__":
    main()
