"""Compiled loops of the scan grid: points into cells, and the cells that rays look through.

Cells lie in bricks of 4 x 4 x 4; a hash table leads from a brick to its number, and `rows[brick]`
from the place in it to the row of the cell's data, -1 where no point ever lay. Rays step from cell
to cell exactly, in whole numbers, as in `raycast.py`.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.voxels.index import BRICK_OFFSET, EMPTY, brick_key, slot_of
from topometric_ros.voxels.raycast import STEPS, ray_axis

HITS, MISSES, HIT_AT, MISSED_AT, KEPT = range(5)
"""Columns of a cell's evidence: scans that hit it and looked through it, when last, and whether it
was kept when the points were last taken."""

MOST = 255
"""Counts are halved when one would exceed this: both, so that their ratio stays."""

FULLEST = 4095
"""Points whose mean a cell keeps: the first."""


@njit(cache=True, nogil=True)
def rehash(keys, numbers, bricks, count):  # type: ignore[no-untyped-def]
    """Fill an empty table with the keys of the first `count` bricks."""
    for number in range(count):
        slot = slot_of(keys, bricks[number])
        keys[slot] = bricks[number]
        numbers[slot] = number


@njit(cache=True, nogil=True)
def put(keys, numbers, bricks, rows, sums, counts, evidence, used, points, cell, now, ends, first):  # type: ignore[no-untyped-def]
    """Put points into their cells until a table is full.

    `used` holds the number of bricks and of cells; `points` are relative to the anchor; `ends`
    takes the first point of each cell that this scan hits. Returns the next point and how many
    ends there are.
    """
    found = first[1]
    for i in range(first[0], len(points)):
        x = np.int64(np.floor(points[i, 0] / cell + 0.5))
        y = np.int64(np.floor(points[i, 1] / cell + 0.5))
        z = np.int64(np.floor(points[i, 2] / cell + 0.5))
        key = brick_key(x, y, z)
        slot = slot_of(keys, key)
        if keys[slot] == EMPTY:
            if used[0] == len(bricks):
                return i, found
            keys[slot] = key
            numbers[slot] = used[0]
            bricks[used[0]] = key
            used[0] += 1
        number = numbers[slot]
        place = (x & 3) | ((y & 3) << 2) | ((z & 3) << 4)
        row = rows[number, place]
        if row < 0:
            if used[1] == len(counts):
                return i, found
            row = used[1]
            rows[number, place] = row
            used[1] += 1
        if counts[row] < FULLEST:
            sums[row, 0] += np.float32(points[i, 0] - x * cell)
            sums[row, 1] += np.float32(points[i, 1] - y * cell)
            sums[row, 2] += np.float32(points[i, 2] - z * cell)
            counts[row] += 1
        if evidence[row, HIT_AT] != now:
            evidence[row, HIT_AT] = now
            count_one(evidence, row, HITS)
            ends[found] = i
            found += 1
    return len(points), found


@njit(cache=True, nogil=True)
def count_one(evidence, row, kind):  # type: ignore[no-untyped-def]
    """Add one to a cell's hits or misses."""
    if evidence[row, kind] == MOST:
        evidence[row, HITS] >>= 1
        evidence[row, MISSES] >>= 1
    evidence[row, kind] += 1


@njit(cache=True, nogil=True)
def look_through(keys, numbers, rows, sums, counts, evidence, origin, ends, cell, core, now):  # type: ignore[no-untyped-def]
    """Count a miss for each cell that a ray of this scan passes within `core` of its mean point.

    `origin` (3,) and `ends` (R, 3) are relative to the anchor, m; where the rays end, the caller
    has drawn them short of the surface. A cell that the scan hits is not missed by it, and none
    is missed twice.
    """
    start = np.empty(3, np.int64)
    end = np.empty(3, np.int64)
    for axis in range(3):
        start[axis] = np.int64(np.floor(origin[axis] / cell * STEPS + 0.5))
    core2 = core * core
    for i in range(len(ends)):
        length2 = 0.0
        for axis in range(3):
            end[axis] = np.int64(np.floor(ends[i, axis] / cell * STEPS + 0.5))
            length2 += (ends[i, axis] - origin[axis]) ** 2
        wide = max(abs(end[0] - start[0]), 1)
        deep = max(abs(end[1] - start[1]), 1)
        high = max(abs(end[2] - start[2]), 1)
        last = wide * deep * high
        x, dx, tx, ex = ray_axis(start[0], end[0], deep * high)
        y, dy, ty, ey = ray_axis(start[1], end[1], high * wide)
        z, dz, tz, ez = ray_axis(start[2], end[2], wide * deep)
        brick = np.int64(EMPTY)
        number = np.int64(EMPTY)
        now_at = np.int64(0)
        while now_at < last:
            key = brick_key(x, y, z)
            if key != brick:
                brick = key
                slot = slot_of(keys, key)
                number = numbers[slot] if keys[slot] == key else np.int64(EMPTY)
            if number >= 0:
                row = rows[number, (x & 3) | ((y & 3) << 2) | ((z & 3) << 4)]
                if row >= 0 and evidence[row, HIT_AT] != now and evidence[row, MISSED_AT] != now:
                    n = counts[row]
                    px = x * cell + sums[row, 0] / n - origin[0]
                    py = y * cell + sums[row, 1] / n - origin[1]
                    pz = z * cell + sums[row, 2] / n - origin[2]
                    rx = ends[i, 0] - origin[0]
                    ry = ends[i, 1] - origin[1]
                    rz = ends[i, 2] - origin[2]
                    along = (px * rx + py * ry + pz * rz) / length2
                    off = (px - along * rx) ** 2 + (py - along * ry) ** 2 + (pz - along * rz) ** 2
                    if off < core2:
                        evidence[row, MISSED_AT] = now
                        count_one(evidence, row, MISSES)
            now_at = min(tx, ty, tz)
            if tx == now_at:
                x, tx = x + dx, tx + ex
            if ty == now_at:
                y, ty = y + dy, ty + ey
            if tz == now_at:
                z, tz = z + dz, tz + ez


@njit(cache=True, nogil=True)
def hit_beside(keys, numbers, rows, evidence, points, cell, now):  # type: ignore[no-untyped-def]
    """Note a hit now for all cells that hold points of a scan or lie beside those that do."""
    for i in range(len(points)):
        x = np.int64(np.floor(points[i, 0] / cell + 0.5))
        y = np.int64(np.floor(points[i, 1] / cell + 0.5))
        z = np.int64(np.floor(points[i, 2] / cell + 0.5))
        for near in range(27):
            nx, ny, nz = x + near % 3 - 1, y + near // 3 % 3 - 1, z + near // 9 - 1
            key = brick_key(nx, ny, nz)
            slot = slot_of(keys, key)
            if keys[slot] == key:
                row = rows[numbers[slot], (nx & 3) | ((ny & 3) << 2) | ((nz & 3) << 4)]
                if row >= 0:
                    evidence[row, HIT_AT] = now


@njit(cache=True, nogil=True)
def is_kept(evidence, row, least, ratio):  # type: ignore[no-untyped-def]
    """Whether what lies in a cell still stands there."""
    misses = evidence[row, MISSES]
    return misses < least or misses < ratio * evidence[row, HITS]


def kept(evidence: NDArray[np.uint8], least: int, ratio: float) -> NDArray[np.bool_]:
    """Return which cells of evidence (K, 5) are kept, as :func:`is_kept` says of one: (K,)."""
    hits, misses = evidence[:, HITS], evidence[:, MISSES]
    return (misses < least) | (misses < ratio * hits)


def cells_of(bricks: NDArray[np.int64], places: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the coordinates of cells (K, 3) from their bricks' keys and places in these (K,)."""
    low = (1 << 20) - 1
    corners = np.stack([bricks >> 40, (bricks >> 20) & low, bricks & low], 1) - BRICK_OFFSET
    return (corners << 2) + np.stack([places & 3, (places >> 2) & 3, places >> 4], 1)


@njit(cache=True, nogil=True)
def changes(evidence, count, least, ratio):  # type: ignore[no-untyped-def]
    """Return how many cells are kept now, and how many came or went since the last `mark`."""
    kept = 0
    changed = 0
    for row in range(count):
        state = is_kept(evidence, row, least, ratio)
        kept += state
        changed += state != (evidence[row, KEPT] == 1)
    return kept, changed


@njit(cache=True, nogil=True)
def means(bricks, order, rows, sums, counts, evidence, cell, least, ratio, kept):  # type: ignore[no-untyped-def]
    """Return the mean points of the cells kept, brick by brick, and mark them as taken: (K, 3)."""
    points = np.empty((kept, 3))
    n = 0
    low = (np.int64(1) << 20) - 1
    for k in range(len(order)):
        key = bricks[order[k]]
        bx = ((key >> 40) - BRICK_OFFSET) << 2
        by = (((key >> 20) & low) - BRICK_OFFSET) << 2
        bz = ((key & low) - BRICK_OFFSET) << 2
        for place in range(64):
            row = rows[order[k], place]
            if row < 0:
                continue
            state = is_kept(evidence, row, least, ratio)
            evidence[row, KEPT] = 1 if state else 0
            if state:
                total = counts[row]
                points[n, 0] = (bx + (place & 3)) * cell + sums[row, 0] / total
                points[n, 1] = (by + ((place >> 2) & 3)) * cell + sums[row, 1] / total
                points[n, 2] = (bz + (place >> 4)) * cell + sums[row, 2] / total
                n += 1
    return points
