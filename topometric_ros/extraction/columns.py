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
        cells = np.empty((len(self.z), 2), np.int32)
        cells[self.order] = np.repeat(self.cells, np.diff(self.starts), axis=0)
        return cells


def sort_columns(coords: NDArray[np.int32]) -> Columns:
    """Sort voxels (N, 3) int32, distinct, N > 0, into columns along z."""
    low, high = bounds(coords)
    x, y, z = (coords - low).astype(np.int64).T
    order = np.argsort((x << 42) | (y << 21) | z)
    ordered = coords[order]
    change = np.any(np.diff(ordered[:, :2], axis=0) != 0, axis=1)
    first = np.concatenate([[0], np.flatnonzero(change) + 1])
    starts = np.concatenate([first, [len(coords)]]).astype(np.int64)
    corner = low[:2]
    extent = high[:2] - corner + 1
    above, below, horizontal = _neighbours(ordered[:, 2], starts)
    back = np.empty(len(coords), np.int64)
    back[order] = np.arange(len(coords))
    return Columns(
        z=np.ascontiguousarray(coords[:, 2]),
        above=above[back],
        below=below[back],
        horizontal=horizontal[back],
        order=order,
        starts=starts,
        cells=ordered[first, :2] - corner,
        corner=corner,
        shape=(int(extent[0]), int(extent[1])),
    )


@njit(cache=True, nogil=True)
def _neighbours(z, starts):  # type: ignore[no-untyped-def]
    """Gaps to the next voxel up and down and the horizontal flag of voxels sorted by column."""
    count = len(z)
    above = np.full(count, NOTHING, np.int32)
    below = np.full(count, NOTHING, np.int32)
    horizontal = np.ones(count, np.bool_)
    for column in range(len(starts) - 1):
        low, high = starts[column], starts[column + 1]
        for i in range(low, high):
            if i + 1 < high:
                above[i] = z[i + 1] - z[i]
                below[i + 1] = above[i]
            j = i + 1
            while j < high and z[j] - z[i] <= 4:
                if z[j] - z[i] >= 2:
                    horizontal[i] = False
                    horizontal[j] = False
                j += 1
    return above, below, horizontal
