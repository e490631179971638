"""The `merger` node: topometric maps in, one global map out. It converts, publishes and reports."""

from __future__ import annotations

import dataclasses
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2
from topometric_msgs.msg import AlignmentArray
from topometric_msgs.msg import TopometricMap as MapMessage
from topometric_msgs.srv import LoadMap, MergeNow, RemoveAlignment, Reset, SaveMap, SetAlignment
from visualization_msgs.msg import MarkerArray

from topometric_ros.alignment import MergeResult
from topometric_ros.errors import TopometricError
from topometric_ros.fusion.config import MergeConfig, merge_preset
from topometric_ros.io.map_files import load_map, save_map
from topometric_ros.nodes import parameters, qos
from topometric_ros.nodes.agent_names import parse_agents
from topometric_ros.nodes.clouds import room_cloud
from topometric_ros.nodes.config import MergerNodeConfig
from topometric_ros.nodes.diagnostics import to_message
from topometric_ros.nodes.frames import frames_below
from topometric_ros.nodes.markers import map_markers
from topometric_ros.nodes.merger_report import AgentInput, MergerReport
from topometric_ros.nodes.messages import message_classes
from topometric_ros.nodes.running import TopometricNode, log_to, run
from topometric_ros.nodes.tf import TransformBroadcaster
from topometric_ros.nodes.worker import Inbox, Worker
from topometric_ros.runtime.alignment_codec import alignments_to_message
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.message_codec import map_from_message, map_to_message
from topometric_ros.runtime.transforms import TransformError
from topometric_ros.topometric_map import TopometricMap

_PACE_S = 0.2
_REPORT_S = 1.0
_END_S = 3.0

_CHANGEABLE_OF_NODE = ("max_rate",)


class Merger(TopometricNode):
    """A fleet's merger: a :class:`MergerSession` with topics and services around it.

    Subscriptions only fill the inboxes; the session belongs to whoever holds `_working`, the
    worker's thread or a service's.
    """

    def __init__(self) -> None:
        super().__init__("merger", automatically_declare_parameters_from_overrides=True)
        log_to(self)
        self._own, self._wanted = self._declare_parameters()
        self._agents = parse_agents(self._own.agents)
        self._session = MergerSession(self._wanted, tuple(self._agents))
        self._classes = message_classes()
        self._inboxes: dict[str, Inbox[MapMessage]] = {}
        self._report = MergerReport()
        self._working = threading.Lock()
        self._fresh = False
        self._last_merge = -float("inf")
        self._placed: list[tuple[str, str, NDArray[np.float64]]] = []
        self._said_of_frames: dict[str, str] = {}
        self._worker = Worker(self._work, self._failed)
        self._connect()
        self._serve()
        self.get_logger().info(f"merger of {', '.join(self._agents)}")

    def _declare_parameters(self) -> tuple[MergerNodeConfig, MergeConfig]:
        preset = parameters.override(self, "preset", "default")
        configs = (MergerNodeConfig(), merge_preset(preset))
        of_node = {info.name for info in parameters.infos(configs[:1])}
        fixed = of_node - set(_CHANGEABLE_OF_NODE) | {"global_frame"}
        configs = parameters.declare(self, configs, fixed)
        parameters.on_change(self, configs, self._change)
        return configs

    def _connect(self) -> None:
        for agent, namespace in self._agents.items():
            topic = f"{namespace}/topometric_map"
            self._inboxes[agent] = Inbox(1)
            self._report.inputs[agent] = AgentInput(self.resolve_topic_name(topic))
            receive = self._inboxes[agent].put
            self.create_subscription(MapMessage, topic, receive, qos.SNAPSHOT)
        self._maps = self.create_publisher(MapMessage, "global_map", qos.SNAPSHOT)
        self._cloud = self.create_publisher(PointCloud2, "global_cloud", qos.SNAPSHOT)
        self._alignments = self.create_publisher(AlignmentArray, "alignments", qos.SNAPSHOT)
        self._markers = self.create_publisher(MarkerArray, "global_markers", qos.SNAPSHOT)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        self._broadcaster = TransformBroadcaster(self)
        self.create_timer(_PACE_S, self._tick)
        self.create_timer(1.0 / self._own.tf_rate, self._publish_transforms)
        self.create_timer(_REPORT_S, self._publish_diagnostics)

    def _serve(self) -> None:
        waiting = MutuallyExclusiveCallbackGroup()
        for kind, name, answer in (
            (MergeNow, "~/merge_now", self._merge_now),
            (Reset, "~/reset", self._reset),
            (SaveMap, "~/save_map", self._save_map),
            (LoadMap, "~/load_map", self._load_map),
            (SetAlignment, "~/set_alignment", self._set_alignment),
            (RemoveAlignment, "~/remove_alignment", self._remove_alignment),
        ):
            self.create_service(kind, name, answer, callback_group=waiting)

    def close(self) -> bool:
        """Stop working; return False where a merge would not end in time."""
        return self._worker.stop(_END_S)

    def _change(self, configs: parameters.Configs) -> None:
        self._own, self._wanted = configs

    def _tick(self) -> None:
        if self._fresh or any(map(len, self._inboxes.values())):
            self._worker.wake()

    def _work(self) -> None:
        """Take in what has arrived and, when it is time, merge and publish."""
        with self._working:
            self._take_in()
            due = time.monotonic() - self._last_merge >= 1.0 / self._own.max_rate
            if self._fresh and due:
                self._merge()

    def _take_in(self) -> None:
        for agent, inbox in self._inboxes.items():
            for message in inbox.take_all():
                self._take_map(agent, message)
        self._place()

    def _take_map(self, agent: str, message: MapMessage) -> None:
        """Give a map to the session, or refuse it with one line in the log."""
        entry = self._report.inputs[agent]
        entry.received += 1
        try:
            m = map_from_message(message).map
            self._require_agent(agent, m)
            is_new = self._session.add_map(m, entry.topic)
        except TopometricError as error:
            if entry.refuse(str(error)):
                self.get_logger().error(f"map on {entry.topic} refused: {error}")
            return
        entry.refusal = ""
        if is_new:
            entry.newest, entry.arrived = m, self.get_clock().now().nanoseconds
            self._fresh = True

    def _require_agent(self, agent: str, m: TopometricMap) -> None:
        """Refuse a map that claims to be of an agent whose maps come on another topic."""
        if m.agent == agent:
            return
        entries = self._report.inputs.items()
        heard = {entry.newest.agent for name, entry in entries if name != agent and entry.newest}
        if m.agent in heard or m.agent in self._agents:
            raise SessionError(f"a map of agent {m.agent!r}, whose maps come on another topic")

    def _merge(self) -> None:
        """Merge and publish; raises what the session raises."""
        self._fresh = False
        self._last_merge = time.monotonic()
        self._session.config = self._wanted
        before = (
            {x.agents: x for x in self._report.result.alignments} if self._report.result else {}
        )
        result = self._session.merge()
        self._report.result, self._report.failure = result, ""
        for alignment in result.alignments:
            old = before.get(alignment.agents)
            if old is None or (old.status, old.reason) != (alignment.status, alignment.reason):
                pair = " and ".join(alignment.agents)
                self.get_logger().info(f"{pair}: {alignment.status}: {alignment.reason}")
        self._place()
        self._publish(result)

    def _publish(self, result: MergeResult) -> None:
        now = self.get_clock().now()
        fused = result.global_map
        observers = tuple(agent.id for agent in result.agents)
        stamp = Time(nanoseconds=fused.map.stamp).to_msg()
        self._maps.publish(map_to_message(fused.map, self._classes, fused.agents, observers))
        self._cloud.publish(room_cloud(fused.map, stamp))
        self._markers.publish(map_markers(fused.map, stamp))
        self._alignments.publish(
            alignments_to_message(
                result, self._classes, now.nanoseconds, self._session.maps, self._session.stale
            )
        )

    def _place(self) -> None:
        """Note the transforms to publish: those of agents whose place is known now."""
        transforms = self._session.transforms()
        own = {agent: m.frame_id for agent, m in self._session.maps.items()}
        names = frames_below(self._wanted.global_frame, own)
        for agent, name in names.items():
            if name != own[agent] and self._said_of_frames.get(agent) != name:
                self._said_of_frames[agent] = name
                self.get_logger().warning(
                    f"{agent}: the name of its map frame {own[agent]} is in use already; on /tf "
                    f"it is {name}"
                )
        self._placed = [(self._wanted.global_frame, names[a], T) for a, T in transforms.items()]

    def _publish_transforms(self) -> None:
        self._broadcaster.send(self._placed, self.get_clock().now().to_msg())

    def _failed(self, error: Exception) -> None:
        """Report what went wrong in the worker; the session keeps the result that it had."""
        text = str(error) if isinstance(error, TopometricError) else f"unexpected: {error!r}"
        if text != self._report.failure:
            self.get_logger().error(f"merging failed: {text}")
        self._report.failure = text

    def _publish_diagnostics(self) -> None:
        now = self.get_clock().now()
        statuses = self._report.statuses(self.get_fully_qualified_name(), now.nanoseconds)
        self._diagnostics.publish(to_message(statuses, "merger", now.to_msg()))

    def _merge_now(self, _request: Any, response: Any) -> Any:
        with self._working:
            self._take_in()
            try:
                self._merge()
            except SessionError as error:
                response.code, response.message = response.NO_INPUT, str(error)
                return response
            except Exception as error:
                self._failed(error)
                response.code, response.message = response.FAILED, self._report.failure
                return response
            agents = self._session.result.agents if self._session.result else ()
            placed = [agent.id for agent in agents if agent.T_global_agent is not None]
            response.agents, response.aligned = len(agents), len(placed)
        response.code = response.SUCCESS
        response.message = f"{len(placed)} of {len(agents)} agents in the global frame"
        return response

    def _reset(self, _request: Any, response: Any) -> Any:
        with self._working:
            for inbox in self._inboxes.values():
                inbox.take_all()
            self._session.reset()
            self._fresh, self._placed = False, []
            inputs = {agent: AgentInput(x.topic) for agent, x in self._report.inputs.items()}
            self._report = MergerReport(inputs)
        response.code, response.message = response.SUCCESS, "all maps and alignments forgotten"
        self.get_logger().info(response.message)
        return response

    def _save_map(self, request: Any, response: Any) -> Any:
        result = self._report.result
        if result is None:
            response.code, response.message = response.NO_INPUT, "there is no global map yet"
            return response
        path = Path(request.path).expanduser().absolute()
        fused = result.global_map
        try:
            save_map(path, fused.map, fused.agents, tuple(agent.id for agent in result.agents))
        except (OSError, TopometricError) as error:
            response.code, response.message = response.FILE_ERROR, f"{path}: {error}"
            return response
        response.code, response.path = response.SUCCESS, str(path)
        response.message = f"global map written to {path}"
        return response

    def _load_map(self, request: Any, response: Any) -> Any:
        try:
            m = load_map(request.path)
        except OSError as error:
            response.code, response.message = response.FILE_ERROR, f"{request.path}: {error}"
            return response
        except TopometricError as error:
            response.code, response.message = response.FAILED, str(error)
            return response
        m = dataclasses.replace(m, agent=request.agent or m.agent)
        if m.agent not in self._agents:
            response.code = response.UNKNOWN_AGENT
            response.message = f"no agent {m.agent!r}; known: {', '.join(self._agents)}"
            return response
        with self._working:
            try:
                self._fresh |= self._session.add_map(m, request.path)
            except TopometricError as error:
                response.code, response.message = response.FAILED, str(error)
                return response
            self._report.inputs[m.agent].newest = m
            self._report.inputs[m.agent].arrived = self.get_clock().now().nanoseconds
        response.code, response.agent = response.SUCCESS, m.agent
        response.message = f"map {m.sequence} of {m.agent}: {len(m.rooms)} rooms"
        return response

    def _set_alignment(self, request: Any, response: Any) -> Any:
        a, b = request.agent_a, request.agent_b
        with self._working:
            try:
                self._session.set_alignment(a, b, np.array(request.t_a_b).reshape(4, 4))
            except SessionError as error:
                response.code, response.message = response.UNKNOWN_AGENT, str(error)
                return response
            except TransformError as error:
                response.code, response.message = response.INVALID_TRANSFORM, str(error)
                return response
            self._fresh = bool(self._session.maps)
        response.code, response.message = response.SUCCESS, f"alignment of {a} and {b} set by hand"
        self.get_logger().info(response.message)
        return response

    def _remove_alignment(self, request: Any, response: Any) -> Any:
        a, b = request.agent_a, request.agent_b
        with self._working:
            try:
                removed = self._session.remove_alignment(a, b)
            except SessionError as error:
                response.code, response.message = response.UNKNOWN_AGENT, str(error)
                return response
            self._fresh = bool(self._session.maps)
        if not removed:
            response.code = response.NO_ALIGNMENT
            response.message = f"no alignment of {a} and {b} was set by hand"
            return response
        response.code, response.message = response.SUCCESS, f"{a} and {b}: the maps decide again"
        self.get_logger().info(response.message)
        return response


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the merger until SIGINT or SIGTERM; the process's exit status follows."""
    sys.exit(run(Merger, arguments))


if __name__ == "__main__":
    main()
