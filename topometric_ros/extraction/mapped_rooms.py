"""MappedRooms: voxels with their rooms and storeys, from which passages and attributes are read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.extraction.columns import Columns, sort_columns
from topometric_ros.topometric_map import NO_ROOM, OFFSET_STEPS, Storey
from topometric_ros.voxels.grid import VoxelGrid
from topometric_ros.voxels.index import VoxelIndex, cells_to_next, row_at

_TALLEST = 8.0
"""How far above floor that was not seen a ceiling or a lintel tells its room, m."""
_AROUND = tuple((x, y, z) for z in (0, 1, -1) for x, y in ((1, 0), (-1, 0), (0, 1), (0, -1)))


@dataclass(frozen=True)
class MappedRooms:
    """One agent's or a fused map once its rooms are known; metres, level frame.

    `grid` are the N occupied voxels, `offsets` (N, 3) int8 and `room` (N,) int32 as a
    TopometricMap holds them, `navigable` (M, 3) int32 cells that an agent could stand on, those
    where the floor was not seen included.
    """

    grid: VoxelGrid
    offsets: NDArray[np.int8]
    room: NDArray[np.int32]
    navigable: NDArray[np.int32]
    storey_of_room: Mapping[int, int]
    """Id of each room's storey."""
    storeys: tuple[Storey, ...]
    """The lowest first."""
    known_columns: Columns | None = None
    """Of the voxels, where the caller has them."""

    @cached_property
    def columns(self) -> Columns:
        """The voxels sorted into columns."""
        return self.known_columns or sort_columns(self.grid.coords)

    @cached_property
    def surface(self) -> NDArray[np.float64]:
        """Mean of the points in each voxel: (N, 3) float64, m."""
        within = (self.offsets + 0.5) / OFFSET_STEPS
        points: NDArray[np.float64] = (
            self.grid.origin + (self.grid.coords + within) * self.grid.voxel_size
        )
        return points

    @cached_property
    def standing(self) -> NDArray[np.float64]:
        """Places on the floor, one a navigable cell: (M, 3) float64, m."""
        rows = self._rows
        unseen = self.grid.origin + self.navigable * self.grid.voxel_size
        places: NDArray[np.float64] = np.where(rows[:, None] >= 0, self.surface[rows], unseen)
        return places

    @cached_property
    def room_of_standing(self) -> NDArray[np.int32]:
        """The room of each navigable cell: (M,) int32.

        Where the floor was not seen it is that of what is above it on the storey, or else of the
        nearest floor on the way there.
        """
        rows = self._rows
        label = np.where(rows >= 0, self.room[rows], NO_ROOM).astype(np.int32)
        unseen = np.flatnonzero(rows < 0)
        if len(unseen) == 0:
            return label
        cells = self.navigable[unseen]
        most = round(_TALLEST / self.grid.voxel_size)
        over = _first_above(self.grid.index.table, cells, most)
        z = self.grid.origin[2] + cells[:, 2] * self.grid.voxel_size
        floors = np.array([storey.floor_z for storey in self.storeys])
        ids = np.array([storey.id for storey in self.storeys])
        nearest = ids[np.argmin(np.abs(z[:, None] - floors), axis=1)]
        known = (over >= 0) & (self.storey[over] == nearest)
        label[unseen[known]] = self.room[over[known]]
        rest = unseen[label[unseen] == NO_ROOM]
        _spread(VoxelIndex(self.navigable).table, self.navigable, label, rest, np.array(_AROUND))
        return label

    @cached_property
    def _rows(self) -> NDArray[np.int64]:
        """Row of each navigable cell in the grid, -1 where the floor was not seen: (M,) int64."""
        return self.grid.index.rows(self.navigable)

    @cached_property
    def storey(self) -> NDArray[np.int64]:
        """The id of the storey of each voxel's room: (N,) int64, -1 for voxels in none."""
        return self.storey_of(self.room)

    def storey_of(self, room: NDArray[np.int32]) -> NDArray[np.int64]:
        """Return the id of the storey of each room (K,), -1 for none: (K,) int64."""
        ids = np.full(max(self.storey_of_room, default=NO_ROOM) + 2, -1, np.int64)
        for known, storey in self.storey_of_room.items():
            ids[known + 1] = storey
        of_rooms: NDArray[np.int64] = ids[room + 1]
        return of_rooms


@njit(cache=True, nogil=True)
def _first_above(table, cells, most):  # type: ignore[no-untyped-def]
    """Row of the first voxel at most so many cells above each cell, -1 where there is none."""
    found = np.full(len(cells), -1, np.int64)
    for i in range(len(cells)):
        x, y, z = cells[i, 0], cells[i, 1], cells[i, 2]
        rise = cells_to_next(table, x, y, z, 1, most)
        if rise <= most:
            found[i] = row_at(table, x, y, z + rise)
    return found


@njit(cache=True, nogil=True)
def _spread(table, cells, label, rest, around):  # type: ignore[no-untyped-def]
    """Give the cells `rest` the label of the nearest labelled cell, ring by ring, in place."""
    taken = np.empty(len(rest), np.int32)
    left = rest.copy()
    while len(left):
        count = 0
        for i in range(len(left)):
            taken[i] = -1
            for k in range(len(around)):
                row = row_at(
                    table,
                    cells[left[i], 0] + around[k, 0],
                    cells[left[i], 1] + around[k, 1],
                    cells[left[i], 2] + around[k, 2],
                )
                if row >= 0 and label[row] > taken[i]:
                    taken[i] = label[row]
        for i in range(len(left)):
            if taken[i] >= 0:
                label[left[i]] = taken[i]
            else:
                left[count] = left[i]
                count += 1
        if count == len(left):
            break
        left = left[:count].copy()
