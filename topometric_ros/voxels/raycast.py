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
from topometric_ros.voxels.index import VoxelIndex, bit_count, brick_bit, brick_slot, rows_within

STEPS = 256
"""Positions are rounded to this part of a cell: 0.4 mm at 0.1 m."""
LONGEST_RAY = 4000
"""Extent of a ray along each axis, in cells; products of three extents must fit 64 bits."""

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
    return np.sort(seen_rows(index.table, coords, start[0], position, float(radius)))


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
def _begin(start, end):  # type: ignore[no-untyped-def]
    """First cell, direction, next crossing and its increment for each axis, and the ray's end.

    Crossings are times along the ray, multiplied by the product of its extents to be whole.
    """
    cell = (start + STEPS // 2) // STEPS
    step = np.zeros(3, np.int64)
    crossing = np.full(3, _NEVER)
    increment = np.zeros(3, np.int64)
    extent = np.maximum(np.abs(end - start), 1)
    last = extent[0] * extent[1] * extent[2]
    for axis in range(3):
        if end[axis] == start[axis]:
            continue
        others = last // extent[axis]
        low = cell[axis] * STEPS - STEPS // 2
        if end[axis] > start[axis]:
            step[axis] = 1
            crossing[axis] = (low + STEPS - start[axis]) * others
        else:
            step[axis] = -1
            crossing[axis] = (start[axis] - low) * others
        increment[axis] = STEPS * others
    return cell, step, crossing, increment, last


@njit(cache=True, nogil=True)
def _cells(start, end):  # type: ignore[no-untyped-def]
    cell, step, crossing, increment, last = _begin(start, end)
    cells = [(cell[0], cell[1], cell[2])]
    while True:
        now = crossing.min()
        if now >= last:
            break
        for axis in range(3):
            if crossing[axis] == now:
                cell[axis] += step[axis]
                crossing[axis] += increment[axis]
        cells.append((cell[0], cell[1], cell[2]))
    result = np.empty((len(cells), 3), np.int64)
    for i in range(len(cells)):
        result[i, 0], result[i, 1], result[i, 2] = cells[i]
    return result


@njit(cache=True, nogil=True)
def _first_hit(table, start, end):  # type: ignore[no-untyped-def]
    """Row of the first occupied voxel on a ray, -1 if none; looks bricks up once each."""
    cell, step, crossing, increment, last = _begin(start, end)
    x, y, z = cell[0], cell[1], cell[2]
    cx, cy, cz = crossing[0], crossing[1], crossing[2]
    brick = (x >> 2, y >> 2, z >> 2)
    slot = brick_slot(table, x, y, z)
    mask = table[1][slot]
    while True:
        now = min(cx, cy, cz)
        if now >= last:
            return np.int64(-1)
        if cx == now:
            x += step[0]
            cx += increment[0]
        if cy == now:
            y += step[1]
            cy += increment[1]
        if cz == now:
            z += step[2]
            cz += increment[2]
        if (x >> 2) != brick[0] or (y >> 2) != brick[1] or (z >> 2) != brick[2]:
            brick = (x >> 2, y >> 2, z >> 2)
            slot = brick_slot(table, x, y, z)
            mask = table[1][slot]
        if mask != np.uint64(0):
            bit = brick_bit(x, y, z)
            if mask & bit != np.uint64(0):
                return table[3][table[2][slot] + bit_count(mask & (bit - np.uint64(1)))]


@njit(cache=True, nogil=True)
def _first_hits(table, starts, ends):  # type: ignore[no-untyped-def]
    rows = np.empty(len(starts), np.int64)
    for i in range(len(starts)):
        rows[i] = _first_hit(table, starts[i], ends[i])
    return rows


@njit(cache=True, nogil=True)
def seen_rows(table, coords, start, position, radius):  # type: ignore[no-untyped-def]
    """Rows of the voxels within `radius` whose centre a ray from `start` reaches, not sorted."""
    near = rows_within(table, position, radius)
    end = np.empty(3, np.int64)
    count = 0
    for row in near:
        for axis in range(3):
            end[axis] = coords[row, axis] * STEPS
        if _first_hit(table, start, end) == row:
            near[count] = row
            count += 1
    return near[:count]
