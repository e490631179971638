"""Recorded bags without ROS: rosbag2 directories, bare MCAP and SQLite files, split or whole.

Only clouds, transforms and topometric maps are decoded; whatever else a bag holds is passed over,
its types need not be known.
"""

from __future__ import annotations

import heapq
import importlib
import logging
import operator
import sqlite3
import struct
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any

from mcap.exceptions import McapError
from mcap.records import Message
from mcap.stream_reader import StreamReader
from rosbags.interfaces import Connection, QosDurability
from rosbags.rosbag2 import Reader, ReaderError
from rosbags.serde import SerdeError

from topometric_ros.errors import TopometricError, one_line
from topometric_ros.io.bag_messages import CLOUD_TYPE, MAP_TYPE, TRANSFORM_TYPE, typestore

logger = logging.getLogger(__name__)

BAG_SUFFIXES = (".mcap", ".db3")
_MCAP_MAGIC = b"\x89MCAP0\r\n"
_DECODED = (CLOUD_TYPE, TRANSFORM_TYPE, MAP_TYPE)
# What rosbags itself decompresses with.
_zstd = importlib.import_module(
    "compression.zstd" if sys.version_info >= (3, 14) else "backports.zstd"
)
_FAILURES = (
    *(ReaderError, SerdeError, sqlite3.Error, OSError, EOFError, struct.error),
    *(_zstd.ZstdError, RuntimeError, MemoryError),
    *(ValueError, KeyError, IndexError, TypeError, AssertionError, OverflowError),
)
"""What rosbags raises on damaged input, besides its own errors: it trusts sizes and offsets."""


class BagError(TopometricError):
    """A bag that cannot be read or that lacks what was asked for."""


@dataclass(frozen=True)
class TopicInfo:
    """One topic of a bag: its message type and how many messages it has.

    `latched` says that it was published for late joiners too (transient local).
    """

    name: str
    type: str
    count: int
    latched: bool = False


@dataclass(frozen=True)
class BagMessage:
    """One recorded message: `time` (ns) is when it was received, `message` what it said."""

    time: int
    topic: str
    type: str
    message: Any


def is_bag(path: Path) -> bool:
    """Return whether a path names a bag: a directory or a file of a bag's suffix."""
    return path.is_dir() or path.suffix.lower() in BAG_SUFFIXES


def split_source(text: str) -> tuple[Path, str | None]:
    """Split `BAG:topic` into path and topic; a path that exists is taken as it is.

    Examples
    --------
    >>> split_source("walk:/robot1/cloud_map")
    (PosixPath('walk'), '/robot1/cloud_map')
    >>> split_source("a.ply")
    (PosixPath('a.ply'), None)
    """
    path, colon, topic = text.rpartition(":")
    if not colon or not path or Path(text).exists():
        return Path(text), None
    return Path(path), topic if topic.startswith("/") else f"/{topic}"


class Bag:
    """An open bag; use as a context manager.

    Parameters
    ----------
    path : directory with metadata.yaml or with bag files, or one .mcap or .db3 file

    Raises
    ------
    BagError
        Nothing there is a bag, or a file is damaged.
    """

    def __init__(self, path: Path | str) -> None:
        self.path = Path(path)
        self._stack = ExitStack()
        self._readers: list[Reader] = []

    def __enter__(self) -> Bag:
        try:
            for part in _parts(self.path):
                reader = _open(part)
                self._stack.callback(reader.close)
                self._readers.append(reader)
        except BaseException:
            self._stack.close()
            raise
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._stack.close()

    def topics(self) -> dict[str, TopicInfo]:
        """Return what the bag holds, by topic, in alphabetical order."""
        found: dict[str, TopicInfo] = {}
        for connection in self._connections():
            before = found.get(connection.topic)
            count = connection.msgcount + (before.count if before else 0)
            found[connection.topic] = TopicInfo(
                connection.topic, connection.msgtype, count, _latched(connection)
            )
        return dict(sorted(found.items()))

    def require(self, topic: str, types: Sequence[str] = (CLOUD_TYPE, MAP_TYPE)) -> TopicInfo:
        """Return a topic's description.

        Raises
        ------
        BagError
            The bag lacks the topic (those that it has are listed) or it has another type.
        """
        topics = self.topics()
        info = topics.get(topic)
        if info is None:
            listed = ", ".join(f"{t.name} ({t.type})" for t in topics.values()) or "none"
            raise BagError(f"{self.path}: no topic {topic}; the bag has: {listed}")
        if info.type not in types:
            raise BagError(
                f"{self.path}: topic {topic}: expected {' or '.join(types)}, got {info.type}"
            )
        return info

    def messages(self, topics: Sequence[str]) -> Iterator[BagMessage]:
        """Yield the decoded messages of some topics in the order in which they were received.

        Raises
        ------
        BagError
            A message is damaged, or its type was defined otherwise when it was recorded.
        """
        wanted = set(topics)
        streams = []
        for reader in self._readers:
            chosen = [c for c in reader.connections if c.topic in wanted and c.msgtype in _DECODED]
            for connection in chosen:
                self._check_type(connection)
            if chosen:
                streams.append(reader.messages(chosen))
        store = typestore()
        try:
            for connection, time, raw in heapq.merge(*streams, key=operator.itemgetter(1)):
                message = store.deserialize_cdr(raw, connection.msgtype)
                yield BagMessage(time, connection.topic, connection.msgtype, message)
        except _FAILURES as error:
            raise BagError(f"{self.path}: a message cannot be read: {one_line(error)}") from error

    def _connections(self) -> Iterator[Connection]:
        for reader in self._readers:
            yield from reader.connections

    def _check_type(self, connection: Connection) -> None:
        """Refuse messages of another version of a type; bags of ROS 2 before Iron do not say."""
        ours = typestore().hash_rihs01(connection.msgtype)
        if connection.digest and connection.digest != ours:
            raise BagError(
                f"{self.path}: topic {connection.topic} was recorded with another definition of "
                f"{connection.msgtype} ({connection.digest[:16]}) than this program's ({ours[:16]})"
            )


def _latched(connection: Connection) -> bool:
    profiles = getattr(connection.ext, "offered_qos_profiles", ())
    return any(p.durability is QosDurability.TRANSIENT_LOCAL for p in profiles)


def _parts(path: Path) -> list[Path]:
    """Return what to open: the bag itself, or the files of a directory without metadata."""
    if not path.exists():
        raise BagError(f"{path}: no such bag")
    if path.is_file():
        if path.suffix.lower() not in BAG_SUFFIXES:
            raise BagError(f"{path}: not a bag: expected a directory, .mcap or .db3 file")
        _check_file(path)
        return [path]
    files = sorted(file for file in path.iterdir() if file.suffix.lower() in BAG_SUFFIXES)
    for file in files:
        _check_file(file)
    if (path / "metadata.yaml").exists():
        return [path]
    if not files:
        raise BagError(f"{path}: not a bag: the directory holds no metadata.yaml, .mcap or .db3")
    return files


def _check_file(path: Path) -> None:
    """Refuse a file that is empty, no MCAP at all, or that ends before its footer."""
    size = path.stat().st_size
    if size == 0:
        raise BagError(f"{path}: the bag file is empty (0 bytes)")
    if path.suffix.lower() != ".mcap":
        return
    with path.open("rb") as file:
        start = file.read(len(_MCAP_MAGIC))
        file.seek(-min(size, len(_MCAP_MAGIC)), 2)
        end = file.read()
    if start != _MCAP_MAGIC:
        raise BagError(f"{path}: not an MCAP file: it starts with {start!r}")
    if end != _MCAP_MAGIC:
        raise BagError(
            f"{path}: the MCAP file ends early: {_whole_messages(path)} whole messages in {size} "
            "bytes, then no footer; `mcap recover` makes a readable file of them"
        )


def _whole_messages(path: Path) -> int:
    """Return how many messages can be read before a cut-off MCAP file breaks."""
    count = 0
    with path.open("rb") as file:
        try:
            for record in StreamReader(file).records:
                count += isinstance(record, Message)
        except (McapError, *_FAILURES):
            logger.debug("%s breaks after %d messages", path, count)
    return count


def _open(path: Path) -> Reader:
    try:
        reader = Reader(path)
        reader.open()
    except _FAILURES as error:
        raise BagError(f"{path}: not a readable bag: {one_line(error)}") from error
    for connection in reader.connections:  # As metadata.yaml has them, of any type.
        texts = (connection.topic, connection.msgtype, connection.digest or "")
        if not all(isinstance(text, str) for text in texts) or type(connection.msgcount) is not int:
            told = f"expected a topic's name, type and number of messages, got {texts[:2]}"
            raise BagError(f"{path}: not a readable bag: {told} and {connection.msgcount!r}")
    return reader
