"""What agents carry: a spinning lidar or a depth camera, put at poses of a walk."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.simulation.agents import rotation
from topometric_ros.simulation.scanner import LidarConfig, ray_directions
from topometric_ros.simulation.world import World


@dataclass(frozen=True)
class CameraConfig:
    """A depth camera that looks along the way, and to other sides where it has several views."""

    width: int = parameter(96, "Pixels in a row.", minimum=2, maximum=2048)
    height: int = parameter(72, "Pixels in a column.", minimum=2, maximum=2048)
    field_of_view: float = parameter(
        86.0, "Horizontal field of view.", unit="deg", minimum=10.0, maximum=150.0
    )
    views: int = parameter(
        4, "Views at each stop, turned by equal angles, the first ahead.", minimum=1, maximum=16
    )
    minimum_range: float = parameter(0.3, "Nearer returns are dropped.", unit="m", minimum=0.0)
    maximum_range: float = parameter(6.0, "Farther returns are dropped.", unit="m", minimum=0.1)
    noise: float = parameter(
        0.005, "Standard deviation of a range at 1 m; grows with its square.", unit="m", minimum=0.0
    )


def _lidar() -> LidarConfig:
    return LidarConfig(rings=40, azimuths=400, lowest=-60.0, highest=60.0)


@dataclass(frozen=True)
class SensorConfig:
    """Which sensor an agent carries, how high, and both sensors' own parameters."""

    pattern: str = parameter("lidar", "What the agents carry.", choices=("lidar", "camera"))
    height: float = parameter(
        1.2, "Height of the sensor over the floor.", unit="m", minimum=0.2, maximum=3.0
    )
    lidar: LidarConfig = field(default_factory=_lidar)
    camera: CameraConfig = field(default_factory=CameraConfig)

    @property
    def maximum_range(self) -> float:
        """How far the sensor in use sees, m."""
        in_use = self.lidar if self.pattern == "lidar" else self.camera
        return in_use.maximum_range


@dataclass(frozen=True)
class Returns:
    """What was met from all poses of a walk; N returns, metres, building frame."""

    hits: NDArray[np.float64]
    """(N, 3): where the rays met a surface."""
    towards: NDArray[np.float64]
    """(N, 3): unit vectors back to the sensor."""
    error: NDArray[np.float64]
    """(N,): by how much the measured range is too long, m."""
    scan: NDArray[np.int32]
    """(N,): index of the pose."""

    def where(self, kept: NDArray[np.bool_] | NDArray[np.int64]) -> Returns:
        """Return only the returns that a mask (N,) or their indices keep."""
        return Returns(self.hits[kept], self.towards[kept], self.error[kept], self.scan[kept])


def camera_directions(config: CameraConfig) -> NDArray[np.float64]:
    """Return the rays of all pixels: (width * height, 3) float64, x ahead, y left, z up."""
    across = np.tan(np.radians(config.field_of_view) / 2)
    down = across * config.height / config.width
    left = np.linspace(across, -across, config.width)[None, :]
    up = np.linspace(down, -down, config.height)[:, None]
    rays = np.stack(np.broadcast_arrays(np.ones_like(left + up), left, up), axis=-1).reshape(-1, 3)
    directions: NDArray[np.float64] = rays / np.linalg.norm(rays, axis=1, keepdims=True)
    return directions


def with_views(poses: Sequence[NDArray[np.float64]], config: SensorConfig) -> NDArray[np.float64]:
    """Return the poses at which a scan is made, (S, 4, 4): each view of a camera is one."""
    if config.pattern == "lidar":
        return np.array(poses)
    turns = 2 * np.pi * np.arange(config.camera.views) / config.camera.views
    return np.array([pose @ rotation(0.0, 0.0, turn) for pose in poses for turn in turns])


def scan_from(
    world: World,
    poses: NDArray[np.float64],
    config: SensorConfig,
    rng: np.random.Generator,
) -> Returns:
    """Return what the sensor meets from all its poses.

    Every ray draws its noise, met or not, so that one ray's fate does not move the others'.

    Parameters
    ----------
    poses : (S, 4, 4) T_building_sensor
    """
    spinning = config.pattern == "lidar"
    directions = ray_directions(config.lidar) if spinning else camera_directions(config.camera)
    nearest = config.lidar.minimum_range if spinning else config.camera.minimum_range
    parts = []
    for i, pose in enumerate(poses):
        turned = directions @ pose[:3, :3].T
        origins = np.broadcast_to(pose[:3, 3], turned.shape)
        hits = world.cast(origins, turned, config.maximum_range)
        draws = rng.standard_normal(len(hits))
        ranges = np.linalg.norm(hits - origins, axis=1)
        kept = ranges >= nearest  # NaN is not
        width = config.lidar.noise if spinning else config.camera.noise * ranges[kept] ** 2
        towards = (origins[kept] - hits[kept]) / ranges[kept, None]
        scan = np.full(int(kept.sum()), i, dtype=np.int32)
        parts.append(Returns(hits[kept], towards, draws[kept] * width, scan))
    return Returns(
        np.concatenate([np.zeros((0, 3)), *(part.hits for part in parts)]),
        np.concatenate([np.zeros((0, 3)), *(part.towards for part in parts)]),
        np.concatenate([np.zeros(0), *(part.error for part in parts)]),
        np.concatenate([np.zeros(0, np.int32), *(part.scan for part in parts)]),
    )
