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
from topometric_ros.nodes.merger_report import MergerReport
from topometric_ros.nodes.merger_services import serve
from topometric_ros.nodes.merger_state import StateKeeper
from topometric_ros.nodes.messages import message_classes
from topometric_ros.nodes.roster import Roster
from topometric_ros.nodes.running import TopometricNode, describe_failure, log_to, run
from topometric_ros.nodes.worker import Inbox, Worker
from topometric_ros.runtime.alignment_codec import alignments_to_message, offers_from_message
from topometric_ros.runtime.cloud_message import map_cloud
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.frames import published_frames, transforms_message
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.message_codec import ReceivedMap, map_from_message, map_to_message
from topometric_ros.topometric_map import TopometricMap

_PACE_S = 0.2
_REPORT_S = 1.0

_CHANGEABLE_OF_NODE = (
    "max_rate",
    "grid_storey",
    "stale_after",
    "forget_after",
    "max_voxels",
    "max_threads",
)


class Merger(TopometricNode):
    """A fleet's merger: a :class:`MergerSession` with topics and services around it.

    Subscriptions only fill the inboxes; `session` belongs to whoever holds `working`, the worker's
    thread or a service's.
    """

    def __init__(self) -> None:
        super().__init__("merger", automatically_declare_parameters_from_overrides=True)
        log_to(self)
        self._own, self._wanted = self._declare_parameters()
        self._listed = parse_agents(self._own.agents)
        self._classes = message_classes()
        self.working = threading.Lock()

    def _set_up(self) -> None:
        discover = self._own.discover or not self._listed
        self.roster = Roster(self, self._listed, discover)
        self.report = MergerReport(self.roster.reports)
        self.session = MergerSession(self._wanted, tuple(self._listed), self._own.max_threads)
        self.fresh = False
        self._last_merge = -float("inf")
        self._grid_failure = ""
        self._placed: dict[str, NDArray[np.float64]] = {}
        self._frames: dict[str, str] = {}
        self._stale: tuple[str, ...] = ()
        self._others: Inbox[AlignmentArray] = Inbox(1)
        self._keeper = StateKeeper(self._own.state_file, self.get_logger())
        self._keeper.restore(self.session)
        self.fresh = bool(self.session.maps)
        for topic in self.session.sources.values():
            self.roster.recall(topic)
        self._maps = self.create_publisher(MapMessage, "global_map", qos.SNAPSHOT)
        self._cloud = self.create_publisher(PointCloud2, "global_cloud", qos.SNAPSHOT)
        self._grid = self.create_publisher(OccupancyGrid, "global_grid", qos.SNAPSHOT)
        self._alignments = self.create_publisher(AlignmentArray, "alignments", qos.SNAPSHOT)
        self._markers = self.create_publisher(MarkerArray, "global_markers", qos.SNAPSHOT)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        self._transforms = tf.create_publisher(self)
        listed = ", ".join(self._listed) or "every agent that is found"
        self.get_logger().info(f"merger of {listed}")

    def _declare_parameters(self) -> tuple[MergerNodeConfig, MergeConfig]:
        preset = parameters.override(self, "preset", "default")
        configs = (MergerNodeConfig(), merge_preset(preset))
        of_node = {info.name for info in parameters.infos(configs[:1])}
        fixed = of_node - set(_CHANGEABLE_OF_NODE) | {"global_frame"}
        configs = parameters.declare(self, configs, fixed)
        parameters.on_change(self, configs, self._change)
        return configs

    def _begin(self) -> None:
        self._worker = Worker(self._work, self.failed)
        if self._own.adopt:
            name = self.resolve_topic_name("alignments")
            self.create_subscription(AlignmentArray, name, self._others.put, qos.SNAPSHOT)
        self.roster.listen()
        serve(self)
        self.every(_PACE_S, self._tick)
        self.create_timer(1.0 / self._own.tf_rate, self._publish_transforms)
        self.every(_REPORT_S, self._look)

    def _stop_work(self, limit_s: float) -> bool:
        return self._worker.stop(limit_s)

    def _change(self, configs: parameters.Configs) -> None:
        self._own, self._wanted = configs

    def _tick(self) -> None:
        if self.fresh or any(map(len, self.roster.inboxes.values())):
            self._worker.wake()

    def _work(self) -> None:
        """Take in what has arrived and, when it is time, merge and publish."""
        with self.working:
            self.take_in()
            self._mark_gone()
            due = time.monotonic() - self._last_merge >= 1.0 / self._own.max_rate
            if self.fresh and due:
                self.merge()

    def take_in(self) -> None:
        """Take the maps that have arrived, and what another merger says of them."""
        for agent, inbox in list(self.roster.inboxes.items()):
            for message in inbox.take_all():
                self._take_map(agent, message)
        for message in self._others.take_all():
            self._take_alignments(message)
        self.place()

    def _take_map(self, agent: str, message: MapMessage) -> None:
        """Give a map to the session, or refuse it with one line in the log."""
        entry = self.roster.reports[agent]
        entry.received += 1
        try:
            received = map_from_message(message, self._own.max_voxels)
            m = received.map
            self._require_agent(agent, received)
            is_new = self.session.add_map(m, entry.topic)
        except TopometricError as error:
            if entry.refuse(str(error)):
                self.get_logger().error(f"map on {entry.topic} refused: {error}")
            return
        entry.refusal = ""
        if is_new:
            entry.newest, entry.arrived = m, self.get_clock().now().nanoseconds
            self.fresh = True

    def _take_alignments(self, message: AlignmentArray) -> None:
        try:
            self.session.offer(offers_from_message(message))
        except TopometricError as error:
            self.get_logger().warning(f"alignments of another merger are not used: {error}")

    def _require_agent(self, agent: str, received: ReceivedMap) -> None:
        """Refuse a map of a whole fleet, or of an agent whose maps come on another topic."""
        m = received.map
        if received.observers:
            raise SessionError(f"a global map, of {', '.join(received.observers)}")
        if m.agent == agent:
            return
        entries = self.roster.reports.items()
        heard = {entry.newest.agent for name, entry in entries if name != agent and entry.newest}
        if m.agent in heard or m.agent in self.roster.listed:
            raise SessionError(f"a map of agent {m.agent!r}, whose maps come on another topic")

    def merge(self) -> None:
        """Merge and publish; raises what the session raises."""
        self.fresh = False
        self._last_merge = time.monotonic()
        self.session.config, self.session.threads = self._wanted, self._own.max_threads
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
        fused = result.global_map
        observers = tuple(agent.id for agent in result.agents)
        stamp = Time(nanoseconds=fused.map.stamp).to_msg()
        self._maps.publish(map_to_message(fused.map, self._classes, fused.agents, observers))
        self._cloud.publish(map_cloud(fused.map, self._classes, fused.map.stamp, fused.agents))
        self._markers.publish(map_markers(fused.map, stamp))
        self._publish_grid(fused.map)
        self._publish_alignments(result)

    def _publish_alignments(self, result: MergeResult) -> None:
        now, maps = self.get_clock().now().nanoseconds, self.session.maps
        stale = {*self.session.stale, *self._stale}
        message = alignments_to_message(result, self._classes, now, maps, sorted(stale))
        self._alignments.publish(message)

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

    def _look(self) -> None:
        """See who is there, mark or forget who is gone, and tell the operator."""
        self.roster.look()
        self.report.gone = self.roster.gone(self._own.stale_after)
        stale = tuple(sorted(a for a in self.report.gone if a in self.session.maps))
        if stale != self._stale or self._overdue():
            self._worker.wake()
        self._publish_diagnostics()

    def _overdue(self) -> list[str]:
        """Return the agents that have been gone for so long that they are to be forgotten."""
        after = self._own.forget_after
        gone = self.roster.gone(after) if after else {}
        return [agent for agent in gone if agent in self.session.maps]

    def _mark_gone(self) -> None:
        """Forget who has been gone too long; say of the others in `alignments` that they are."""
        for agent in self._overdue():
            self.get_logger().warning(f"{agent}: gone for {self._own.forget_after:g} s, forgotten")
            self.session.forget(agent)
            self.fresh = bool(self.session.maps)
        stale = tuple(sorted(a for a in self.report.gone if a in self.session.maps))
        for agent in sorted({*stale} ^ {*self._stale}):
            what = "its extractor is gone" if agent in stale else "its extractor is there again"
            self.get_logger().warning(f"{agent}: {what}")
        if stale != self._stale:
            self._stale = stale
            if self.report.result is not None and not self.fresh:
                self._publish_alignments(self.report.result)

    def _publish_diagnostics(self) -> None:
        now = self.get_clock().now()
        statuses = self.report.statuses(self.get_fully_qualified_name(), now.nanoseconds)
        self._diagnostics.publish(to_message(statuses, "merger", now.to_msg()))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the merger until SIGINT or SIGTERM; the process's exit status follows."""
    sys.exit(run(Merger, arguments))


if __name__ == "__main__":
    main()
