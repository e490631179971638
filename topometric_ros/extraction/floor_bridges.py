"""Lines over gaps of a floor: between two seen pieces of it, free all along, with floor unseen.

What a line must show stands in `floor_gaps.py`, which closes the gaps. Lines run along the axes and
the diagonals of the raster; the shortest one over a cell tells the height of its floor.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.extraction.navigation import NavigationConfig
from topometric_ros.voxels.index import VoxelIndex, cells_to_next, row_at
from topometric_ros.voxels.kernels import stick_kernel

NO_FLOOR = np.iinfo(np.int32).min
"""Height of the floor where there is none."""
SLAB = 0.6
"""Below floor that was not seen something may lie this near, m: the other face of its slab."""
_SLOPE = 0.15
"""Steepest ramp, rise over run; the two ends of a gap may differ by a step besides."""
_HEADROOM = 1.4
"""Free height over floor that was not seen, m: a stick fits under counters too."""
_TALLEST = 8.0
"""How far above and below floor that was not seen anything is looked for, m."""
_PANE = 0.4
"""Widest gap, m, that a pane makes: its own cell and the stick's radius on both sides."""
_SPECKS = 0.07
_SPECKS_OF_LAYER = 2
"""Share of the stick's cells that a pane may fill, and cells of one layer: a rail fills more."""
_ROUNDS = 4
"""Gaps are closed at most so many times, each time from what was closed before."""


def bridged(
    floor: NDArray[np.int32],
    corner: NDArray[np.int32],
    index: VoxelIndex,
    size: float,
    config: NavigationConfig,
    lowest: bool,
) -> NDArray[np.int32]:
    """Return the cells that close gaps between cells of a floor, and put them in there.

    Parameters
    ----------
    floor : (nx, ny) int32, the height of the floor in cells, NO_FLOOR where there is none; changed
    corner : (2,) cell of the lattice at the raster's corner
    index : of the occupied voxels
    size : edge of a voxel, m
    config : `gap`, `roofed_gap` and the stick
    lowest : whether there is no storey below, which might be seen through an opening

    Returns
    -------
    (A, 3) int32 cells
    """
    stick = stick_kernel(size, config.thin_height, config.wide_height, config.diameter)
    above = stick.offsets()[stick.weights > 0]
    lengths = (config.gap, config.roofed_gap, _HEADROOM, SLAB, _TALLEST, _PANE, _TALLEST)
    limits = np.array(lengths) / size
    if lowest:
        limits[4] = 0.0
    found = []
    known = np.full((*floor.shape, 4), NO_FLOOR, np.int32)
    for _ in range(_ROUNDS if max(config.gap, config.roofed_gap) > 0.0 else 0):
        closed = _bridges(
            index.table, floor, corner.astype(np.int64), above, np.rint(limits).astype(np.int64),
            math.floor(config.dilation / size + 0.5), known,
        )  # fmt: skip
        new = (closed != NO_FLOOR) & (floor == NO_FLOOR)
        if not new.any():
            break
        floor[new] = closed[new]
        found.append(np.column_stack([np.argwhere(new) + corner, closed[new]]))
    return np.concatenate([np.zeros((0, 3), np.int64), *found]).astype(np.int32)


@njit(cache=True, nogil=True)
def _bridges(table, floor, corner, stick, limits, step, known):  # type: ignore[no-untyped-def]
    """Height of the floor in each gap, from the shortest line over it that is free throughout.

    `known` (nx, ny, 4) keeps what was found out of each cell (:func:`_look`).
    """
    closed = np.full(floor.shape, NO_FLOOR, np.int32)
    shortest = np.full(floor.shape, np.inf)
    widest = max(limits[0], limits[1])
    heights = np.empty(widest + 2, np.int64)
    for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
        edge = math.sqrt(dx * dx + dy * dy)
        for i in range(floor.shape[0]):
            for j in range(floor.shape[1]):
                if floor[i, j] == NO_FLOOR or not _is_gap(floor, i + dx, j + dy):
                    continue
                low = floor[i, j]
                # Most of the rim stands at walls, which the first cell tells.
                _look(known, i + dx, j + dy, low, table, corner, stick, limits)
                if known[i + dx, j + dy, 1] == NO_FLOOR:
                    continue
                count = 1
                while count * edge <= widest and _is_gap(
                    floor, i + dx * (count + 1), j + dy * (count + 1)
                ):
                    count += 1
                x, y = i + dx * (count + 1), j + dy * (count + 1)
                if not (0 <= x < floor.shape[0] and 0 <= y < floor.shape[1]):
                    continue
                rise = floor[x, y] - low
                if floor[x, y] == NO_FLOOR or abs(rise) > step + _SLOPE * (count + 1) * edge:
                    continue
                pane = count * edge <= limits[5]
                roofed, free = True, True
                for n in range(1, count + 1):
                    z = low + math.floor(rise * n / (count + 1) + 0.5)
                    x, y = i + n * dx, j + n * dy
                    _look(known, x, y, z, table, corner, stick, limits)
                    heights[n] = known[x, y, 1]
                    roofed &= known[x, y, 2] == 1
                    free &= heights[n] != NO_FLOOR and (pane or known[x, y, 3] == 0)
                    if not free:
                        break
                if not free or count * edge > (widest if roofed else limits[0]):
                    continue
                for n in range(1, count + 1):
                    x, y = i + n * dx, j + n * dy
                    if count * edge < shortest[x, y]:
                        shortest[x, y] = count * edge
                        closed[x, y] = heights[n]
    return closed


@njit(cache=True, nogil=True)
def _is_gap(floor, x, y):  # type: ignore[no-untyped-def]
    """Whether a cell lies on the raster and holds no floor."""
    return 0 <= x < floor.shape[0] and 0 <= y < floor.shape[1] and floor[x, y] == NO_FLOOR


@njit(cache=True, nogil=True)
def _look(known, x, y, z, table, corner, stick, limits):  # type: ignore[no-untyped-def]
    """Put into `known` at a cell the height asked and what :func:`_floor_at` says of it."""
    if known[x, y, 0] != z:
        found = _floor_at(table, corner[0] + x, corner[1] + y, z, stick, limits)
        known[x, y, 0] = z
        known[x, y, 1], known[x, y, 2], known[x, y, 3] = found


@njit(cache=True, nogil=True)
def _floor_at(table, x, y, z, stick, limits):  # type: ignore[no-untyped-def]
    """Cell near height z that floor may be taken for, NO_FLOOR: none; whether a roof is above; and
    specks where the stick is.

    A voxel seen within a cell of z is floor where the stick fits; none is seen otherwise. In a
    gap no wider than a pane a few specks do not count, such as glass returns.
    """
    seen = False
    for rise in (0, 1, -1):
        if not seen and row_at(table, x, y, z + rise) >= 0:
            seen = True
            z += rise
    specks, level, layer = 0, 0, 0
    for k in range(len(stick)):
        if stick[k, 2] != layer:
            level, layer = 0, stick[k, 2]
        if row_at(table, x + stick[k, 0], y + stick[k, 1], z + stick[k, 2]) >= 0:
            specks += 1
            level += 1
            if level > _SPECKS_OF_LAYER or specks > _SPECKS * len(stick):
                return NO_FLOOR, 0, specks
    above = cells_to_next(table, x, y, z, 1, limits[6])
    if above <= limits[2] and specks == 0:
        return NO_FLOOR, 0, specks
    if not seen:
        below = cells_to_next(table, x, y, z, -1, limits[4])
        if limits[3] < below <= limits[4]:
            return NO_FLOOR, 0, specks
    return z, int(above <= limits[6]), specks
