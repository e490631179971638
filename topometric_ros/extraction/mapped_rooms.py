"""MappedRooms: voxels with their rooms and storeys, from which passages and attributes are read."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.columns import Columns, sort_columns
from topometric_ros.topometric_map import NO_ROOM, OFFSET_STEPS, Storey
from topometric_ros.voxels.grid import VoxelGrid


@dataclass(frozen=True)
class MappedRooms:
    """One agent's or a fused map once its rooms are known; metres, level frame.

    `grid` are the N occupied voxels, `offsets` (N, 3) int8 and `room` (N,) int32 as a
    TopometricMap holds them, `navigable` (M, 3) int32 cells that an agent could stand on.
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
    def storey(self) -> NDArray[np.int64]:
        """The id of the storey of each voxel's room: (N,) int64, -1 for voxels in none."""
        ids = np.full(int(self.room.max(initial=NO_ROOM)) + 2, -1, np.int64)
        known = np.unique(self.room[self.room != NO_ROOM])
        ids[known + 1] = [self.storey_of_room[int(i)] for i in known]
        of_voxels: NDArray[np.int64] = ids[self.room + 1]
        return of_voxels
