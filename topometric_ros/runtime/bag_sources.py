"""Which topics of which bags belong to which agent.

An agent's clouds, scans or maps come from one topic of one bag, together with the /tf of that bag
and of the agent's own namespace. Bags with identical names stay apart: each source is its own.
"""

from __future__ import annotations

import logging
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from topometric_ros.errors import TopometricError
from topometric_ros.io.bag_messages import CLOUD_TYPE, MAP_TYPE, TRANSFORM_TYPE
from topometric_ros.io.bags import Bag, TopicInfo, split_source

logger = logging.getLogger(__name__)

AGENT_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]*")
"""What an agent may be called, here and in the nodes."""

NAME_EXPECTED = "expected letters, digits, '_', '-' and '.', the last two not first"
_NAMED = re.compile(rf"^({AGENT_NAME.pattern})=(.+)$", re.DOTALL)
_OUR_OUTPUTS = ("rooms", "global_cloud", "global_map")
"""Topics that extractors and mergers publish for people, which are nobody's input."""


class SourceError(TopometricError):
    """Sources on the command line that cannot be told apart or that hold nothing to use."""


@dataclass(frozen=True)
class Source:
    """What one word on the command line names: `ID=PATH:/topic`, ID and topic being optional."""

    path: Path
    agent: str | None = None
    topic: str | None = None

    @property
    def text(self) -> str:
        """The source as `merge.json` records it."""
        return readable(f"{self.path}:{self.topic}" if self.topic else str(self.path))


@dataclass(frozen=True)
class BagSource:
    """One agent's input: a topic with its type, and the topics of transforms that go with it."""

    agent: str
    path: Path
    topic: str
    type: str
    transforms: tuple[str, ...]

    @property
    def text(self) -> str:
        """The source as `merge.json` records it."""
        return readable(f"{self.path}:{self.topic}")


def readable(name: str) -> str:
    """Return a file's name as text that can be written: what is not UTF-8 in it becomes `?`."""
    return name.encode("utf-8", "replace").decode()


def parse_source(text: str) -> Source:
    """Read one word of the command line; raises SourceError for an impossible agent's name.

    Examples
    --------
    >>> parse_source("lift=floor.ply")
    Source(path=PosixPath('floor.ply'), agent='lift', topic=None)
    """
    named = None if Path(text).exists() else _NAMED.match(text)
    agent, _, source = text.partition("=")
    if named is None and not Path(text).exists() and source and Path(source).exists():
        require_name(agent)
    path, topic = split_source(named.group(2) if named else text)
    return Source(path, named.group(1) if named else None, topic)


def require_name(agent: str) -> str:
    """Return an agent's name; raises SourceError where it is none."""
    if not AGENT_NAME.fullmatch(agent):
        raise SourceError(f"agent {agent!r}: {NAME_EXPECTED}")
    return agent


def namespace_of(topic: str) -> str:
    """Return the first namespace of a topic, or an empty text.

    Examples
    --------
    >>> namespace_of("/robot1/front/cloud"), namespace_of("/cloud")
    ('robot1', '')
    """
    parts = topic.strip("/").split("/")
    return parts[0] if len(parts) > 1 else ""


def require_distinct(sources: Sequence[Source | BagSource]) -> None:
    """Raise SourceError where two sources have one id."""
    first: dict[str | None, str] = {}
    for source in sources:
        if source.agent in first:
            one, other = first[source.agent], source.text
            raise SourceError(
                f"two sources are named {source.agent!r}; name them apart: left={one} right={other}"
            )
        first[source.agent] = source.text


def one_bag_source(source: Source) -> BagSource:
    """Return the input that a word names, which must be a single one.

    Raises
    ------
    SourceError
        The bag has several topics that it could be.
    BagError
        The bag cannot be read, or lacks the topic or any usable one.
    """
    found = bag_sources(source)
    if len(found) > 1:
        topics = ", ".join(entry.topic for entry in found)
        raise SourceError(f"{source.path}: which topic? BAG:TOPIC with one of {topics}")
    return found[0]


def bag_sources(source: Source) -> list[BagSource]:
    """Return the agents that a bag holds, in the order of their names.

    Raises
    ------
    SourceError
        The bag has no topic to use, or several where one is named.
    BagError
        The bag cannot be read or lacks the topic.
    """
    with Bag(source.path) as bag:
        topics = bag.topics()
        if source.topic is not None:
            chosen = [bag.require(source.topic)]
        else:
            chosen = _discover(source.path, topics)
    found = [_bag_source(source.path, info, topics) for info in chosen]
    if source.agent is not None:
        if len(found) > 1:
            names = ", ".join(entry.topic for entry in found)
            raise SourceError(
                f"{source.path}: {source.agent} is one agent, the bag has several topics: {names}; "
                f"name one: {source.agent}={source.path}:TOPIC"
            )
        found = [replace(found[0], agent=source.agent)]
    return found


def _discover(path: Path, topics: dict[str, TopicInfo]) -> list[TopicInfo]:
    """Return one topic for each first namespace: a cloud, or a topometric map without any."""
    groups: dict[str, list[TopicInfo]] = {}
    for info in topics.values():
        usable = info.type in (CLOUD_TYPE, MAP_TYPE) and info.count > 0
        if usable and info.name.rsplit("/", 1)[-1] not in _OUR_OUTPUTS:
            groups.setdefault(namespace_of(info.name), []).append(info)
    if not groups:
        listed = ", ".join(f"{t.name} ({t.type})" for t in topics.values()) or "none"
        raise SourceError(
            f"{path}: no {CLOUD_TYPE} and no {MAP_TYPE} with messages; the bag has: {listed}"
        )
    chosen = []
    for _, members in sorted(groups.items()):
        best = min(members, key=_preference)
        others = [info.name for info in members if info is not best and info.type == best.type]
        if others:
            logger.warning(
                "%s: %s is used; not used: %s", path, best.name, ", ".join(sorted(others))
            )
        chosen.append(best)
    return chosen


def _preference(info: TopicInfo) -> tuple[bool, bool, str]:
    """Clouds before maps, names that speak of a map before others, then by name."""
    return info.type != CLOUD_TYPE, "map" not in info.name.rsplit("/", 1)[-1], info.name


def _bag_source(path: Path, info: TopicInfo, topics: dict[str, TopicInfo]) -> BagSource:
    namespace = namespace_of(info.name)
    names = ["/tf", "/tf_static"]
    if namespace:
        names += [f"/{namespace}/tf", f"/{namespace}/tf_static"]
    transforms = tuple(
        name for name in names if name in topics and topics[name].type == TRANSFORM_TYPE
    )
    return BagSource(namespace or readable(path.stem), path, info.name, info.type, transforms)
