"""Measuring an extraction for its quality report: the map, and the cloud that it was made from.

What the cloud's surfaces are like comes from `surfaces.py` and `orientation.py`; here the map is
measured, and the checks of `quality.py` turn the numbers into findings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.columns import Columns
from topometric_ros.extraction.orientation import is_upside_down
from topometric_ros.extraction.quality import Quality, findings, is_ordinary_height
from topometric_ros.extraction.storeys import RASTER, StoreyHeights
from topometric_ros.extraction.surfaces import (
    clear_height,
    fit_planes,
    likely_unit,
    measure_surfaces,
    spacing,
)
from topometric_ros.topometric_map import NO_ROOM, TopometricMap

_FLOOR_BAND = 0.15
"""How far from a storey's floor something seen may lie and still be floor, m."""

_OUTSIDE = 0.3
"""How far below the lowest floor or above the highest ceiling something lies outside, m."""
_LARGE_STOREY = 0.2
"""Share of the voxels; less of a storey may be all that was seen through a stairwell."""

_WALL = 1.0
"""m of voxels in a column that make it a wall."""


def assess(
    m: TopometricMap,
    points: NDArray[np.float64],
    columns: Columns,
    coords: NDArray[np.int32],
    storeys: Sequence[StoreyHeights],
    storey: NDArray[np.int32],
    method: str,
) -> Quality:
    """Measure a map and the cloud that it was made from; the tilt is for the caller to add.

    Parameters
    ----------
    m : the map as extracted
    points : (P, 3) float64, m, level frame, thinned to 5 cm or less
    columns, coords : of the cloud's 0.1 m voxels
    storeys : as found in them
    storey : (N,) int32, the storey of each of the map's voxels
    method : how rooms were found, which says why a voxel has none
    """
    surfaces = measure_surfaces(fit_planes(points))
    height = clear_height(columns, RASTER)
    floor_seen, ceiling_seen = _seen(m, storey)
    quality = Quality(
        points=len(points),
        voxels=len(m.voxels),
        storeys=len(m.storeys),
        rooms=len(m.rooms),
        passages=len(m.passages),
        navigable_area=_area(m.navigable, m.voxel_size),
        unlabelled=unlabelled_shares(m, storeys, method),
        floor_seen=floor_seen,
        ceiling_seen=ceiling_seen,
        parts=parts(m),
        noise=surfaces.noise,
        flat=surfaces.flat,
        straight=surfaces.straight,
        upright=surfaces.upright,
        surfaces_measured=surfaces.measured,
        spacing=spacing(coords, RASTER),
        clear_height=height,
        seen_height=_seen_height(m, storeys, storey),
    )
    unit = None if is_ordinary_height(height) else likely_unit(points)
    upside_down = is_upside_down(columns, storeys, m.origin[2])
    return replace(quality, findings=findings(quality, m.voxel_size, unit, upside_down))


def _seen_height(
    m: TopometricMap, storeys: Sequence[StoreyHeights], storey: NDArray[np.int32]
) -> float:
    """Return how far above its floor a storey was seen, m: the least of those well seen."""
    z = m.origin[2] + m.voxels[:, 2] * m.voxel_size
    seen = [z[storey == index] - level.floor for index, level in enumerate(storeys)]
    large = [heights for heights in seen if len(heights) >= _LARGE_STOREY * len(z)]
    return min(float(np.percentile(heights, 99)) for heights in large or [max(seen, key=len)])


def unlabelled_shares(
    m: TopometricMap, storeys: Sequence[StoreyHeights], method: str
) -> dict[str, float]:
    """Return the share of voxels in no room, in all and by reason.

    Below the lowest floor and above the highest ceiling lie foundations, roofs and stray points;
    between them a voxel lies too far from every room or behind its walls, or no view reached it.
    """
    none = m.room == NO_ROOM
    z = m.origin[2] + m.voxels[:, 2] * m.voxel_size
    below = none & (z < min(s.floor for s in storeys) - _OUTSIDE)
    above = none & (z > max(s.ceiling for s in storeys) + _OUTSIDE)
    rest = "no view" if method == "visibility" else "far from rooms"
    total = max(1, len(m.voxels))
    return {
        "all": np.count_nonzero(none) / total,
        "below the floors": np.count_nonzero(below) / total,
        "above the ceilings": np.count_nonzero(above) / total,
        rest: np.count_nonzero(none & ~below & ~above) / total,
    }


def parts(m: TopometricMap) -> tuple[tuple[tuple[int, ...], float], ...]:
    """Return the groups of rooms that passages join: their ids and area in m², largest first."""
    group = {room.id: room.id for room in m.rooms}
    for passage in m.passages:
        first, second = (group[room] for room in passage.rooms)
        if first != second:
            group = {room: first if g == second else g for room, g in group.items()}
    area = {room.id: room.area for room in m.rooms}
    found: list[tuple[tuple[int, ...], float]] = []
    for g in sorted(set(group.values())):
        rooms = tuple(sorted(room for room in group if group[room] == g))
        found.append((rooms, sum(area[room] for room in rooms)))
    return tuple(sorted(found, key=lambda part: (-part[1], part[0])))


def _area(coords: NDArray[np.int32], voxel_size: float) -> float:
    """Return the horizontal area of voxels, m²; of several on one another in a metre only one."""
    if len(coords) == 0:
        return 0.0
    flat = coords // (1, 1, max(1, round(1.0 / voxel_size)))
    keys = np.sort(_keys(flat))
    return int(1 + np.count_nonzero(keys[1:] != keys[:-1])) * voxel_size**2


def _keys(coords: NDArray[np.int64] | NDArray[np.int32]) -> NDArray[np.int64]:
    """Return one number for each cell: (N,) int64."""
    x, y, z = np.asarray(coords, np.int64).T
    return (((x << 21) + y) << 21) + z


def _seen(m: TopometricMap, storey: NDArray[np.int32]) -> tuple[float, float]:
    """Return how much of the rooms' area, without walls, has its floor and its ceiling seen."""
    z = m.origin[2] + m.voxels[:, 2] * m.voxel_size
    inside = m.room != NO_ROOM
    if not inside.any():
        return 0.0, 0.0
    cell = _keys(np.column_stack([m.voxels[:, :2], storey]))
    cells, of_voxel, count = np.unique(cell, return_inverse=True, return_counts=True)
    floors = np.array([s.floor_z for s in m.storeys])[storey]
    ceilings = np.array([np.inf if s.ceiling_z is None else s.ceiling_z for s in m.storeys])[storey]
    band = max(_FLOOR_BAND, m.voxel_size)
    room, floor, ceiling = (np.zeros(len(cells), bool) for _ in range(3))
    room[of_voxel[inside]] = True
    floor[of_voxel[np.abs(z - floors) <= band]] = True
    ceiling[of_voxel[np.abs(z - ceilings) <= 2 * band]] = True
    room &= count * m.voxel_size < _WALL
    total = max(1, int(np.count_nonzero(room)))
    with_floor, with_ceiling = (int(np.count_nonzero(room & seen)) for seen in (floor, ceiling))
    return with_floor / total, with_ceiling / total
