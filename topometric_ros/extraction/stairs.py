"""Stairs: what is climbed from one storey's floor to the next, and the rooms at both ends.

Whatever has headroom between two floors, hangs together with gaps of a tread or two and reaches
from the lower floor to the upper one is a way up: in a room with a ceiling nothing else has. The
columns are read for it, not the navigable volume: a stick that fits on every tread of a narrow,
turning or half-seen flight is rare. A way that hardly rises for its length is a ramp.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.configuration import parameter
from topometric_ros.extraction.columns import NOTHING, Columns
from topometric_ros.extraction.mapped_rooms import MappedRooms
from topometric_ros.topometric_map import Passage
from topometric_ros.voxels.components import connected_components
from topometric_ros.voxels.grid import VoxelGrid
from topometric_ros.voxels.kernels import Kernel, connectivity, kernel_of

_LEVEL = 0.25
"""Voxels this near to a floor's height, m, are of the floor and not yet of the stairs."""
_BAND = 0.2
"""Height of the bands in which treads are counted, m: every band holds a tread or two."""
_BELOW_CEILING = 0.2
"""How far below the lower storey's ceiling the count ends, m: the ceiling has headroom too where
the floor above it was not seen."""
_STEEP = 0.25
"""Rise over run that is no ramp any more."""


@dataclass(frozen=True)
class StairsConfig:
    """What counts as a way from one storey to the next."""

    headroom: float = parameter(
        1.4, "Free height above a tread.", unit="m", minimum=1.0, maximum=3.0
    )
    gap: float = parameter(
        0.5, "Largest horizontal gap between treads.", unit="m", minimum=0.1, maximum=1.5
    )
    rise: float = parameter(
        0.4,
        "Largest rise between treads, one that was not seen included.",
        unit="m",
        minimum=0.1,
        maximum=1.0,
    )
    ends: float = parameter(
        0.7,
        "How near to a floor the lowest and the highest tread seen must come.",
        unit="m",
        minimum=0.2,
        maximum=1.5,
    )
    smallest_tread: float = parameter(
        0.06, "Smallest area of treads in 0.2 m of height.", unit="m²", minimum=0.0, maximum=1.0
    )
    narrowest: float = parameter(
        0.5, "Smallest width of the treads.", unit="m", minimum=0.2, maximum=2.0
    )
    seen: float = parameter(
        0.8, "Smallest share of the 0.2 m of height with a tread.", minimum=0.0, maximum=1.0
    )


def find_stairs(rooms: MappedRooms, config: StairsConfig) -> tuple[Passage, ...]:
    """Return one passage for every way from a storey to the next one up.

    Returns
    -------
    passages of kind `stairs` or `ramp`, from the lowest storey up, the largest first; `position`
    lies on a tread half way, `width` is that of the treads, `height` the least headroom over nine
    tenths of them and `confidence` the share of the height in which treads were seen
    """
    grid, columns, room = rooms.grid, rooms.columns, rooms.room
    height = grid.origin[2] + grid.coords[:, 2] * grid.voxel_size
    treads = columns.above * grid.voxel_size > config.headroom
    found: list[Passage] = []
    for lower, upper in itertools.pairwise(rooms.storeys):
        floors = [
            np.flatnonzero(
                treads & (rooms.storey == level.id) & (abs(height - level.floor_z) <= _LEVEL)
            )
            for level in (lower, upper)
        ]
        if min(map(len, floors)) == 0:
            continue
        ceiling = upper.floor_z if lower.ceiling_z is None else lower.ceiling_z
        for own, seen in flights(grid, columns, lower.floor_z, upper.floor_z, ceiling, config):
            ends = [_room_beside(grid, own, floor, room, height) for floor in floors]
            passage = _passage(grid, columns, own, (ends[0], ends[1]), seen)
            found += [passage] if passage.width >= config.narrowest else []
    return tuple(found)


def flights(
    grid: VoxelGrid,
    columns: Columns,
    low: float,
    high: float,
    ceiling: float,
    config: StairsConfig,
) -> Iterator[tuple[NDArray[np.int64], float]]:
    """Yield the treads of each way from a floor to the next, the largest first.

    Parameters
    ----------
    grid, columns : the occupied voxels and their columns
    low, high, ceiling : m, heights of the two floors and of the lower one's ceiling
    config : what counts as a way up

    Yields
    ------
    rows of the grid (n,) int64, and the share of the height in which treads were seen
    """
    height = grid.origin[2] + grid.coords[:, 2] * grid.voxel_size
    top = min(high - _LEVEL, ceiling - _BELOW_CEILING)
    treads = columns.above * grid.voxel_size > config.headroom
    rows = np.flatnonzero(treads & (height > low + _LEVEL) & (height < top))
    component = connected_components(grid.coords[rows], _climbing(grid.voxel_size, config))
    for number in range(int(component.max(initial=-1)) + 1):
        own = rows[component == number]
        if len(own) * grid.voxel_size**2 < config.smallest_tread:
            return  # The largest come first.
        if height[own].min() > low + config.ends or height[own].max() < top - config.ends:
            continue
        seen = _seen(height[own], low + _LEVEL, top, grid.voxel_size, config)
        if seen >= config.seen:
            yield own, seen


def _climbing(voxel_size: float, config: StairsConfig) -> Kernel:
    """Return the neighbourhood that joins treads."""
    across, up = round(config.gap / voxel_size), round(config.rise / voxel_size)
    flat, tall = np.arange(-across, across + 1), np.arange(-up, up + 1)
    return kernel_of(np.stack(np.meshgrid(flat, flat, tall, indexing="ij"), -1).reshape(-1, 3))


def _seen(
    height: NDArray[np.float64], low: float, top: float, voxel_size: float, config: StairsConfig
) -> float:
    """Return the share of the bands from `low` to `top` in which there is enough of a tread."""
    bands = max(1, int((top - low) / _BAND))
    counts = np.histogram(height, bins=bands, range=(low, top))[0]
    return float(np.mean(counts * voxel_size**2 >= config.smallest_tread))


def _room_beside(
    grid: VoxelGrid,
    stairs: NDArray[np.int64],
    floor: NDArray[np.int64],
    room: NDArray[np.int32],
    height: NDArray[np.float64],
) -> int:
    """Return the room of most of the floor (rows) beside the nearer end of stairs (rows)."""
    to_floor = abs(height[stairs] - height[floor].mean())
    end = stairs[to_floor <= to_floor.min() + _BAND]
    away, _ = cKDTree(grid.coords[end, :2]).query(grid.coords[floor, :2])
    beside = floor[away <= away.min() + 0.3 / grid.voxel_size]
    ids, counts = np.unique(room[beside], return_counts=True)
    return int(ids[np.argmax(counts)])


def _passage(
    grid: VoxelGrid,
    columns: Columns,
    own: NDArray[np.int64],
    rooms: tuple[int, int],
    seen: float,
) -> Passage:
    """Describe a way up by its treads (rows of the grid)."""
    points = grid.origin + grid.coords[own] * grid.voxel_size
    z = points[:, 2]
    half = (z.min() + z.max()) / 2
    away = np.hypot(*(points[:, :2] - points[:, :2].mean(axis=0)).T) + abs(z - half)
    x, y, middle = points[np.argmin(away)].tolist()
    band = np.floor((z - z.min()) / _BAND).astype(int)
    widths, areas = [], []
    for number in np.unique(band):
        tread = _largest(grid.coords[own[band == number], :2])
        widths.append((_extent(tread) + 1) * grid.voxel_size)
        areas.append(len(tread) * grid.voxel_size**2)
    width = float(np.median(widths))
    run = float(np.median(areas)) / width
    headroom = np.percentile(columns.above[own], 10, method="lower")
    return Passage(
        rooms=(min(rooms), max(rooms)),
        position=(x, y, middle),
        width=width,
        height=None if headroom == NOTHING else float(headroom * grid.voxel_size),
        kind="stairs" if _STEEP * run <= _BAND else "ramp",
        confidence=seen,
    )


def _largest(cells: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the cells (n, 2) of the largest piece that hangs together, seen from above."""
    flat = np.unique(cells, axis=0)
    component = connected_components(np.pad(flat, ((0, 0), (0, 1))), connectivity("26"))
    return flat[component == 0]


def _extent(flat: NDArray[np.int32]) -> float:
    """Return the extent of cells (n, 2) along their main direction."""
    centred = flat - flat.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    return float(np.ptp(centred @ axes[:, -1]))
