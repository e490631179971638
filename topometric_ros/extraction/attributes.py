"""Attributes of rooms: what a user asks of a room besides where it is.

Everything is read from the columns of a room's voxels on its storey: cells of the plan that a wall
fills from the floor up bound the room, the others are its floor. Whether walls go on round it says
how completely it was seen. The same function measures the rooms of a fused map.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.extraction.mapped_rooms import MappedRooms
from topometric_ros.extraction.masks import BESIDE, depth, dilated
from topometric_ros.topometric_map import NO_ROOM, Storey
from topometric_ros.voxels.grid import VoxelGrid

_BAND = (0.3, 1.8)
"""Heights above the floor between which a wall fills a column, m."""
_WALL = 0.5
"""Share of the voxels of that band that makes a cell of the plan a wall."""
_SOMETHING = 0.3
"""m of that band that are filled where something bounds a room: sills, cupboards."""
_GAP = 0.2
"""Holes between things that bound a room up to twice this are no way out, m."""
_NEAR_FLOOR = 0.35
"""The floor of a room lies this near to its storey's, m."""
_CEILING = 1.8
"""Lowest ceiling above the floor, m."""
_OPEN = 0.7
"""The centre keeps this share of the largest distance to everything."""


@dataclass(frozen=True)
class RoomAttributes:
    """What was measured of a room; metres, level frame. See `topometric_map.Room`."""

    centre: tuple[float, float, float] | None
    floor_area: float
    volume: float | None
    completeness: float
    frontier: float
    height: float | None
    """Mean height of the ceiling over the floor, None where no ceiling was seen."""
    perimeter: float
    floor: NDArray[np.bool_]
    """(nx, ny): the room's floor on its own crop of the plan, cells of one voxel."""


def room_attributes(rooms: MappedRooms) -> dict[int, RoomAttributes]:
    """Measure every room that has voxels: attributes by the room's id.

    A room that has most voxels of no column, as views cut out of walls, has nothing to measure.
    """
    nothing = RoomAttributes(None, 0.0, None, 0.0, 0.0, None, 0.0, np.zeros((1, 1), bool))
    found = dict.fromkeys(rooms.storey_of_room, nothing)
    for one in rooms.storeys:
        of_storey = rooms.storey == one.id
        if of_storey.any():
            plan = _plan(rooms, np.where(of_storey, rooms.room, NO_ROOM), one.floor_z)
            standing = _standing(rooms, plan, one.floor_z)
            for room, window in enumerate(ndimage.find_objects(plan.label - NO_ROOM)):
                if window is not None:
                    found[room] = _measured(room, plan, _padded(window), standing, rooms.grid, one)
    return found


@dataclass(frozen=True)
class _Plan:
    """A storey from above, (nx, ny) cells of one voxel; cell (0, 0) has the coordinates `corner`.

    `label` int32 is the room of each cell, NO_ROOM for none; `low` and `top` float64 are the
    lowest and the highest voxel of the column, m above the floor; `filled` int32 counts the
    voxels between the heights that walls fill.
    """

    corner: NDArray[np.int32]
    label: NDArray[np.int32]
    low: NDArray[np.float64]
    top: NDArray[np.float64]
    filled: NDArray[np.int32]


def _plan(rooms: MappedRooms, room: NDArray[np.int32], floor: float) -> _Plan:
    """Draw the rooms of one storey; `room` (N,) is NO_ROOM for all others."""
    grid, columns = rooms.grid, rooms.columns
    height = grid.origin[2] + grid.coords[:, 2] * grid.voxel_size - floor
    label, low, top, filled = _columns_of_rooms(
        columns.starts, columns.order, room, height, _BAND[0], _BAND[1]
    )
    held = label != NO_ROOM
    cells = columns.cells[held]
    # An empty cell all round: nothing that is looked for at the rim may leave the raster.
    first = cells.min(axis=0) - 1
    shape = tuple((cells.max(axis=0) - first + 2).tolist())
    rasters = [np.full(shape, NO_ROOM, np.int32), np.zeros(shape), np.zeros(shape)]
    rasters.append(np.zeros(shape, np.int32))
    at = tuple((cells - first).T)
    for raster, values in zip(rasters, (label, low, top, filled), strict=True):
        raster[at] = values[held]
    return _Plan(columns.corner + first, *rasters)


@njit(cache=True, nogil=True)
def _columns_of_rooms(starts, order, room, height, low_end, high_end):  # type: ignore[no-untyped-def]
    """Room of most voxels, lowest and highest of them, and voxels in the band of each column."""
    count = len(starts) - 1
    label = np.full(count, -1, np.int32)
    low = np.zeros(count)
    top = np.zeros(count)
    filled = np.zeros(count, np.int32)
    for c in range(count):
        best = 0
        for i in range(starts[c], starts[c + 1]):
            row = order[i]
            if room[row] < 0:
                continue
            if label[c] < 0:
                low[c] = height[row]
            top[c] = height[row]
            if low_end <= height[row] <= high_end:
                filled[c] += 1
            votes = 0
            for j in range(starts[c], starts[c + 1]):
                if room[order[j]] == room[row]:
                    votes += 1
            if votes > best:
                best = votes
                label[c] = room[row]
    return label, low, top, filled


def _standing(rooms: MappedRooms, plan: _Plan, floor: float) -> NDArray[np.float64]:
    """Return the height, m above the floor, of what can be stood on at each cell, nan: nothing."""
    grid, navigable = rooms.grid, rooms.navigable
    standing = np.full(plan.label.shape, np.nan)
    height = grid.origin[2] + navigable[:, 2] * grid.voxel_size - floor
    cells = navigable[:, :2] - plan.corner
    inside = np.all((cells >= 0) & (cells < plan.label.shape), axis=1)
    inside &= np.abs(height) <= _NEAR_FLOOR
    standing[tuple(cells[inside].T)] = height[inside]
    return standing


def _padded(window: tuple[slice, slice]) -> tuple[slice, slice]:
    x, y = (slice(s.start - 1, s.stop + 1) for s in window)
    return x, y


def _measured(
    room: int,
    plan: _Plan,
    window: tuple[slice, slice],
    standing: NDArray[np.float64],
    grid: VoxelGrid,
    storey: Storey,
) -> RoomAttributes:
    """Measure one room on its window of the plan."""
    size = grid.voxel_size
    label, low, top = plan.label[window], plan.low[window], plan.top[window]
    own = label == room
    band = (_BAND[1] - _BAND[0]) / size
    wall = plan.filled[window] >= _WALL * band
    # With its holes filled; the first cell of the window, beyond the room, lies in no hole.
    outside, _ = ndimage.label(~own | wall)
    floor: NDArray[np.bool_] = outside != outside[0, 0]
    floor &= own | (label == NO_ROOM)
    frontier, perimeter = _rim(floor, label, plan.filled[window] * size >= _SOMETHING, size)
    area = float(np.count_nonzero(floor) * size**2)
    seen = floor & (low <= _NEAR_FLOOR) & (top >= _CEILING)
    height = float(np.mean(top[seen] - low[seen])) if seen.any() else None
    if height is None and storey.ceiling_z is not None:
        height = storey.ceiling_z - storey.floor_z
    corner = plan.corner + (window[0].start, window[1].start)
    return RoomAttributes(
        centre=_centre(floor & own, standing[window], corner, grid, storey.floor_z),
        floor_area=area,
        volume=None if height is None else area * height,
        completeness=1.0 - frontier / perimeter if perimeter else 0.0,
        frontier=frontier,
        height=height,
        perimeter=perimeter,
        floor=floor,
    )


def _rim(
    floor: NDArray[np.bool_], label: NDArray[np.int32], bounding: NDArray[np.bool_], size: float
) -> tuple[float, float]:
    """Return how much of the rim of a floor borders on nothing that was seen, and the rim, m."""
    rim = dilated(floor, 1) & ~floor
    near = bounding
    for _ in range(max(1, round(_GAP / size))):
        near = dilated(near, BESIDE)
    open_rim = rim & (label == NO_ROOM) & ~near
    return float(np.count_nonzero(open_rim) * size), float(np.count_nonzero(rim) * size)


def _centre(
    floor: NDArray[np.bool_],
    standing: NDArray[np.float64],
    corner: NDArray[np.int32],
    grid: VoxelGrid,
    floor_z: float,
) -> tuple[float, float, float] | None:
    """Return the place to stand that keeps clear of everything and is nearest to the middle."""
    free = floor & np.isfinite(standing)
    if not free.any():
        return None
    clear = depth(free)
    cells = np.argwhere(clear >= _OPEN * clear.max())
    middle = np.argwhere(free).mean(axis=0)
    i, j = cells[np.argmin(((cells - middle) ** 2).sum(axis=1))].tolist()
    x, y = (grid.origin[:2] + (corner + (i, j)) * grid.voxel_size).tolist()
    return x, y, float(floor_z + standing[i, j])
