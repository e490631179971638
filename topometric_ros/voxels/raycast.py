"""Exact voxel traversal of rays (thesis Algorithm 5, mended: Amanatides & Woo 1987).

The draft's listing never updates its nearest plane, steps several axes at once, divides by zero on
axis-parallel rays and reports a hit when it leaves the grid. Here a ray is a segment between two
points rounded to 1/256 of a cell, so every comparison is one of integers and nothing is left to
floating point.

Tie rule: a ray enters exactly the cells that hold a stretch of it. Through an edge or a corner it
passes into the opposite cell without entering those beside it; along a face shared by two cells
it runs in the one with the higher coordinate (cells are half open: centre - ½ <= x < centre + ½).
The rule is the same in every direction. The cell that the ray starts in never stops it.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.voxels.index import VoxelIndex, row_at, rows_within

STEPS = 256
"""Positions are rounded to this part of a cell: 0.4 mm at 0.1 m."""
LONGEST_RAY = 4000
"""Extent of a ray along each axis, in cells; products of three extents must fit 64 bits."""

_STEP_BITS = 8
_LARGEST_BOX = 1 << 26
"""Cells, a byte each, of the dense copy of what lies round a position."""
_NEVER = np.int64(1) << np.int64(62)


class RayError(TopometricError):
    """A ray that is too long or not finite."""


def first_hit(
    index: VoxelIndex, origins: NDArray[np.float64], targets: NDArray[np.float64]
) -> NDArray[np.int64]:
    """Return the row of the first occupied voxel that each ray enters, -1 if there is none.

    Parameters
    ----------
    index : of the occupied voxels
    origins, targets : (R, 3) float64, ends of the rays, in cells on the lattice of the index
        (a cell's centre has whole coordinates); one origin may serve all

    Returns
    -------
    (R,) int64; the origin's own cell is not counted, the target's is if the ray enters it

    Raises
    ------
    RayError
        A ray is longer than 4000 cells along an axis, or not finite.
    """
    start, end = _rounded(origins, targets)
    return _first_hits(index.table, start, end)


def traversed(origin: NDArray[np.float64], target: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the cells that a ray enters, in order, the origin's first: (K, 3) int64."""
    start, end = _rounded(origin[None], target[None])
    return _cells(start[0], end[0])


def visible(
    index: VoxelIndex, position: NDArray[np.float64], radius: float, coords: NDArray[np.int32]
) -> NDArray[np.int64]:
    """Return the rows of the voxels seen from a position (Algorithm 4), sorted.

    A voxel is seen when the ray to its centre enters no other occupied voxel before it.

    Parameters
    ----------
    index : of `coords`
    position : (3,) float64, in cells
    radius : how far is looked, in cells, to the voxels' centres
    coords : (N, 3) int32, the occupied voxels
    """
    start, _ = _rounded(position[None], position[None] + min(radius, LONGEST_RAY - 1))
    return np.sort(seen_rows(index.table, coords, start[0], float(radius)))


def _rounded(
    origins: NDArray[np.float64], targets: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return both ends of rays in 1/256 of a cell; raises RayError."""
    origins, targets = np.broadcast_arrays(
        np.atleast_2d(np.asarray(origins, float)), np.atleast_2d(np.asarray(targets, float))
    )
    extent = np.abs(targets - origins).max() if origins.size else 0.0
    if not extent <= LONGEST_RAY:
        raise RayError(f"a ray extends {extent} cells along an axis; at most {LONGEST_RAY}")
    start, end = (np.floor(p * STEPS + 0.5).astype(np.int64) for p in (origins, targets))
    return start, end


@njit(cache=True, nogil=True)
def ray_axis(start, end, others):  # type: ignore[no-untyped-def]
    """First cell, direction, first crossing and time between crossings along one axis.

    Times run along the ray and are multiplied by the product of its three extents (0 counting as
    1) to be whole; `others` is the product of the other two.
    """
    cell = (start + STEPS // 2) >> _STEP_BITS
    low = (cell << _STEP_BITS) - STEPS // 2
    if end > start:
        return cell, np.int64(1), (low + STEPS - start) * others, STEPS * others
    if end < start:
        return cell, np.int64(-1), (start - low) * others, STEPS * others
    return cell, np.int64(0), _NEVER, np.int64(0)


@njit(cache=True, nogil=True)
def _cells(start, end):  # type: ignore[no-untyped-def]
    extent = np.maximum(np.abs(end - start), 1)
    last = extent[0] * extent[1] * extent[2]
    x, dx, tx, ex = ray_axis(start[0], end[0], extent[1] * extent[2])
    y, dy, ty, ey = ray_axis(start[1], end[1], extent[2] * extent[0])
    z, dz, tz, ez = ray_axis(start[2], end[2], extent[0] * extent[1])
    cells = [(x, y, z)]
    now = min(tx, ty, tz)
    while now < last:
        if tx == now:
            x, tx = x + dx, tx + ex
        if ty == now:
            y, ty = y + dy, ty + ey
        if tz == now:
            z, tz = z + dz, tz + ez
        cells.append((x, y, z))
        now = min(tx, ty, tz)
    return np.array(cells)


@njit(cache=True, nogil=True)
def _first_hit(table, start, end):  # type: ignore[no-untyped-def]
    """Row of the first occupied voxel on a ray, -1 if none; steps as `_cells` does."""
    wide = max(abs(end[0] - start[0]), 1)
    deep = max(abs(end[1] - start[1]), 1)
    high = max(abs(end[2] - start[2]), 1)
    last = wide * deep * high
    x, dx, tx, ex = ray_axis(start[0], end[0], deep * high)
    y, dy, ty, ey = ray_axis(start[1], end[1], high * wide)
    z, dz, tz, ez = ray_axis(start[2], end[2], wide * deep)
    now = min(tx, ty, tz)
    while now < last:
        if tx == now:
            x, tx = x + dx, tx + ex
        if ty == now:
            y, ty = y + dy, ty + ey
        if tz == now:
            z, tz = z + dz, tz + ez
        row = row_at(table, x, y, z)
        if row >= 0:
            return row
        now = min(tx, ty, tz)
    return np.int64(-1)


@njit(cache=True, nogil=True)
def _first_hits(table, starts, ends):  # type: ignore[no-untyped-def]
    rows = np.empty(len(starts), np.int64)
    for i in range(len(starts)):
        rows[i] = _first_hit(table, starts[i], ends[i])
    return rows


@njit(cache=True, nogil=True)
def seen_rows(table, coords, start, radius):  # type: ignore[no-untyped-def]
    """Rows of the voxels within `radius` cells whose centre a ray from `start` reaches, unsorted.

    `start` (3,) int64 is in 1/256 of a cell. All rays of one position cross the same small space,
    so its voxels are copied into a dense box first: a step is then one look into memory that the
    processor keeps at hand. Where the box would be too large the hash table serves.
    """
    position = start / STEPS
    # A ray within the radius may touch voxels whose centre lies up to half a diagonal beyond it.
    near = rows_within(table, position, radius + 1.0)
    low = (start + STEPS // 2) >> _STEP_BITS
    high = low.copy()
    for row in near:
        for axis in range(3):
            low[axis] = min(low[axis], coords[row, axis])
            high[axis] = max(high[axis], coords[row, axis])
    shape = high - low + 1
    dense = shape[0] * shape[1] * shape[2] <= _LARGEST_BOX
    box = np.zeros(shape[0] * shape[1] * shape[2] if dense else 0, np.bool_)
    if dense:
        for row in near:
            x, y, z = coords[row, 0] - low[0], coords[row, 1] - low[1], coords[row, 2] - low[2]
            box[(x * shape[1] + y) * shape[2] + z] = True
    end = np.empty(3, np.int64)
    count = 0
    for row in near:
        square = 0.0
        for axis in range(3):
            end[axis] = np.int64(coords[row, axis]) << _STEP_BITS
            square += (coords[row, axis] - position[axis]) ** 2
        if square > radius * radius:
            continue
        if dense:
            # What hides a voxel is often its neighbour, so the ray starts at the voxel.
            seen = _is_free(box, low, shape, end, start)
        else:
            hit = _first_hit(table, start, end)
            seen = hit == row or hit < 0  # the voxel that holds the start is seen, too
        if seen:
            near[count] = row
            count += 1
    return near[:count]


@njit(cache=True, nogil=True)
def _is_free(box, low, shape, start, end):  # type: ignore[no-untyped-def]
    """Whether a ray enters no occupied cell between those of its ends; steps as `_cells` does."""
    wide = max(abs(end[0] - start[0]), 1)
    deep = max(abs(end[1] - start[1]), 1)
    high = max(abs(end[2] - start[2]), 1)
    last = wide * deep * high
    x, dx, tx, ex = ray_axis(start[0], end[0], deep * high)
    y, dy, ty, ey = ray_axis(start[1], end[1], high * wide)
    z, dz, tz, ez = ray_axis(start[2], end[2], wide * deep)
    across, along = shape[1] * shape[2], shape[2]
    place = (x - low[0]) * across + (y - low[1]) * along + z - low[2]
    target = ((end[0] + STEPS // 2) >> _STEP_BITS) - low[0]
    target = target * shape[1] + ((end[1] + STEPS // 2) >> _STEP_BITS) - low[1]
    target = target * shape[2] + ((end[2] + STEPS // 2) >> _STEP_BITS) - low[2]
    dx, dy = dx * across, dy * along
    now = min(tx, ty, tz)
    while now < last:
        if tx == now:
            place, tx = place + dx, tx + ex
        if ty == now:
            place, ty = place + dy, ty + ey
        if tz == now:
            place, tz = place + dz, tz + ez
        if box[place]:
            return place == target
        now = min(tx, ty, tz)
    return True
