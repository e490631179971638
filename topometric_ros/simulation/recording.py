"""Simulated scans as a rosbag2 bag: PointCloud2 in the sensor frame, /tf and /tf_static."""

from __future__ import annotations

import operator
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError

START = 1_767_225_600_000_000_000
"""Stamp of the first message, ns since the epoch: 2026-01-01 00:00 UTC."""
PERIOD = 250_000_000
"""Between two scans of one agent, ns."""

_SECOND = 1_000_000_000


class RecordingError(TopometricError):
    """A bag cannot be written where it was asked for."""


@dataclass(frozen=True)
class AgentRecording:
    """One agent's walk; `T_map_base[i]` is where `scans[i]` (n, 3) float32, lidar frame, was made.

    `T_map_building` is the truth that the bag does not tell.
    """

    name: str
    T_map_building: NDArray[np.float64]
    T_map_odom: NDArray[np.float64]
    T_map_base: list[NDArray[np.float64]]
    T_base_lidar: NDArray[np.float64]
    scans: list[NDArray[np.float32]]


@dataclass(frozen=True)
class MapRecording:
    """One agent's growing map: `clouds` are (stamp in ns, (n, 3) float32, m, agent frame)."""

    name: str
    clouds: list[tuple[int, NDArray[np.float32]]]


def write_maps(directory: Path, agents: Sequence[MapRecording]) -> None:
    """Write /ID/cloud_map of every agent, transient local in frame ID/map, into a new bag.

    Raises
    ------
    RecordingError
        `directory` exists already.
    """
    from rosbags.interfaces import QosDurability

    messages = _Messages()
    kind = "sensor_msgs/msg/PointCloud2"
    writer = _new_writer(directory)
    with writer:
        events = []
        for agent in agents:
            connection = writer.add_connection(
                f"/{agent.name}/cloud_map",
                kind,
                typestore=messages.store,
                offered_qos_profiles=[_qos(QosDurability.TRANSIENT_LOCAL)],
            )
            events += [(stamp, connection, agent.name, points) for stamp, points in agent.clouds]
        for stamp, connection, name, points in sorted(events, key=operator.itemgetter(0)):
            writer.write(connection, stamp, messages.cloud(points, f"{name}/map", stamp))


def write_scans(directory: Path, agents: Sequence[AgentRecording]) -> None:
    """Write /ID/scan_cloud of every agent with /tf and /tf_static into a new bag (MCAP, zstd).

    Frames: ID/map -> ID/odom -> ID/base_link -> ID/lidar. Equal input gives equal bytes.

    Raises
    ------
    RecordingError
        `directory` exists already.
    """
    from rosbags.interfaces import Qos, QosDurability

    messages = _Messages()
    writer = _new_writer(directory)
    with writer:

        def connect(topic: str, kind: str, qos: Qos) -> Any:
            return writer.add_connection(
                topic, kind, typestore=messages.store, offered_qos_profiles=[qos]
            )

        volatile, latched = _qos(QosDurability.VOLATILE), _qos(QosDurability.TRANSIENT_LOCAL)
        static = connect("/tf_static", "tf2_msgs/msg/TFMessage", latched)
        moving = connect("/tf", "tf2_msgs/msg/TFMessage", volatile)
        clouds = {
            agent.name: connect(
                f"/{agent.name}/scan_cloud", "sensor_msgs/msg/PointCloud2", volatile
            )
            for agent in agents
        }
        writer.write(static, START, messages.static_transforms(agents))
        for stamp, agent, i in _in_time_order(agents):
            writer.write(moving, stamp, messages.moving_transforms(agent, i, stamp))
            cloud = messages.cloud(agent.scans[i], f"{agent.name}/lidar", stamp)
            writer.write(clouds[agent.name], stamp + 1_000_000, cloud)


def _new_writer(directory: Path) -> Any:
    """Return the writer of a new bag: MCAP, zstd."""
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    if directory.exists():
        raise RecordingError(f"{directory} exists already; remove it or name another directory")
    writer = Writer(directory, version=9, storage_plugin=StoragePlugin.MCAP)
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    return writer


def _in_time_order(
    agents: Sequence[AgentRecording],
) -> Iterator[tuple[int, AgentRecording, int]]:
    """Yield (stamp in ns, agent, index of the scan); the agents take turns."""
    events = []
    for k, agent in enumerate(agents):
        first = START + PERIOD // 10 + k * PERIOD // len(agents)
        events += [(first + i * PERIOD, agent, i) for i in range(len(agent.scans))]
    yield from sorted(events, key=operator.itemgetter(0))


def _qos(durability: Any) -> Any:
    """Return the profile that rosbag2 records of a reliable publisher of that durability."""
    from rosbags.interfaces import Qos, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(9223372036, 854775807)
    return Qos(
        QosHistory.UNKNOWN,
        0,
        QosReliability.RELIABLE,
        durability,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )


class _Messages:
    """Serialised messages of ROS 2 Jazzy, made without a ROS installation."""

    def __init__(self) -> None:
        from rosbags.typesys import Stores, get_typestore

        self.store = get_typestore(Stores.ROS2_JAZZY)

    def _type(self, name: str) -> Any:
        return self.store.types[name]

    def _header(self, frame: str, stamp: int) -> Any:
        time = self._type("builtin_interfaces/msg/Time")(stamp // _SECOND, stamp % _SECOND)
        return self._type("std_msgs/msg/Header")(time, frame)

    def _transform(self, parent: str, child: str, T: NDArray[np.float64], stamp: int) -> Any:
        from scipy.spatial.transform import Rotation

        vector = self._type("geometry_msgs/msg/Vector3")
        quaternion = self._type("geometry_msgs/msg/Quaternion")
        rotation = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True)
        transform = self._type("geometry_msgs/msg/Transform")(
            vector(*map(float, T[:3, 3])), quaternion(*map(float, rotation))
        )
        stamped = self._type("geometry_msgs/msg/TransformStamped")
        return stamped(self._header(parent, stamp), child, transform)

    def _tf(self, transforms: list[Any]) -> bytes:
        message = self._type("tf2_msgs/msg/TFMessage")(transforms)
        return bytes(self.store.serialize_cdr(message, "tf2_msgs/msg/TFMessage"))

    def static_transforms(self, agents: Sequence[AgentRecording]) -> bytes:
        """Return base_link -> lidar of all agents."""
        return self._tf(
            [
                self._transform(f"{a.name}/base_link", f"{a.name}/lidar", a.T_base_lidar, START)
                for a in agents
            ]
        )

    def moving_transforms(self, agent: AgentRecording, i: int, stamp: int) -> bytes:
        """Return map -> odom and odom -> base_link of one agent at its i-th scan."""
        name, T_map_odom = agent.name, agent.T_map_odom
        T_odom_base = np.linalg.inv(T_map_odom) @ agent.T_map_base[i]
        return self._tf(
            [
                self._transform(f"{name}/map", f"{name}/odom", T_map_odom, stamp),
                self._transform(f"{name}/odom", f"{name}/base_link", T_odom_base, stamp),
            ]
        )

    def cloud(self, points: NDArray[np.float32], frame: str, stamp: int) -> bytes:
        """Return points (n, 3) float32, m, as a PointCloud2 of x, y and z."""
        kind = "sensor_msgs/msg/PointCloud2"
        field = self._type("sensor_msgs/msg/PointField")
        message = self._type(kind)(
            header=self._header(frame, stamp),
            height=1,
            width=len(points),
            fields=[field(axis, 4 * i, 7, 1) for i, axis in enumerate("xyz")],
            is_bigendian=False,
            point_step=12,
            row_step=12 * len(points),
            data=np.ascontiguousarray(points, dtype="<f4").view(np.uint8).reshape(-1),
            is_dense=True,
        )
        return bytes(self.store.serialize_cdr(message, kind))
