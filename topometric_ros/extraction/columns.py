"""Columns of voxels: what lies above and below each voxel, and their raster seen from above.

Storeys and rooms are read from columns (`storeys.py`, `walls.py`), so the voxels are sorted into
them once. Memory grows with the voxels and the area of the raster, not with the volume.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.voxels.grid import bounds

NOTHING = 1 << 20
"""Cells to the next occupied voxel where there is none."""


@dataclass(frozen=True)
class Columns:
    """Voxels sorted into columns; voxel arrays are in the order of the coordinates given.

    `above` and `below` count the cells from each voxel to the next occupied one in its column
    (1: adjacent, `NOTHING`: none), `horizontal` says that nothing is occupied two to four cells
    above or below it. `order` sorts the voxels by column and z; column c holds
    `order[starts[c]:starts[c + 1]]` and lies at raster cell `cells[c]`, whose coordinate in x and
    y is `corner + cells[c]`; the raster has `shape` cells.
    """

    z: NDArray[np.int32]
    above: NDArray[np.int32]
    below: NDArray[np.int32]
    horizontal: NDArray[np.bool_]
    order: NDArray[np.int64]
    starts: NDArray[np.int64]
    cells: NDArray[np.int32]
    corner: NDArray[np.int32]
    shape: tuple[int, int]

    def raster_cells(self) -> NDArray[np.int32]:
        """Return the raster cell of every voxel: (N, 2) int32."""
        cells: NDArray[np.int32] = _spread(self.starts, self.order, self.cells)
        return cells


def sort_columns(coords: NDArray[np.int32]) -> Columns:
    """Sort voxels (N, 3) int32, distinct, N > 0, into columns along z."""
    low, high = bounds(coords)
    order = np.argsort(_keys(coords, low))
    starts, cells = _columns(coords, order, low)
    z = np.ascontiguousarray(coords[:, 2])
    above, below, horizontal = _neighbours(z, order, starts)
    extent = high - low + 1
    return Columns(
        z=z,
        above=above,
        below=below,
        horizontal=horizontal,
        order=order,
        starts=starts,
        cells=cells,
        corner=low[:2],
        shape=(int(extent[0]), int(extent[1])),
    )


@njit(cache=True, nogil=True)
def _keys(coords, low):  # type: ignore[no-untyped-def]
    """Numbers that sort voxels by column and z: (N,) int64."""
    keys = np.empty(len(coords), np.int64)
    for i in range(len(coords)):
        x, y = np.int64(coords[i, 0] - low[0]), np.int64(coords[i, 1] - low[1])
        keys[i] = (x << 42) | (y << 21) | np.int64(coords[i, 2] - low[2])
    return keys


@njit(cache=True, nogil=True)
def _columns(coords, order, low):  # type: ignore[no-untyped-def]
    """Where each column of sorted voxels starts, the last ends (C + 1,), and its cell (C, 2)."""
    starts = np.empty(len(order) + 1, np.int64)
    cells = np.empty((len(order), 2), np.int32)
    count = 0
    for i in range(len(order)):
        x, y = coords[order[i], 0] - low[0], coords[order[i], 1] - low[1]
        if count == 0 or x != cells[count - 1, 0] or y != cells[count - 1, 1]:
            starts[count], cells[count, 0], cells[count, 1] = i, x, y
            count += 1
    starts[count] = len(order)
    return starts[: count + 1].copy(), cells[:count].copy()


@njit(cache=True, nogil=True)
def _neighbours(z, order, starts):  # type: ignore[no-untyped-def]
    """Gaps to the next voxel up and down and the horizontal flag of every voxel."""
    above = np.full(len(z), NOTHING, np.int32)
    below = np.full(len(z), NOTHING, np.int32)
    horizontal = np.ones(len(z), np.bool_)
    for column in range(len(starts) - 1):
        end = starts[column + 1]
        for i in range(starts[column], end):
            row = order[i]
            for j in range(i + 1, end):
                other = order[j]
                gap = z[other] - z[row]
                if j == i + 1:
                    above[row] = below[other] = gap
                if gap > 4:
                    break
                if gap >= 2:
                    horizontal[row] = horizontal[other] = False
    return above, below, horizontal


@njit(cache=True, nogil=True)
def _spread(starts, order, cells):  # type: ignore[no-untyped-def]
    """Cell (2,) of every voxel's column: (N, 2) int32."""
    spread = np.empty((len(order), 2), np.int32)
    for column in range(len(starts) - 1):
        for i in range(starts[column], starts[column + 1]):
            spread[order[i]] = cells[column]
    return spread
