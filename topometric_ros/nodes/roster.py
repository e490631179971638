"""The agents that a merger listens to: those that are listed, and those that it finds by type.

Knows who has gone: an agent is there as long as somebody publishes its topic, for an extractor with
nothing new to say is silent for hours.
"""

from __future__ import annotations

import os
import time
from collections.abc import Container, Mapping

from rclpy.subscription import Subscription
from topometric_msgs.msg import TopometricMap as MapMessage

from topometric_ros.errors import ConfigurationError
from topometric_ros.nodes import qos
from topometric_ros.nodes.agent_names import is_map_file
from topometric_ros.nodes.merger_report import InputReport
from topometric_ros.nodes.running import SILENT_S, TopometricNode
from topometric_ros.nodes.worker import Inbox
from topometric_ros.runtime.agents_file import agent_of_namespace

TOPIC = "topometric_map"
_TYPE = "topometric_msgs/msg/TopometricMap"
_LEASE_S = 30.0
"""For how long one that was killed may still count as a publisher: 20 s with Fast DDS."""
_MOST = 64
"""Topics that are listened to at most: whoever may publish must not be able to fill the memory."""


class Roster:
    """Inboxes and reports of a merger's agents, by the name that their namespace gives them."""

    def __init__(self, node: TopometricNode, listed: Mapping[str, str], discover: bool) -> None:
        self.listed = dict(listed)
        self.discover = discover
        self.inboxes: dict[str, Inbox[MapMessage]] = {}
        self.reports: dict[str, InputReport] = {}
        self._node = node
        self._last_seen: dict[str, float] = {}
        self._crowded: dict[str, float] = {}
        self._subscriptions: dict[str, Subscription] = {}
        self._told_full = False
        self._began: float | None = None
        self._looked = time.monotonic()
        for agent, place in self.listed.items():
            if is_map_file(place):
                self.reports[agent] = InputReport(place)
                continue
            topic = node.resolve_topic_name(f"{place}/{TOPIC}")
            if any(report.topic == topic for report in self.reports.values()):
                raise ConfigurationError(f"agents: {topic} is named twice")
            self._add(agent, topic)

    @property
    def files(self) -> dict[str, str]:
        """The listed agents whose maps are files, and these."""
        return {agent: place for agent, place in self.listed.items() if is_map_file(place)}

    def listen(self) -> None:
        """Subscribe the maps of all agents known so far."""
        for agent in self.inboxes:
            self._last_seen[agent] = time.monotonic()
            self._subscribe(agent, self.reports[agent].topic)
        self._began = time.monotonic()
        self.look()

    def recall(self, agent: str, source: str) -> InputReport:
        """Return the report of an agent that was known before a restart, a new one if need be.

        Who was found is listened to again; who is not listed any more is not, and counts as gone.
        """
        for report in self.reports.values():
            if report.topic == source:
                return report
        namespace, _, last = source.rpartition("/")
        if last != TOPIC or not source.startswith("/"):
            return self.report_of(agent, source)
        if self.discover:
            name = agent_of_namespace(namespace) or "agent"
            self._add(name, source)
            return self.reports[name]
        self._last_seen[agent] = time.monotonic()
        return self.reports.setdefault(agent, InputReport(source))

    def look(self) -> None:
        """Find new agents where that is wanted, and note whose extractors are there."""
        if self.discover:
            self._find()
        self._looked = time.monotonic()
        for agent in self.inboxes:
            report = self.reports[agent]
            report.publishers = self._publishers(report.topic)
            if report.publishers:
                self._last_seen[agent] = self._looked
            self._look_for_rivals(agent, report)
        if self._began is not None and time.monotonic() - self._began > SILENT_S:
            self._began = None
            if silence := self.silence():
                self._node.get_logger().warning(silence)

    def _look_for_rivals(self, agent: str, report: InputReport) -> None:
        """Say where several extractors take themselves for one agent."""
        now = time.monotonic()
        if report.publishers < 2:
            self._crowded.pop(agent, None)
            report.rivals = 0
        elif now - self._crowded.setdefault(agent, now) > _LEASE_S:
            if report.publishers > report.rivals:
                self._node.get_logger().warning(
                    f"{report.topic} has {report.publishers} publishers: do several extractors "
                    f"take themselves for {agent}? Maps of the session that began last count"
                )
            report.rivals = report.publishers

    def drop(self, longer_than: float, kept: Container[str]) -> None:
        """Take who was found, not listed, and has been gone for so long (s) off the list.

        Agents that are in `kept` stay; the others may be found again.
        """
        gone = self.gone(longer_than)
        found = [name for name in self.inboxes if name not in self.listed]
        for name in [n for n in found if self.id_of(n) in gone and self.id_of(n) not in kept]:
            del self.inboxes[name], self.reports[name], self._last_seen[name]
            self._node.destroy_subscription(self._subscriptions.pop(name))

    def seen(self, name: str) -> InputReport:
        """Note that an agent has sent something; return its report."""
        self._last_seen[name] = time.monotonic()
        return self.reports[name]

    def gone(self, longer_than: float) -> dict[str, float]:
        """Return how long (s) agents have been gone of whom nothing was seen for that long.

        The agents are named as their maps name them. Whose map came from a file is never gone. It
        counts up to the last :meth:`look`: a process that stood still has not missed anybody.
        """
        live = {n: seen for n, seen in self._last_seen.items() if not self.reports[n].file}
        absent = {self.id_of(name): self._looked - seen for name, seen in live.items()}
        return {agent: age for agent, age in absent.items() if age > longer_than}

    def id_of(self, name: str) -> str:
        """Return how an agent's maps name it; the name it is listed by before the first map."""
        newest = self.reports[name].newest
        return newest.agent if newest else name

    def heard(self, apart_from: str) -> set[str]:
        """Return the agents whose maps came on the topic of another name, or from a file."""
        others = (name for name in self.reports if name != apart_from)
        entries = [self.reports[n] for n in others if n in self.inboxes or self.reports[n].file]
        return {entry.newest.agent for entry in entries if entry.newest}

    def admits(self, agent: str) -> bool:
        """Whether maps of this agent may be taken from elsewhere, as from a file."""
        return self.discover or agent in self.listed or agent in map(self.id_of, self.reports)

    def report_of(self, agent: str, source: str) -> InputReport:
        """Return an agent's report; of one whose map came from a file, a new one that names it."""
        for name, report in self.reports.items():
            if agent in (name, self.id_of(name)):
                return report
        return self.reports.setdefault(agent, InputReport(source))

    def clear(self) -> None:
        """Forget what has arrived, taken or not; agents stay on the list."""
        for name, report in self.reports.items():
            self.reports[name] = InputReport(report.topic)
        for inbox in self.inboxes.values():
            inbox.take_all()

    def _find(self) -> None:
        topics = {report.topic for report in self.reports.values()}
        for topic in self._published():
            agent = agent_of_namespace(topic.rpartition("/")[0]) or "agent"
            if topic in topics or agent in self.inboxes or agent in self.listed:
                continue
            if len(self.reports) >= _MOST:
                if not self._told_full:
                    self._node.get_logger().error(
                        f"{topic} is not listened to: there are {_MOST} agents already; "
                        "`forget_after` drops those that are gone"
                    )
                self._told_full = True
                return
            self._told_full = False
            self._node.get_logger().info(f"found {agent}: {topic}")
            self._add(agent, topic)
            self._subscribe(agent, topic)

    def silence(self) -> str:
        """Return in words of whom no map has come and who publishes maps that nobody listens to."""
        silent = [self.reports[a] for a in self.inboxes if self.reports[a].newest is None]
        absent = [report.topic for report in silent if not report.publishers]
        heard = {self.reports[agent].topic for agent in self.inboxes}
        others = [topic for topic in self._published() if topic not in heard]
        if not self.inboxes and self.discover:
            told = "no agent found yet: nobody publishes a `topometric_map` that is seen here"
            by_server = "; with a discovery server list `agents`, or set ROS_SUPER_CLIENT=TRUE"
            return told + (by_server if os.environ.get("ROS_DISCOVERY_SERVER") else "")
        if not absent:
            return ""
        told = f"no map yet: nobody publishes {', '.join(absent)}"
        return told + (f"; there is {', '.join(others)}, which is not listed" if others else "")

    def _published(self) -> list[str]:
        """Return the topics on which somebody publishes an agent's map."""
        named = sorted(self._node.get_topic_names_and_types())
        maps = [t for t, types in named if t.rpartition("/")[2] == TOPIC and _TYPE in types]
        # A topic that somebody only listens to is no agent's.
        return [topic for topic in maps if self._publishers(topic)]

    def _publishers(self, topic: str) -> int:
        return int(self._node.count_publishers(topic))

    def _add(self, agent: str, topic: str) -> None:
        self.inboxes.setdefault(agent, Inbox(1))
        # One whose map came from a file may come alive.
        self.reports.setdefault(agent, InputReport(topic)).topic = topic
        self._last_seen.setdefault(agent, time.monotonic())

    def _subscribe(self, agent: str, topic: str) -> None:
        receive = self.inboxes[agent].put
        self._subscriptions[agent] = self._node.create_subscription(
            MapMessage, topic, receive, qos.SNAPSHOT
        )
