"""A spinning lidar in a triangle mesh: every ray's first hit, with noise on its range."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.simulation.building import Building


@dataclass(frozen=True)
class LidarConfig:
    """A spinning lidar: rays in rings, ranges with noise, coordinates in steps."""

    rings: int = parameter(32, "Number of rings.", minimum=1, maximum=512)
    azimuths: int = parameter(256, "Rays in a ring.", minimum=4, maximum=8192)
    lowest: float = parameter(-55.0, "Elevation of the lowest ring.", unit="deg", minimum=-90.0)
    highest: float = parameter(55.0, "Elevation of the highest ring.", unit="deg", maximum=90.0)
    minimum_range: float = parameter(0.3, "Nearer returns are dropped.", unit="m", minimum=0.0)
    maximum_range: float = parameter(12.0, "Farther returns are dropped.", unit="m", minimum=0.1)
    noise: float = parameter(0.01, "Standard deviation of a range.", unit="m", minimum=0.0)
    step: float = parameter(
        0.00390625,
        "Coordinates are rounded to it; a power of two keeps a compressed bag small. 0: off.",
        unit="m",
        minimum=0.0,
    )


def ray_directions(config: LidarConfig) -> NDArray[np.float64]:
    """Return one turn of the sensor: (rings * azimuths, 3) float64 unit vectors, sensor frame."""
    elevation = np.radians(np.linspace(config.lowest, config.highest, config.rings))[:, None]
    azimuth = (2 * np.pi * np.arange(config.azimuths) / config.azimuths)[None, :]
    directions = (
        np.cos(elevation) * np.cos(azimuth),
        np.cos(elevation) * np.sin(azimuth),
        np.sin(elevation) + 0 * azimuth,
    )
    return np.stack(directions, axis=-1).reshape(-1, 3)


class Scanner:
    """A lidar that can be put anywhere in one building."""

    def __init__(self, building: Building, config: LidarConfig) -> None:
        self._config = config
        self._directions = ray_directions(config)
        self._scene = _scene(building)

    def scan(
        self, T_building_lidar: NDArray[np.float64], rng: np.random.Generator
    ) -> NDArray[np.float32]:
        """Return what one turn of the sensor sees: (n, 3) float32, m, sensor frame.

        Rays without a return within the sensor's range are left out.
        """
        import open3d as o3d

        config = self._config
        turned = self._directions @ T_building_lidar[:3, :3].T
        origins = np.broadcast_to(T_building_lidar[:3, 3], turned.shape)
        rays = np.concatenate([origins, turned], axis=1).astype(np.float32)
        tensor: Any = o3d.core.Tensor
        hits = self._scene.cast_rays(tensor(rays))["t_hit"].numpy()
        # Every ray draws its noise, hit or not, so that one ray's fate does not move the others'.
        ranges = hits.astype(np.float64) + rng.normal(0.0, config.noise, len(hits))
        kept = (ranges >= config.minimum_range) & (ranges <= config.maximum_range)
        points = self._directions[kept] * ranges[kept, None]
        if config.step > 0:
            points = np.round(points / config.step) * config.step
        return points.astype(np.float32)


def _scene(building: Building) -> Any:
    """Return the building as an Open3D RaycastingScene."""
    import open3d as o3d

    tensor: Any = o3d.core.Tensor
    vertices, triangles = building.mesh()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(tensor(vertices), tensor(triangles))
    return scene
