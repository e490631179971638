"""The `extractor` node: clouds in, topometric maps out. It converts, publishes and reports."""

from __future__ import annotations

import dataclasses
import sys
import threading
import time
import uuid
from collections.abc import Sequence

from diagnostic_msgs.msg import DiagnosticArray
from rclpy.time import Time
from sensor_msgs.msg import PointCloud2
from tf2_msgs.msg import TFMessage
from topometric_msgs.msg import TopometricMap as MapMessage
from visualization_msgs.msg import MarkerArray

from topometric_ros.errors import TopometricError
from topometric_ros.extraction.config import ExtractionConfig, extraction_preset
from topometric_ros.matching.config import matching_preset
from topometric_ros.nodes import parameters, qos, tf
from topometric_ros.nodes.agent_names import check_agent
from topometric_ros.nodes.cloud_subscription import CloudSubscription
from topometric_ros.nodes.config import DescribingConfig, ExtractorNodeConfig
from topometric_ros.nodes.diagnostics import to_message
from topometric_ros.nodes.extractor_report import ExtractorReport
from topometric_ros.nodes.extractor_services import serve
from topometric_ros.nodes.markers import map_markers
from topometric_ros.nodes.messages import message_classes
from topometric_ros.nodes.running import TopometricNode, describe_failure, log_to, run
from topometric_ros.nodes.scan_keeper import ScanKeeper
from topometric_ros.nodes.worker import Inbox, Worker
from topometric_ros.runtime.agent_input import AgentInput
from topometric_ros.runtime.agents_file import agent_of_namespace
from topometric_ros.runtime.cloud_message import map_cloud
from topometric_ros.runtime.extractor_session import ExtractorSession
from topometric_ros.runtime.message_codec import map_to_message, without_mean_points

_TRANSFORMS_WAITING = 100_000
_PACE_S = 0.5
_REPORT_S = 1.0
_SETTLE_S = 1.0

_CHANGEABLE_OF_NODE = ("max_rate", "min_change", "tf_timeout")
_FIXED_OF_EXTRACTION = ("voxel_size", "level.", "scans.")
"""What the first map of a session settles for the later ones."""


class Extractor(TopometricNode):
    """One agent's extractor: an :class:`ExtractorSession` with topics and services around it.

    Subscriptions only fill the inboxes; `input` and its session belong to whoever holds `working`,
    the worker's thread or a service's.
    """

    def __init__(self) -> None:
        super().__init__("extractor", automatically_declare_parameters_from_overrides=True)
        log_to(self)
        self._own, self._wanted = self._declare_parameters()
        self._matching = dataclasses.replace(
            matching_preset(self._own.preset), descriptors=self._own.matching.descriptors
        )
        self._agent = self._own.agent or agent_of_namespace(self.get_namespace()) or "agent"
        check_agent(self._agent)
        self._classes = message_classes()
        self.working = threading.Lock()
        self._keeper = ScanKeeper("", self.get_logger())

    def _set_up(self) -> None:
        agent = self._agent
        session = ExtractorSession(
            agent, self._wanted, self._matching, lambda: uuid.uuid4().hex[:12]
        )
        self._keeper = ScanKeeper(self._own.scans_file, self.get_logger())
        if self._own.mode != "map":
            self._keeper.restore(session)
        self.input = AgentInput(
            session,
            mode="scan" if session.has_input else self._own.mode,
            map_frame=self._own.map_frame,
            history=round(self._own.tf_history * 1e9),
            waiting=self._own.scan_queue,
            sensor_frame=self._own.sensor_frame,
        )
        self.report = ExtractorReport()
        self._extracted: tuple[str, int, int] | None = None
        self._last_extraction = -float("inf")
        self._first_cloud: float | None = None
        self.clouds: Inbox[PointCloud2] = Inbox(self._own.scan_queue)
        self._dropped_before = 0
        self._transforms: Inbox[tuple[TFMessage, bool]] = Inbox(_TRANSFORMS_WAITING)
        if self._own.mode == "map":
            self.clouds.capacity = 1
        self._maps = self.create_publisher(MapMessage, "topometric_map", qos.SNAPSHOT)
        self._rooms = self.create_publisher(PointCloud2, "rooms", qos.SNAPSHOT)
        self._markers = self.create_publisher(MarkerArray, "topometric_markers", qos.SNAPSHOT)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        self.get_logger().info(f"extractor of {agent}: session {session.session}")

    def _declare_parameters(self) -> tuple[ExtractorNodeConfig, ExtractionConfig]:
        preset = parameters.override(self, "preset", "default")
        describing = DescribingConfig(matching_preset(preset).descriptors)
        own = ExtractorNodeConfig(matching=describing)
        configs = (own, extraction_preset(preset))
        names = [info.name for info in parameters.infos(configs)]
        of_node = {info.name for info in parameters.infos((own,))}
        fixed = [name for name in names if name.startswith(_FIXED_OF_EXTRACTION)]
        fixed += [name for name in of_node if name not in _CHANGEABLE_OF_NODE]
        configs = parameters.declare(self, configs, fixed)
        parameters.on_change(self, configs, self._change)
        return configs

    def _begin(self) -> None:
        self._worker = Worker(self._work, self.failed)
        serve(self)
        if self._own.mode != "map":
            tf.listen(self, self._on_transforms)
        whole = self._own.mode == "map"
        self._cloud = CloudSubscription(self, self._own.cloud_qos, self._on_cloud, whole)
        self._lost_before = 0
        self.every(_PACE_S, self._tick)
        self._begun = time.monotonic()
        self.every(_REPORT_S, self._look)

    def _stop_work(self, limit_s: float) -> bool:
        if not self._worker.stop(limit_s) or not self.working.acquire(timeout=limit_s):
            return False
        self.remember(at_once=True)
        self.working.release()
        return True

    def cleanup(self) -> None:
        """Take the publishers away, and leave the scans' file to others."""
        super().cleanup()
        self._keeper.close()

    def remember(self, at_once: bool = False) -> None:
        """Write the scans' file, if there is one and it is time; the caller holds `working`."""
        self.report.unsaved = self._keeper.keep(self.input.session, at_once)

    def _change(self, configs: parameters.Configs) -> None:
        self._own, self._wanted = configs

    def _on_cloud(self, message: PointCloud2) -> None:
        if self._first_cloud is None:
            self._first_cloud = time.monotonic()
        self.report.received += 1
        self.clouds.put(message)
        self._worker.wake()

    def _on_transforms(self, message: TFMessage, static: bool) -> None:
        self._transforms.put((tf.without_parent(message, self._own.global_frame), static))

    def _tick(self) -> None:
        if len(self.clouds) or len(self._transforms) or self.input.waiting or self._is_fresh():
            self._worker.wake()

    def _state(self) -> tuple[str, int, int]:
        """Return what tells whether the session has taken anything since the last extraction."""
        session = self.input.session
        return session.session, session.counts.map_clouds, session.counts.scans

    def _is_fresh(self) -> bool:
        return self.input.session.has_input and (
            self._state() != self._extracted or self.input.session.extraction != self._wanted
        )

    def _work(self) -> None:
        """Take in what has arrived and, when it is time, extract and publish."""
        with self.working:
            self.take_in()
            self.remember()
            due = time.monotonic() - self._last_extraction >= 1.0 / self._own.max_rate
            if self._is_fresh() and due and self._is_changed():
                self.extract()

    def _is_changed(self) -> bool:
        """Whether enough came or went for another map; if not, wait for more input."""
        session = self.input.session
        if session.extraction != self._wanted or session.change() >= self._own.min_change:
            return True
        self._extracted, self._last_extraction = self._state(), time.monotonic()
        self.report.unchanged += 1
        return False

    def take_in(self, at_once: bool = False) -> None:
        """Take the transforms and clouds that have arrived; say once why scans found no place."""
        skipped_before, overflowed = self.input.skipped_count, self.input.overflowed
        dropped = self._take_messages(at_once) + self.input.overflowed - overflowed
        if self.report.lose(dropped, "their queue was full"):
            self.get_logger().warning(
                f"{dropped} scans lost: no more than {self._own.scan_queue} may wait, for an "
                "extraction or for /tf (scan_queue)"
            )
        skipped = self.input.skipped_count - skipped_before
        if skipped and self.report.miss(self.input.skipped[-1]):
            self.get_logger().warning(f"{skipped} skipped: {self.input.skipped[-1]}")

    def _take_messages(self, at_once: bool) -> int:
        """Take transforms and clouds; return how many scans had to make room for newer ones."""
        for transforms, static in self._transforms.take_all():
            self.input.add_transforms(transforms, static)
        self.input.expire(time.monotonic(), self._own.tf_timeout)
        if self._first_cloud is None:
            return 0
        # A scan that arrives before the first /tf would be taken for a map of one scan.
        settled = time.monotonic() - self._first_cloud >= _SETTLE_S
        if self._own.mode == "auto" and not (settled or at_once):
            return 0
        dropped = self.clouds.dropped - self._dropped_before
        self._dropped_before += dropped
        for message in self.clouds.take_all():
            self._take_cloud(message)
        # Of whole maps the latest serves; of scans none is dropped before the queue is full.
        whole = self._is_whole()
        self.clouds.capacity = 1 if whole else self._own.scan_queue
        if whole:
            self.report.superseded += dropped
        return 0 if whole else dropped

    def _is_whole(self) -> bool:
        """Whether clouds are whole maps, of which the latest serves."""
        return self._own.mode == "map" or self.input.session.counts.map_clouds > 0

    def _take_cloud(self, message: PointCloud2) -> None:
        try:
            self.input.add_cloud(message)
        except TopometricError as error:
            if self.report.refuse(str(error)):
                self.get_logger().error(f"cloud refused: {error}")
            self._publish_diagnostics()
            return
        self.report.refusal = ""

    def extract(self) -> None:
        """Extract and publish; raises what the session raises."""
        session = self.input.session
        if not session.has_input:
            return
        self._extracted, self._last_extraction = self._state(), time.monotonic()
        session.extraction = self._wanted
        result = session.extract()
        m = result.map if self._own.mean_points else without_mean_points(result.map)
        stamp = Time(nanoseconds=m.stamp).to_msg()
        self._maps.publish(map_to_message(m, self._classes))
        self._rooms.publish(map_cloud(m, self._classes, m.stamp))
        self._markers.publish(map_markers(m, stamp))
        self.report.extracted(m, result.quality, sum(result.timings.values()))
        self.get_logger().info(
            f"map {m.sequence}: {len(m.rooms)} rooms, {len(m.passages)} passages, "
            f"{len(m.voxels)} voxels in {self.report.cpu_s:.1f} s of CPU time"
        )

    def failed(self, error: Exception) -> None:
        """Report what went wrong in the worker; the session keeps the map that it had."""
        text = describe_failure(error)
        if text != self.report.failure:
            self.get_logger().error(f"no map: {text}")
        self.report.failure = text

    def _look(self) -> None:
        """Tell the operator how it stands, and once in the log where no cloud has come at all."""
        silence = "" if self.report.received else self._cloud.silence()
        if self.report.hear(silence, self._begun):
            self.get_logger().warning(f"no cloud yet: {silence}")
        lost, self._lost_before = self._cloud.lost - self._lost_before, self._cloud.lost
        self.report.lost_on_the_way += lost
        if not self._is_whole() and self.report.lose(lost, "on the way"):
            self.get_logger().warning(
                f"{lost} scans lost on the way ({self._cloud.profile}): is this machine or the "
                "network too busy, or its publisher's queue too short?"
            )
        self._publish_diagnostics()

    def _publish_diagnostics(self) -> None:
        session = self.input.session
        numbers: dict[str, object] = {
            "publishers": self._cloud.publishers,
            "quality of service": self._cloud.profile,
            "waiting for transforms": self.input.waiting,
            "without transform": self.input.skipped_count - self.input.overflowed,
            "too little changed": self.report.unchanged,
            "map clouds": session.counts.map_clouds,
            "scans": session.counts.scans,
            "non-finite points dropped": session.counts.dropped_points,
        }
        if self.input.waits_for:
            numbers["waits for"] = self.input.waits_for
        if self.input.skipped:
            numbers["last without transform"] = self.input.skipped[-1]
        statuses = self.report.statuses(self.get_fully_qualified_name(), numbers)
        now = self.get_clock().now().to_msg()
        self._diagnostics.publish(to_message(statuses, session.agent, now))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the extractor until SIGINT or SIGTERM; the process's exit status follows."""
    sys.exit(run(Extractor, arguments))


if __name__ == "__main__":
    main()
