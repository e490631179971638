"""The `merger` node: topometric maps in, one global map out. It converts, publishes and reports."""

from __future__ import annotations

import math
import sys
import threading
import time
from collections.abc import Sequence

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from numpy.typing import NDArray
from topometric_msgs.msg import AlignmentArray
from topometric_msgs.msg import TopometricMap as MapMessage

from topometric_ros.errors import TopometricError
from topometric_ros.fusion.config import MergeConfig, merge_preset
from topometric_ros.nodes import parameters, qos
from topometric_ros.nodes.agent_names import parse_agents
from topometric_ros.nodes.config import MergerNodeConfig
from topometric_ros.nodes.diagnostics import to_message
from topometric_ros.nodes.merger_maps import read_files, recall
from topometric_ros.nodes.merger_output import MergerOutput
from topometric_ros.nodes.merger_places import Places
from topometric_ros.nodes.merger_report import MergerReport
from topometric_ros.nodes.merger_services import serve
from topometric_ros.nodes.merger_showing import Showing
from topometric_ros.nodes.merger_state import StateKeeper
from topometric_ros.nodes.messages import message_classes
from topometric_ros.nodes.roster import Roster
from topometric_ros.nodes.running import TopometricNode, describe_failure, log_to, run
from topometric_ros.nodes.worker import Inbox, Worker
from topometric_ros.runtime.alignment_codec import offers_from_message
from topometric_ros.runtime.by_hand import covariance_of
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.message_codec import ReceivedMap, map_from_message

_PACE_S = 0.2
_REPORT_S = 1.0
_BREATH_S = 0.005

_OFFERS_S = 3.0
"""How long another merger's alignments are waited for at the start, where there is one."""

_CHANGEABLE_OF_NODE = (
    "max_rate",
    "grid_storey",
    "stale_after",
    "forget_after",
    "max_voxels",
    "max_threads",
    "by_hand_sigma",
    "by_hand_turn_sigma",
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
        self._keeper = StateKeeper("", self.get_logger())

    def _set_up(self) -> None:
        discover = self._own.discover or not self._listed
        self.roster = Roster(self, self._listed, discover)
        self.report = MergerReport(self.roster.reports)
        self.session = MergerSession(self._wanted, tuple(self._listed), self._own.max_threads)
        self.fresh = False
        self._more = False
        self._said: dict[tuple[str, str], tuple[str, str]] = {}
        self._others: Inbox[AlignmentArray] = Inbox(1)
        self._keeper = StateKeeper(self._own.state_file, self.get_logger())
        self._keeper.restore(self.session)
        now = self.get_clock().now().nanoseconds
        recall(self.session, self.roster, now)
        read_files(self.session, self.roster, now, self.get_logger())
        self.fresh = bool(self.session.maps)
        output = MergerOutput(self, self._classes)
        self._showing = Showing(output, lambda: self._own, self.remember)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        self._places = Places(self)
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
        self._begun, self._offered = time.monotonic(), False
        if self._own.adopt:
            name = self.resolve_topic_name("alignments")
            self.create_subscription(AlignmentArray, name, self._hear, qos.SNAPSHOT)
        self.roster.listen()
        serve(self)
        self.every(_PACE_S, self._tick)
        self.create_timer(1.0 / self._own.tf_rate, self._places.publish)
        self.every(_REPORT_S, self._look)

    def cleanup(self) -> None:
        """Take the publishers away, and leave the state file to others."""
        super().cleanup()
        self._keeper.close()

    def _stop_work(self, limit_s: float) -> bool:
        return self._worker.stop(limit_s)

    def _change(self, configs: parameters.Configs) -> None:
        self._own, self._wanted = configs

    def _tick(self) -> None:
        arrived = any(map(len, self.roster.inboxes.values()))
        if self.fresh or self._more or arrived or self._is_told_otherwise():
            self._worker.wake()

    def _is_told_otherwise(self) -> bool:
        """Whether parameters have changed on which something rests that is held or published."""
        by_hand = (self.session.covariance_by_hand != self._covariance_by_hand()).any()
        changed = bool(by_hand) or self.session.config != self._wanted
        storey = self._showing.other_storey(self.session)
        return storey or (bool(self.session.maps) and changed)

    def _covariance_by_hand(self) -> NDArray[np.float64]:
        turn = math.radians(self._own.by_hand_turn_sigma)
        return covariance_of(self._own.by_hand_sigma, turn)

    def _hear(self, message: AlignmentArray) -> None:
        if not self._showing.output.is_own(message):
            self._others.put(message)

    def _work(self) -> None:
        """Take in what has arrived, go on aligning, and publish what it is time for."""
        with self.working:
            # Where this fails, it is not tried again before something new arrives.
            self._more = False
            self.take_in()
            self._mark_gone()
            expected = self._offers_expected()
            self.fresh |= self._is_told_otherwise()
            if self.fresh or self.session.waiting:
                # Whether what is known holds for new maps is told before anything is searched.
                check_only = self.fresh or expected
                self.fresh = False
                self._align(0 if check_only else self._own.max_threads)
            left = self.session.placed is not None and self._showing.publish_due(self.session)
            self.report.changes = self._showing.changes
            self._more = left or self.session.waiting > 0
        if self.session.waiting and not expected:
            # A service that waits for its turn gets it here.
            time.sleep(_BREATH_S)
            self._worker.wake()

    def take_in(self) -> None:
        """Take the maps that have arrived, and what another merger says of them."""
        for agent, inbox in list(self.roster.inboxes.items()):
            for message in inbox.take_all():
                self._take_map(agent, message)
        for message in self._others.take_all():
            self._take_alignments(message)
        self._places.note(self.session, self._wanted.global_frame)

    def _take_map(self, agent: str, message: MapMessage) -> None:
        """Give a map to the session, or refuse it with one line in the log."""
        entry = self.roster.seen(agent)
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
            entry.file = ""
            self.fresh = True

    def _take_alignments(self, message: AlignmentArray) -> None:
        try:
            self.session.offer(offers_from_message(message))
            self._offered = True
        except TopometricError as error:
            self.get_logger().warning(f"alignments of another merger are not used: {error}")

    def _require_agent(self, agent: str, received: ReceivedMap) -> None:
        """Refuse a map of a whole fleet, or of an agent whose maps come on another topic."""
        m = received.map
        if received.observers:
            raise SessionError(f"a global map, of {', '.join(received.observers)}")
        if m.agent == agent:
            return
        if m.agent in self.roster.heard(agent) or m.agent in self.roster.listed:
            raise SessionError(f"a map of agent {m.agent!r}, whose maps come on another topic")

    def _align(self, limit: int | None) -> None:
        self.session.config, self.session.threads = self._wanted, self._own.max_threads
        self.session.covariance_by_hand = self._covariance_by_hand()
        placed = self.session.align(limit)
        self.report.placed, self.report.waiting = placed, self.session.waiting
        self.report.failure = ""
        for x in placed.alignments:
            said = (x.status, x.reason)
            if self._said.get(x.agents) != said and not x.basis.waits:
                self.get_logger().info(f"{' and '.join(x.agents)}: {x.status}: {x.reason}")
                self._said[x.agents] = said
                self.report.since[x.agents] = self.get_clock().now().nanoseconds
        self._places.note(self.session, self._wanted.global_frame)

    def _offers_expected(self) -> bool:
        """Whether another merger is there whose alignments have not arrived yet."""
        early = time.monotonic() - self._begun < _OFFERS_S
        awaited = self._own.adopt and early and not self._offered
        return awaited and self._showing.output.others_publish()

    def merge(self) -> None:
        """Align all that waits, fuse and publish; raises what the session raises."""
        self.fresh = False
        self._align(None)
        self._showing.fuse(self.session)
        self._showing.tell(self.session)
        self.report.changes = self._showing.changes

    def start_over(self) -> None:
        """Forget all maps and alignments; the caller holds `working`."""
        self.roster.clear()
        self.session.reset()
        now = self.get_clock().now().nanoseconds
        read_files(self.session, self.roster, now, self.get_logger())
        self.fresh = bool(self.session.maps)
        self.report = MergerReport(self.roster.reports)
        self._showing.forget()
        self._said.clear()
        self._places.note(self.session, self._wanted.global_frame)
        self.remember()

    def remember(self) -> None:
        """Write the state file, if there is one; the caller holds `working`."""
        self.report.unsaved = self._keeper.keep(self.session)

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
        if stale != self._showing.stale or self._overdue():
            self._worker.wake()
        if self._own.forget_after and self.working.acquire(blocking=False):
            self.roster.drop(self._own.forget_after, self.session.maps)
            self.working.release()
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
            self.roster.report_of(agent, agent).newest = None
            self.fresh = bool(self.session.maps)
        stale = tuple(sorted(a for a in self.report.gone if a in self.session.maps))
        for agent in sorted({*stale} ^ {*self._showing.stale}):
            what = "its extractor is gone" if agent in stale else "its extractor is there again"
            self.get_logger().warning(f"{agent}: {what}")
        self._showing.stale = stale

    def _publish_diagnostics(self) -> None:
        now = self.get_clock().now()
        statuses = self.report.statuses(self.get_fully_qualified_name(), now.nanoseconds)
        self._diagnostics.publish(to_message(statuses, "merger", now.to_msg()))


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the merger until SIGINT or SIGTERM; the process's exit status follows."""
    sys.exit(run(Merger, arguments))


if __name__ == "__main__":
    main()
