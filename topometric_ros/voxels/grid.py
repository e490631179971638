"""VoxelGrid: a set of occupied cells on a lattice of cell centres (thesis §4.1.2, eq. 2-8).

The lattice differs from the draft's in two ways that a growing map needs: cells are named by their
centres `origin + k * voxel_size`, and coordinates may be negative, so new space renumbers nothing.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.topometric_map import OFFSET_STEPS
from topometric_ros.voxels.index import (
    EMPTY,
    VoxelIndex,
    bit_count,
    brick_key,
    cell_in_brick,
    slot_of,
)
from topometric_ros.voxels.morton import check_limit, morton_code, morton_decode, morton_encode


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

    @cached_property
    def index(self) -> VoxelIndex:
        """Row of each cell by its coordinates, made when it is first asked for."""
        return VoxelIndex(self.coords)

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
    points = np.ascontiguousarray(points, dtype=np.float64)
    extremes = lattice_coordinates(bounds(points), voxel_size, origin)
    check_limit(int(extremes.min()), int(extremes.max()))
    codes, masks, cell_of_point = _sort_into_bricks(points, float(voxel_size), origin)
    order = np.argsort(codes)
    cells, cell_of_point = _numbered(codes, masks, order, cell_of_point)
    return VoxelGrid(morton_decode(cells), origin, voxel_size), cell_of_point


def lattice_coordinates(
    points: NDArray[np.float64], voxel_size: float, origin: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Return the coordinates of the cell that holds each point: (P, 3) int64."""
    return np.floor((points - origin) / voxel_size + 0.5).astype(np.int64)


def in_morton_order(coords: NDArray[np.integer]) -> NDArray[np.int32]:
    """Return the distinct coordinates among `coords` (N, 3), in Morton order."""
    codes = np.sort(morton_encode(coords))
    return morton_decode(codes[np.append(True, codes[1:] != codes[:-1])] if len(codes) else codes)


@njit(cache=True, nogil=True)
def bounds(points):  # type: ignore[no-untyped-def]
    """Lowest and highest coordinates of points or cells (N, K), N > 0: (2, K)."""
    result = np.empty((2, points.shape[1]), points.dtype)
    for axis in range(points.shape[1]):
        low = high = points[0, axis]
        for i in range(1, len(points)):
            low = min(low, points[i, axis])
            high = max(high, points[i, axis])
        result[0, axis], result[1, axis] = low, high
    return result


def surface_offsets(
    points: NDArray[np.float64], grid: VoxelGrid, cell_of_point: NDArray[np.int64]
) -> NDArray[np.int8]:
    """Return where in its cell the mean of each cell's points lies: (N, 3) int8, -2..1.

    The unit is a quarter of the voxel's edge, from the cell's centre, rounded down.
    """
    return offsets_of_means(means(points, cell_of_point, len(grid)), grid)


def offsets_of_means(mean: NDArray[np.float64], grid: VoxelGrid) -> NDArray[np.int8]:
    """Return what :func:`surface_offsets` does of the mean (N, 3), m, of each cell's points."""
    where = grid.coords, grid.origin, grid.voxel_size
    offsets: NDArray[np.int8] = _steps(mean, *where, OFFSET_STEPS)
    return offsets


@njit(cache=True, nogil=True)
def _steps(mean, coords, origin, voxel_size, count):  # type: ignore[no-untyped-def]
    steps = np.empty(coords.shape, np.int8)
    for row in range(len(coords)):
        for axis in range(3):
            centre = origin[axis] + coords[row, axis] * voxel_size
            step = np.floor((mean[row, axis] - centre) / voxel_size * count)
            steps[row, axis] = min(max(step, -count // 2), count // 2 - 1)
    return steps


def thin(points: NDArray[np.float64], cell: float) -> NDArray[np.float64]:
    """Return one point, the mean, for every cell of edge `cell` (m) that holds points: (K, 3).

    The lattice is anchored at the frame's origin, so the same points give the same cells however
    many others there are.
    """
    grid, cell_of_point = voxelise(points, cell, np.zeros(3))
    return means(points, cell_of_point, len(grid))


@njit(cache=True, nogil=True)
def means(points, cell_of_point, cells):  # type: ignore[no-untyped-def]
    """Mean (cells, 3) of the points (P, 3) of each cell, of which none is empty."""
    total = np.zeros((cells, 3))
    count = np.zeros(cells)
    for i in range(len(points)):
        row = cell_of_point[i]
        for axis in range(3):
            total[row, axis] += points[i, axis]
        count[row] += 1.0
    for row in range(cells):
        for axis in range(3):
            total[row, axis] /= count[row]
    return total


@njit(cache=True, nogil=True)
def _sort_into_bricks(points, voxel_size, origin):  # type: ignore[no-untyped-def]
    """Find the brick of 4 x 4 x 4 cells that holds each point, and the cells with points.

    Sorting a few bricks is much quicker than sorting all points. Returns the bricks' Morton
    codes (B,), their cells as bits (B,), both by first point, and each point's brick and cell in
    it as brick * 64 + bit (P,).
    """
    codes = np.empty(1 << 11, np.uint64)
    masks = np.zeros(1 << 11, np.uint64)
    keys = np.full(1 << 12, EMPTY, np.int64)
    bricks = np.empty(1 << 12, np.int64)
    place = np.empty(len(points), np.int64)
    done, count = _fill(points, voxel_size, origin, 0, 0, keys, bricks, codes, masks, place)
    while done < len(points):
        keys, bricks = _doubled(keys, bricks)
        codes = np.append(codes, np.empty(count, np.uint64))
        masks = np.append(masks, np.zeros(count, np.uint64))
        done, count = _fill(
            points, voxel_size, origin, done, count, keys, bricks, codes, masks, place
        )
    return codes[:count], masks[:count], place


@njit(cache=True, nogil=True)
def _fill(  # type: ignore[no-untyped-def]
    points, voxel_size, origin, done, count, keys, bricks, codes, masks, place
):
    """Put points into bricks until all are done or the arrays full; how many of both there are."""
    slot, last = 0, np.int64(EMPTY)
    for p in range(done, len(points)):
        x = np.int64(np.floor((points[p, 0] - origin[0]) / voxel_size + 0.5))
        y = np.int64(np.floor((points[p, 1] - origin[1]) / voxel_size + 0.5))
        z = np.int64(np.floor((points[p, 2] - origin[2]) / voxel_size + 0.5))
        key = brick_key(x, y, z)
        if key != last:  # points often come in some order of place
            slot, last = slot_of(keys, key), key
        if keys[slot] == EMPTY:
            if count == len(codes):
                return p, count
            keys[slot], bricks[slot] = key, count
            codes[count] = morton_code(x, y, z) >> np.uint64(6)
            count += 1
        low = cell_in_brick(x, y, z)
        masks[bricks[slot]] |= np.uint64(1) << np.uint64(low)
        place[p] = bricks[slot] * 64 + low
    return len(points), count


@njit(cache=True, nogil=True)
def _doubled(keys, values):  # type: ignore[no-untyped-def]
    """Copy a hash table into one twice as large."""
    more_keys = np.full(2 * len(keys), EMPTY, np.int64)
    more_values = np.empty(2 * len(keys), np.int64)
    for i in range(len(keys)):
        if keys[i] != EMPTY:
            slot = slot_of(more_keys, keys[i])
            more_keys[slot], more_values[slot] = keys[i], values[i]
    return more_keys, more_values


@njit(cache=True, nogil=True)
def _numbered(codes, masks, order, place):  # type: ignore[no-untyped-def]
    """Number the cells of sorted bricks: their codes (N,), and the row of each point (P,)."""
    first = np.empty(len(codes), np.int64)
    total = 0
    for brick in order:
        first[brick] = total
        total += bit_count(masks[brick])
    cells = np.empty(total, np.uint64)
    row = 0
    for brick in order:
        for bit in range(64):
            if (masks[brick] >> np.uint64(bit)) & np.uint64(1):
                cells[row] = (codes[brick] << np.uint64(6)) | np.uint64(bit)
                row += 1
    rows = np.empty(len(place), np.int64)
    for p in range(len(place)):
        brick = place[p] >> 6
        below = (np.uint64(1) << np.uint64(place[p] & 63)) - np.uint64(1)
        rows[p] = first[brick] + bit_count(masks[brick] & below)
    return cells, rows
