"""What one map offers the search and the verification: lookup tables and cells of each storey.

Two ideas carry both. *Free space decides*: a wall of one map inside the seen-free floor of the
other disproves a pose. *A wall has a free side*: walls that were seen from opposite sides must not
match, so each wall cell carries the unit vector towards the floor in front of it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.configuration import parameter
from topometric_ros.errors import TopometricError
from topometric_ros.topometric_map import Storey, TopometricMap

CELL = 0.1
"""Edge in metres of the cells of `StoreyLayers` that the thresholds here are made for."""

STOREY_TOLERANCE = 0.35
"""Floors this near to each other in height (m) are the same storey."""

_MARGIN = 6
"""Empty cells round each table: walls just outside a raster still attract."""

_FAR = 1e3


class SearchError(TopometricError):
    """Maps whose storey layers cannot be compared."""


@dataclass(frozen=True)
class ScoringConfig:
    """Weights of the score S of a pose, in wall cells (0.1 m of wall in agreement count one)."""

    wall_width: float = parameter(
        0.12, "Standard deviation of the distance at which walls agree.", unit="m", minimum=0.03,
        maximum=0.5,
    )  # fmt: skip
    side_weight: float = parameter(
        0.5, "Share of a wall's score that hangs on both maps seeing the same side of it.",
        minimum=0.0, maximum=1.0,
    )  # fmt: skip
    conflict_weight: float = parameter(
        3.0, "Cost of a wall cell in the other map's seen-free floor.", minimum=0.0, maximum=20.0
    )
    free_weight: float = parameter(
        0.05, "Gain of a free cell in the other map's seen-free floor.", minimum=0.0, maximum=1.0
    )
    conflict_depth: float = parameter(
        0.2, "A wall conflicts when it stands this deep in the other's free floor.", unit="m",
        minimum=0.05, maximum=1.0,
    )  # fmt: skip


@dataclass(frozen=True)
class StoreyFields:
    """One storey as tables to look things up in, and as cells to look up in another's tables.

    Tables are (nx, ny); cell (i, j) is centred at `origin + CELL * (i, j)`, m, level frame. Cells
    are (K, 2) float64 positions, m, level frame.
    """

    floor_z: float
    origin: NDArray[np.float64]
    """(2,) float64, m."""
    pull: NDArray[np.float32]
    """(nx, ny, 4): what a wall cell gains at once, by its side along x and y, and its conflict."""
    kind: NDArray[np.int8]
    """(nx, ny): 1 free floor, 2 wall, 0 neither."""
    wall_distance: NDArray[np.float32]
    """(nx, ny) cells to the nearest wall."""
    side: NDArray[np.float32]
    """(nx, ny, 2): the free side of the nearest wall, a unit vector or zero."""
    free_depth: NDArray[np.float32]
    """(nx, ny) cells from here to the nearest cell that is not free."""
    furniture_distance: NDArray[np.float32]
    bare_depth: NDArray[np.float32]
    walls: NDArray[np.float64]
    wall_sides: NDArray[np.float64]
    """(K, 2) the free side of each of `walls`."""
    free: NDArray[np.float64]
    furniture: NDArray[np.float64]


@dataclass(frozen=True)
class MapFields:
    """The storeys of one map that have anything in them, lowest first."""

    storeys: tuple[StoreyFields, ...]


def prepare(map_or_fields: TopometricMap | MapFields, config: ScoringConfig) -> MapFields:
    """Return a map's lookup tables; a map that is prepared already is returned as it is.

    Raises
    ------
    SearchError
        The map's rasters have another cell size than 0.1 m.
    """
    if isinstance(map_or_fields, MapFields):
        return map_or_fields
    storeys = [s for s in map_or_fields.storeys if s.layers.wall.any() or s.layers.free.any()]
    return MapFields(
        tuple(_fields(s, config) for s in sorted(storeys, key=lambda s: (s.floor_z, s.id)))
    )


def _fields(storey: Storey, config: ScoringConfig) -> StoreyFields:
    """Tables and cells of one storey."""
    layers = storey.layers
    if abs(layers.cell - CELL) > 1e-6:
        raise SearchError(
            f"storey {storey.id}: its rasters have cells of {layers.cell} m, {CELL} m is needed"
        )
    wall, furniture, free, bare = (
        np.pad(mask, _MARGIN) for mask in (layers.wall, layers.furniture, layers.free, layers.bare)
    )
    origin = np.asarray(layers.origin, float) - _MARGIN * CELL
    side = free_side(free, wall)
    distance, nearest_side = _nearest_wall(wall, side)
    free_depth = _distance(~free)
    gain = np.exp(-0.5 * (distance * CELL / config.wall_width) ** 2)
    conflict = free & (distance > 1.5)
    pull = np.stack(
        [
            gain * (1.0 - config.side_weight),
            gain * config.side_weight * nearest_side[..., 0],
            gain * config.side_weight * nearest_side[..., 1],
            conflict.astype(float),
        ],
        axis=-1,
    )
    return StoreyFields(
        floor_z=storey.floor_z,
        origin=origin,
        pull=pull.astype(np.float32),
        kind=(free * 1 + wall * 2).astype(np.int8),
        wall_distance=distance.astype(np.float32),
        side=nearest_side.astype(np.float32),
        free_depth=free_depth.astype(np.float32),
        furniture_distance=_distance(furniture).astype(np.float32),
        bare_depth=_distance(~bare).astype(np.float32),
        walls=_positions(wall, origin),
        wall_sides=side[wall],
        free=_positions(free, origin),
        furniture=_positions(furniture, origin),
    )


def free_side(free: NDArray[np.bool_], wall: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the unit gradient of the smoothed free floor at wall cells, else 0: (nx, ny, 2)."""
    smooth = ndimage.gaussian_filter(free.astype(np.float64), 2.0)
    gradient = np.stack(np.gradient(smooth), axis=-1)
    length = np.linalg.norm(gradient, axis=-1, keepdims=True)
    return np.where((length > 1e-3) & wall[..., None], gradient / np.maximum(length, 1e-3), 0.0)


def _nearest_wall(
    wall: NDArray[np.bool_], side: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Cells to the nearest wall and that wall's free side."""
    if not wall.any():
        return np.full(wall.shape, _FAR), np.zeros((*wall.shape, 2))
    distance, index = ndimage.distance_transform_edt(~wall, return_indices=True)
    return distance, side[index[0], index[1]]


def _distance(target: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Cells to the nearest cell of `target`; far where there is none."""
    if not target.any():
        return np.full(target.shape, _FAR)
    return ndimage.distance_transform_edt(~target)


def _positions(mask: NDArray[np.bool_], origin: NDArray[np.float64]) -> NDArray[np.float64]:
    return origin + np.argwhere(mask) * CELL


def storey_pairs(a: MapFields, b: MapFields, height: float) -> list[tuple[int, int]]:
    """Return which storeys of two maps are the same when b is raised by `height` (m).

    Each storey has one partner at most; the nearest heights find each other first.
    """
    gaps = sorted(
        (abs(sa.floor_z - sb.floor_z - height), i, j)
        for i, sa in enumerate(a.storeys)
        for j, sb in enumerate(b.storeys)
    )
    pairs: list[tuple[int, int]] = []
    for gap, i, j in gaps:
        if gap > STOREY_TOLERANCE:
            break
        if all(i != used_i and j != used_j for used_i, used_j in pairs):
            pairs.append((i, j))
    return sorted(pairs)


def candidate_heights(a: MapFields, b: MapFields) -> list[float]:
    """Return the heights (m) by which b may be raised so that a floor meets a floor of a.

    Differences within 0.35 m are one height: their mean, weighted by the floor that both saw.
    """
    differences = sorted(
        (sa.floor_z - sb.floor_z, min(len(sa.free), len(sb.free)) + 1)
        for sa in a.storeys
        for sb in b.storeys
    )
    groups: list[list[tuple[float, int]]] = []
    for entry in differences:
        if groups and entry[0] - groups[-1][0][0] <= STOREY_TOLERANCE:
            groups[-1].append(entry)
        else:
            groups.append([entry])
    return [_weighted_mean(group) for group in groups]


def _weighted_mean(entries: Sequence[tuple[float, int]]) -> float:
    return float(sum(v * w for v, w in entries) / sum(w for _, w in entries))
