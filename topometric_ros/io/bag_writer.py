"""Writing a rosbag2 directory (metadata.yaml + MCAP) without ROS: same messages, same bytes."""

from __future__ import annotations

import shutil
from pathlib import Path
from types import TracebackType
from typing import Any

from rosbags.interfaces import Connection
from rosbags.rosbag2 import StoragePlugin, Writer, WriterError

from topometric_ros.io.bag_messages import quality_of_service, typestore
from topometric_ros.io.bags import BagError


class BagWriter:
    """A bag being written; use as a context manager. It is whole once the manager ends.

    Parameters
    ----------
    path : directory to write; an older bag there is replaced, anything else is refused

    Raises
    ------
    BagError
        The directory holds something that is no bag.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._connections: dict[str, Connection] = {}
        if path.exists():
            names = {entry.name for entry in path.iterdir()} if path.is_dir() else {path.name}
            if not names <= {"metadata.yaml", f"{path.name}.mcap"}:
                raise BagError(f"{path}: not replaced, since it holds more than a bag")
            shutil.rmtree(path)
        self._writer = Writer(path, version=9, storage_plugin=StoragePlugin.MCAP)

    def __enter__(self) -> BagWriter:
        try:
            self._writer.open()
        except (WriterError, OSError) as error:
            raise BagError(f"{self.path}: cannot be written: {error}") from error
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._writer.__exit__(kind, error, trace)

    def add_topic(self, topic: str, message_type: str, *, latched: bool = False) -> None:
        """Announce a topic; `latched` topics are transient local, depth 1, for late joiners."""
        self._connections[topic] = self._writer.add_connection(
            topic,
            message_type,
            typestore=typestore(),
            offered_qos_profiles=[quality_of_service(latched=latched)],
        )

    def write(self, topic: str, time: int, message: Any) -> None:
        """Write one message of an announced topic, received at `time` (ns)."""
        connection = self._connections[topic]
        raw = typestore().serialize_cdr(message, connection.msgtype)
        self._writer.write(connection, time, raw)
