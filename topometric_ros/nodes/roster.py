"""The agents that a merger listens to: those that are listed, and those that it finds by type.

Knows who has gone: an agent is there as long as somebody publishes its topic, for an extractor with
nothing new to say is silent for hours.
"""

from __future__ import annotations

import time
from collections.abc import Mapping

from topometric_msgs.msg import TopometricMap as MapMessage

from topometric_ros.nodes import qos
from topometric_ros.nodes.merger_report import InputReport
from topometric_ros.nodes.running import TopometricNode
from topometric_ros.nodes.worker import Inbox
from topometric_ros.runtime.agents_file import agent_of_namespace

TOPIC = "topometric_map"
_TYPE = "topometric_msgs/msg/TopometricMap"
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

    def listen(self) -> None:
        """Subscribe the maps of all agents known so far."""
        for agent, namespace in self.listed.items():
            self._add(agent, self._node.resolve_topic_name(f"{namespace}/{TOPIC}"))
        for agent in self.inboxes:
            self._last_seen[agent] = time.monotonic()
            self._subscribe(agent, self.reports[agent].topic)
        self.look()

    def recall(self, topic: str) -> None:
        """Take an agent on the list again that was found before a restart."""
        namespace, _, last = topic.rpartition("/")
        known = {report.topic for report in self.reports.values()}
        if self.discover and last == TOPIC and topic.startswith("/") and topic not in known:
            self._add(agent_of_namespace(namespace) or "agent", topic)

    def look(self) -> None:
        """Find new agents where that is wanted, and note whose extractors are there."""
        if self.discover:
            self._find()
        for agent in self.inboxes:
            report = self.reports[agent]
            if self._node.count_publishers(report.topic):
                self._last_seen[agent] = time.monotonic()

    def gone(self, longer_than: float) -> dict[str, float]:
        """Return how long (s) agents have been gone of whom nothing was seen for that long.

        The agents are named as their maps name them.
        """
        now = time.monotonic()
        absent = {self.id_of(name): now - seen for name, seen in self._last_seen.items()}
        return {agent: age for agent, age in absent.items() if age > longer_than}

    def id_of(self, name: str) -> str:
        """Return how an agent's maps name it; the name it is listed by before the first map."""
        newest = self.reports[name].newest
        return newest.agent if newest else name

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
        for topic, types in sorted(self._node.get_topic_names_and_types()):
            namespace, _, last = topic.rpartition("/")
            if last != TOPIC or _TYPE not in types or topic in topics:
                continue
            agent = agent_of_namespace(namespace) or "agent"
            if agent in self.reports or len(self.reports) >= _MOST:
                continue
            self._node.get_logger().info(f"found {agent}: {topic}")
            self._add(agent, topic)
            self._subscribe(agent, topic)

    def _add(self, agent: str, topic: str) -> None:
        self.inboxes.setdefault(agent, Inbox(1))
        self.reports.setdefault(agent, InputReport(topic))
        self._last_seen.setdefault(agent, time.monotonic())

    def _subscribe(self, agent: str, topic: str) -> None:
        receive = self.inboxes[agent].put
        self._node.create_subscription(MapMessage, topic, receive, qos.SNAPSHOT)
