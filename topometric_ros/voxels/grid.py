"""VoxelGrid: a set of occupied cells on a lattice of cell centres (thesis §4.1.2, eq. 2-8).

The lattice differs from the draft's in two ways that a growing map needs: cells are named by their
centres `origin + k * voxel_size`, and coordinates may be negative, so new space renumbers nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.topometric_map import OFFSET_STEPS
from topometric_ros.voxels.morton import morton_encode


class VoxelError(TopometricError):
    """A voxel grid asked for with an impossible lattice or from impossible points."""


@dataclass(frozen=True)
class VoxelGrid:
    """Occupied cells: `coords` (N, 3) int32 unique and in Morton order, `origin` and size in m."""

    coords: NDArray[np.int32]
    origin: NDArray[np.float64]
    voxel_size: float

    def __len__(self) -> int:
        return len(self.coords)

    def centres(self) -> NDArray[np.float64]:
        """Return the cell centres: (N, 3) float64, m (eq. 5)."""
        return self.origin + self.coords * self.voxel_size


def voxelise(
    points: NDArray[np.float64], voxel_size: float, origin: NDArray[np.float64]
) -> tuple[VoxelGrid, NDArray[np.int64]]:
    """Put points into the cells of a lattice (eq. 6).

    Parameters
    ----------
    points : (P, 3) float64, m, finite
    voxel_size : edge of a cell, m
    origin : (3,) float64, m, the centre of cell (0, 0, 0)

    Returns
    -------
    grid : VoxelGrid of the cells with at least one point
    cell_of_point : (P,) int64, index of each point's cell in `grid.coords`

    Raises
    ------
    VoxelError
        The size is not positive or no point was given.
    """
    if not voxel_size > 0:
        raise VoxelError(f"voxel_size: expected a positive length in m, got {voxel_size}")
    if len(points) == 0:
        raise VoxelError("no points to put into voxels")
    origin = np.asarray(origin, dtype=np.float64)
    coords = lattice_coordinates(points, voxel_size, origin)
    codes = morton_encode(coords)
    _, first, inverse = np.unique(codes, return_index=True, return_inverse=True)
    return VoxelGrid(coords[first].astype(np.int32), origin, voxel_size), inverse.reshape(-1)


def lattice_coordinates(
    points: NDArray[np.float64], voxel_size: float, origin: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Return the coordinates of the cell that holds each point: (P, 3) int64."""
    return np.floor((points - origin) / voxel_size + 0.5).astype(np.int64)


def in_morton_order(coords: NDArray[np.integer]) -> NDArray[np.int32]:
    """Return the distinct coordinates among `coords` (N, 3), in Morton order."""
    _, first = np.unique(morton_encode(coords), return_index=True)
    return coords[first].astype(np.int32)


def surface_offsets(
    points: NDArray[np.float64], grid: VoxelGrid, cell_of_point: NDArray[np.int64]
) -> NDArray[np.int8]:
    """Return where in its cell the mean of each cell's points lies: (N, 3) int8, -8..7.

    The unit is a sixteenth of the voxel's edge, from the cell's centre, rounded down.
    """
    total = _sums(points, cell_of_point, len(grid))
    mean = total[:, :3] / total[:, 3:]
    steps = np.floor((mean - grid.centres()) / grid.voxel_size * OFFSET_STEPS)
    return np.clip(steps, -OFFSET_STEPS // 2, OFFSET_STEPS // 2 - 1).astype(np.int8)


def thin(points: NDArray[np.float64], cell: float) -> NDArray[np.float64]:
    """Return one point, the mean, for every cell of edge `cell` (m) that holds points: (K, 3).

    The lattice is anchored at the frame's origin, so the same points give the same cells however
    many others there are.
    """
    grid, cell_of_point = voxelise(points, cell, np.zeros(3))
    total = _sums(points, cell_of_point, len(grid))
    return total[:, :3] / total[:, 3:]


@njit(cache=True, nogil=True)
def _sums(points, cell_of_point, cells):  # type: ignore[no-untyped-def]
    """Sum of coordinates and number of points of each cell: (cells, 4)."""
    total = np.zeros((cells, 4))
    for i in range(len(points)):
        row = cell_of_point[i]
        for axis in range(3):
            total[row, axis] += points[i, axis]
        total[row, 3] += 1.0
    return total
