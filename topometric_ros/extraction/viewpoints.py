"""Viewpoints: where an agent would see most (thesis §4.2.5-4.2.6, Algorithms 2 and 3).

The horizontal distance field tells how far every navigable voxel lies from the edge of the
navigable volume; its local maxima, lifted to eye height, are the viewpoints. A hall has one maximum
in its middle, from where nobody sees its ends, so `cover` puts further ones between it and them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.configuration import parameter
from topometric_ros.voxels.grid import VoxelGrid, in_morton_order
from topometric_ros.voxels.index import VoxelIndex, row_at
from topometric_ros.voxels.kernels import ball

_LATTICE = 0.5
"""Places for further viewpoints lie so far apart in x and y, m."""

_LARGEST_DISTANCE = 200
"""Cells at which the distance field saturates: 20 m at 0.1 m, wider than any room's middle."""


@dataclass(frozen=True)
class ViewpointConfig:
    """Where viewpoints are put; the defaults are the thesis' values but for `spacing`."""

    radius: float = parameter(
        0.5,
        "A viewpoint stands where no navigable voxel within this radius is farther from the edge.",
        unit="m",
        minimum=0.0,
        maximum=5.0,
    )
    boundary: int = parameter(
        1,
        "Smallest distance of a viewpoint from the boundary voxels.",
        unit="voxels",
        minimum=0,
    )
    height: float = parameter(
        1.5, "Height of the eye above the floor voxel.", unit="m", minimum=0.0, maximum=5.0
    )
    height_limit: float = parameter(
        1.8,
        "Where the eye would be inside a voxel it is raised up to this height to get out.",
        unit="m",
        minimum=0.0,
        maximum=5.0,
    )
    step: int = parameter(
        0,
        "Difference of height between horizontal neighbours that the distance field steps over.",
        unit="voxels",
        minimum=0,
        maximum=10,
    )
    spacing: float = parameter(
        0.5,
        "Viewpoints closer to a better or an equal one are left out; 0 keeps all of a plateau.",
        unit="m",
        minimum=0.0,
        maximum=5.0,
    )
    cover: float = parameter(
        0.0,
        "Where floor lies farther than this from every viewpoint there are further ones; "
        "0 puts none.",
        unit="m",
        minimum=0.0,
        maximum=50.0,
    )


def horizontal_distance_field(
    navigable: NDArray[np.int32], step: int = 0, index: VoxelIndex | None = None
) -> NDArray[np.int32]:
    """Return each voxel's distance to the boundary, in circles (Algorithm 2, eq. 26).

    The draft calls it a Manhattan distance but grows circles, and circles it is: the value is the
    smallest whole radius r >= 1 whose disk x² + y² <= r² round the voxel, on its own layer, is not
    full. It is 1 for a boundary voxel, and otherwise the Euclidean distance to the nearest missing
    cell, rounded up. It saturates at 200 cells.

    With `step` > 0 a cell of the disk counts as full when a navigable voxel stands there at most
    `step` cells above or below that of the next cell towards the middle; floor noise, ramps and
    stairs are then no boundary.

    Parameters
    ----------
    navigable : (M, 3) int32, distinct cells in Morton order
    step : cells of height between horizontal neighbours
    index : of `navigable`, if the caller has one

    Returns
    -------
    (M,) int32, cells
    """
    if len(navigable) == 0:
        return np.zeros(0, np.int32)
    index = VoxelIndex(navigable) if index is None else index
    # A disk larger than the whole volume, in extent or in cells, is not full.
    widest = int(np.ptp(navigable[:, :2], axis=0).max()) + 2
    most = int(math.sqrt(len(navigable) / math.pi)) + 3
    disk, inner, square = _disk(min(widest, most, _LARGEST_DISTANCE))
    return _distances(index.table, navigable, disk, inner, square, step)


def _disk(
    radius: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64]]:
    """Return a disk's cells from the middle out: offsets, the next cell inwards, squared radius.

    The next cell inwards lies on the line to the middle, rounded away from zero in both axes, so
    that a quarter turn of the disk turns it too.
    """
    line = np.arange(-radius, radius + 1)
    x, y = (g.ravel() for g in np.meshgrid(line, line, indexing="ij"))
    square = x * x + y * y
    order = np.flatnonzero(square <= radius * radius)
    order = order[np.argsort(square[order], kind="stable")]
    x, y, square = x[order], y[order], square[order]
    larger = np.maximum(np.maximum(np.abs(x), np.abs(y)), 1)

    def inwards(v: NDArray[np.int64]) -> NDArray[np.int64]:
        shorter = (2 * np.abs(v) * (larger - 1) + larger) // (2 * larger)
        return np.sign(v) * shorter

    place = np.zeros((2 * radius + 1, 2 * radius + 1), np.int64)
    place[x + radius, y + radius] = np.arange(len(x))
    return np.stack([x, y], 1), place[inwards(x) + radius, inwards(y) + radius], square


@njit(cache=True, nogil=True)
def _distances(table, coords, disk, inner, square, step):  # type: ignore[no-untyped-def]
    """Squared distance to the first missing cell of the disk, then its root, rounded up.

    On the voxel's own layer, `level`, a disk that is full round the neighbour is full round this
    voxel but for one cell's width; the neighbour's code is lower, so it has been measured already.
    """
    level = np.empty(len(coords), np.int64)
    radius = np.empty(len(coords), np.int32)
    height = np.empty(len(disk), np.int64)
    for i in range(len(coords)):
        x, y, z = np.int64(coords[i, 0]), np.int64(coords[i, 1]), np.int64(coords[i, 2])
        before = row_at(table, x - 1, y, z)
        sure = math.sqrt(level[before]) - 1.0 - 1e-9 if before >= 0 else 0.0
        k = max(1, np.searchsorted(square, sure * sure)) if sure > 0.0 else 1
        while k < len(disk) and row_at(table, x + disk[k, 0], y + disk[k, 1], z) >= 0:
            k += 1
        level[i] = square[min(k, len(disk) - 1)]
        if step > 0:
            height[:k] = z
            while k < len(disk):
                rise = _stepped(table, x + disk[k, 0], y + disk[k, 1], height[inner[k]], step)
                if rise > step:
                    break
                height[k] = height[inner[k]] + rise
                k += 1
        radius[i] = max(1, math.ceil(math.sqrt(square[min(k, len(disk) - 1)])))
    return radius


@njit(cache=True, nogil=True)
def _stepped(table, x, y, z, step):  # type: ignore[no-untyped-def]
    """Smallest step from height z to a voxel in a column, down before up; past `step`: none."""
    if row_at(table, x, y, z) >= 0:
        return 0
    for rise in range(1, step + 1):
        if row_at(table, x, y, z - rise) >= 0:
            return -rise
        if row_at(table, x, y, z + rise) >= 0:
            return rise
    return step + 1


def local_maxima(
    navigable: NDArray[np.int32],
    distance: NDArray[np.int32],
    radius: float,
    index: VoxelIndex | None = None,
) -> NDArray[np.bool_]:
    """Return which voxels no other within `radius` cells exceeds (eq. 27, Algorithm 3): (M,)."""
    index = VoxelIndex(navigable) if index is None else index
    offsets = ball(radius).offsets()
    # Most voxels have a better one nearby.
    offsets = offsets[np.argsort((offsets**2).sum(axis=1), kind="stable")]
    return _maxima(index.table, navigable, distance, offsets)


@njit(cache=True, nogil=True)
def _maxima(table, coords, distance, offsets):  # type: ignore[no-untyped-def]
    result = np.ones(len(coords), np.bool_)
    for i in range(len(coords)):
        for k in range(len(offsets)):
            row = row_at(
                table,
                coords[i, 0] + offsets[k, 0],
                coords[i, 1] + offsets[k, 1],
                coords[i, 2] + offsets[k, 2],
            )
            if row >= 0 and distance[row] > distance[i]:
                result[i] = False
                break
    return result


def viewpoints(
    navigable: NDArray[np.int32], grid: VoxelGrid, config: ViewpointConfig
) -> NDArray[np.float64]:
    """Return the positions with the best views (eq. 28, Algorithm 3).

    Equation 27 keeps every voxel of a plateau, and everything after costs the square of their
    number. Deviation: of maxima within `spacing` of each other only the first stays, the farthest
    from the boundary first, equal ones in Morton order. Where `cover` is given, floor that no
    maximum is near to gets viewpoints of its own.

    Parameters
    ----------
    navigable : (M, 3) int32, in Morton order
    grid : the occupied voxels
    config : radius, heights and thinning

    Returns
    -------
    (K, 3) float64, m, level frame, in Morton order of the voxels they stand on
    """
    if len(navigable) == 0:
        return np.zeros((0, 3))
    index = VoxelIndex(navigable)
    distance = horizontal_distance_field(navigable, config.step, index)
    peak = local_maxima(navigable, distance, config.radius / grid.voxel_size, index)
    peak &= distance > config.boundary
    standing = _thinned(navigable[peak], distance[peak], config.spacing / grid.voxel_size)
    if config.cover > 0.0:
        step = max(1, round(_LATTICE / grid.voxel_size))
        on = (navigable[:, :2] % step == 0).all(axis=1) & (distance > config.boundary)
        further = _covering(navigable[on], distance[on], standing, config.cover / grid.voxel_size)
        standing = in_morton_order(np.concatenate([standing, further]))
    return _lifted(standing, grid, config)


def _thinned(
    coords: NDArray[np.int32], distance: NDArray[np.int32], spacing: float
) -> NDArray[np.int32]:
    """Return the maxima that no better one lies within `spacing` cells of, in Morton order."""
    if spacing <= 0 or len(coords) == 0:
        return coords
    best_first = coords[np.argsort(-distance, kind="stable")]
    kept = _greedy(VoxelIndex(best_first).table, best_first, ball(spacing).offsets())
    return in_morton_order(best_first[kept])


def _covering(
    coords: NDArray[np.int32],
    distance: NDArray[np.int32],
    standing: NDArray[np.int32],
    radius: float,
) -> NDArray[np.int32]:
    """Choose voxels so that none is left without a chosen or a `standing` one within `radius`.

    The farthest from the boundary comes first, equal ones in Morton order.
    """
    chosen = [standing[:0]]
    left = coords[np.argsort(-distance, kind="stable")]
    if len(standing):
        left = left[~np.isfinite(cKDTree(standing).query(left, distance_upper_bound=radius)[0])]
    while len(left):
        chosen.append(left[:1])
        left = left[np.linalg.norm(left - left[0], axis=1) > radius]
    return np.concatenate(chosen)


@njit(cache=True, nogil=True)
def _greedy(table, coords, offsets):  # type: ignore[no-untyped-def]
    kept = np.ones(len(coords), np.bool_)
    for i in range(len(coords)):
        if not kept[i]:
            continue
        for k in range(len(offsets)):
            row = row_at(
                table,
                coords[i, 0] + offsets[k, 0],
                coords[i, 1] + offsets[k, 1],
                coords[i, 2] + offsets[k, 2],
            )
            if row > i:
                kept[row] = False
    return kept


def _lifted(
    standing: NDArray[np.int32], grid: VoxelGrid, config: ViewpointConfig
) -> NDArray[np.float64]:
    """Return eyes above voxels, raised out of occupied cells, without those that stay inside."""
    centres = grid.origin + standing * grid.voxel_size
    result = np.zeros_like(centres)
    seeing = np.zeros(len(centres), bool)
    rises = max(0, math.floor((config.height_limit - config.height) / grid.voxel_size + 1e-9))
    for rise in range(rises + 1):
        lift = config.height + rise * grid.voxel_size
        cells = standing + (0, 0, math.floor(lift / grid.voxel_size + 0.5))
        free = ~seeing & (grid.index.rows(cells) < 0)
        result[free] = centres[free] + (0.0, 0.0, lift)
        seeing |= free
    return result[seeing]
