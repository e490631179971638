"""What rays meet in a labelled building: triangles (Open3D) or voxels of a cloud (exact traversal).

Both answer the same two questions: where does a ray end, and how far is the nearest surface.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from topometric_ros.simulation.building import BuildingError
from topometric_ros.simulation.labelled import LabelledBuilding
from topometric_ros.voxels.grid import voxelise
from topometric_ros.voxels.index import VoxelIndex
from topometric_ros.voxels.raycast import first_hit

CLOUD_VOXEL = 0.05
"""Edge of the voxels that rays meet in a labelled cloud, m."""


class World(Protocol):
    """Surfaces that can be looked at; metres, building frame."""

    def cast(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64], reach: float
    ) -> NDArray[np.float64]:
        """Return where each ray ends: (R, 3) float64, NaN where nothing is within `reach` m.

        Parameters
        ----------
        origins, directions : (R, 3), m and unit vectors
        """

    def clearance(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distance from each place (N, 3) to the nearest surface: (N,), m."""


def make_world(building: LabelledBuilding, vertices: NDArray[np.float64] | None = None) -> World:
    """Return the surfaces of a building; `vertices` (V, 3) replace its own, as for moved furniture.

    Raises
    ------
    BuildingError
        The building has neither faces nor points.
    """
    if building.points is not None:
        return CloudWorld(building.points)
    if len(building.faces) == 0:
        raise BuildingError(f"{building.name}: neither faces nor points to look at")
    return MeshWorld(building.vertices if vertices is None else vertices, building.faces)


class MeshWorld:
    """Triangles, met by Open3D's RaycastingScene."""

    def __init__(self, vertices: NDArray[np.float64], faces: NDArray[np.int32]) -> None:
        import open3d as o3d

        tensor: Any = o3d.core.Tensor
        self._tensor = tensor
        # The scene counts in single precision: far from the origin that would cost millimetres.
        self._shift = np.round(vertices.mean(axis=0))
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        near = np.ascontiguousarray(vertices - self._shift, dtype=np.float32)
        self._scene.add_triangles(
            self._tensor(near), self._tensor(np.ascontiguousarray(faces, dtype=np.uint32))
        )

    def cast(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64], reach: float
    ) -> NDArray[np.float64]:
        """See `World.cast`."""
        rays = np.concatenate([origins - self._shift, directions], axis=1).astype(np.float32)
        ranges = self._scene.cast_rays(self._tensor(rays), nthreads=1)["t_hit"].numpy()
        ranges = ranges.astype(np.float64)
        ranges[~(ranges <= reach)] = np.nan
        return origins + directions * ranges[:, None]

    def clearance(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `World.clearance`."""
        if len(places) == 0:
            return np.zeros(0)
        near = np.ascontiguousarray(places - self._shift, dtype=np.float32)
        distances = self._scene.compute_distance(self._tensor(near), nthreads=1)
        return distances.numpy().astype(np.float64)


class CloudWorld:
    """Voxels of a cloud, met by exact traversal (Amanatides & Woo 1987)."""

    def __init__(self, points: NDArray[np.float64]) -> None:
        from scipy.spatial import cKDTree

        self._origin = points.min(axis=0)
        grid, cell_of_point = voxelise(points, CLOUD_VOXEL, self._origin)
        count = np.bincount(cell_of_point, minlength=len(grid))
        sums = [np.bincount(cell_of_point, points[:, axis], len(grid)) for axis in range(3)]
        self._means = np.stack(sums, axis=1) / count[:, None]
        self._index = VoxelIndex(grid.coords)
        self._tree = cKDTree(self._means)

    def cast(
        self, origins: NDArray[np.float64], directions: NDArray[np.float64], reach: float
    ) -> NDArray[np.float64]:
        """See `World.cast`; a ray ends on the mean of the points in the voxel that it meets."""
        start = (origins - self._origin) / CLOUD_VOXEL
        rows = first_hit(self._index, start, start + directions * (reach / CLOUD_VOXEL))
        ends = np.full(start.shape, np.nan)
        ends[rows >= 0] = self._means[rows[rows >= 0]]
        return ends

    def clearance(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """See `World.clearance`."""
        return np.asarray(self._tree.query(places)[0], dtype=np.float64)
