"""Storeys of several maps by the height of their floors, and their bird's-eye rasters as one."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.fusion.poses import Transform, apply, inverse
from topometric_ros.topometric_map import Storey, StoreyLayers, TopometricMap

_MASKS = ("wall", "furniture", "free", "bare")
_MOST_CELLS = 1 << 26
"""Cells of a raster at most: what a message may hold."""

_Member = tuple[int, Storey, Transform]
"""Index of the map, its storey, and its transform to the global level frame."""


def fused_storeys(
    maps: Sequence[tuple[TopometricMap, Transform]], floor_distance: float
) -> tuple[tuple[Storey, ...], list[dict[int, int]]]:
    """Merge the storeys of several maps.

    Parameters
    ----------
    maps : each with its level frame's transform (4, 4) to the global level frame, the anchor first
    floor_distance : floors up to this far apart (m) are of one storey

    Returns
    -------
    storeys : numbered from the lowest; floor and ceiling are the first map's that knows them
    storey_of : for each map, the new id of each of its storeys
    """
    members: list[_Member] = [
        (index, storey, T) for index, (m, T) in enumerate(maps) for storey in m.storeys
    ]
    groups: list[list[_Member]] = []
    for member in members:
        near = [g for g in groups if abs(_floor(g[0]) - _floor(member)) <= floor_distance]
        if near:
            min(near, key=lambda g: abs(_floor(g[0]) - _floor(member))).append(member)
        else:
            groups.append([member])
    groups.sort(key=lambda group: _floor(group[0]))
    storey_of: list[dict[int, int]] = [{} for _ in maps]
    storeys = []
    for number, group in enumerate(groups):
        for index, storey, _ in group:
            storey_of[index][storey.id] = number
        ceilings = [s.ceiling_z + T[2, 3] for _, s, T in group if s.ceiling_z is not None]
        ceiling = float(ceilings[0]) if ceilings else None
        layers = merged_layers([(storey.layers, T) for _, storey, T in group])
        storeys.append(Storey(number, _floor(group[0]), ceiling, layers))
    return tuple(storeys), storey_of


def _floor(member: _Member) -> float:
    """Return the height of a storey's floor in the global level frame, m."""
    _, storey, T = member
    return float(storey.floor_z + T[2, 3])


def merged_layers(parts: Sequence[tuple[StoreyLayers, Transform]]) -> StoreyLayers:
    """Return the rasters of one storey as all its maps saw it, in the global level frame.

    Each cell of the result asks every map for its cell at that place, which leaves no holes where a
    turned raster would. What one map saw as wall is not free, and as furniture not bare.

    Raises
    ------
    TopometricError
        The maps lie too far apart for one raster.
    """
    if len(parts) == 1 and np.array_equal(parts[0][1], np.eye(4)):
        return parts[0][0]
    cell = max(layers.cell for layers, _ in parts)
    corners = np.concatenate([apply(T, _corners(layers))[:, :2] for layers, T in parts])
    # Cell centres are integer multiples of the cell, as in the maps' own rasters.
    low = np.floor(corners.min(axis=0) / cell).astype(int)
    high = np.ceil(corners.max(axis=0) / cell).astype(int)
    shape = (int(high[0] - low[0] + 1), int(high[1] - low[1] + 1))
    if shape[0] * shape[1] > _MOST_CELLS:
        raise TopometricError(
            f"the maps of one storey lie {shape[0] * cell:.0f} m by {shape[1] * cell:.0f} m apart, "
            f"{shape[0] * shape[1]} raster cells, at most {_MOST_CELLS} are made: is an alignment "
            "or a prior that was given wrong?"
        )
    total = np.zeros((4, *shape), bool)
    for layers, T in parts:
        # Only where the map is: a fleet's building is much larger than one agent's part.
        around = apply(T, _corners(layers))[:, :2] / cell
        first = np.clip(np.floor(around.min(axis=0)).astype(int) - 1 - low, 0, shape)
        last = np.clip(np.ceil(around.max(axis=0)).astype(int) + 2 - low, 0, shape)
        part = (slice(first[0], last[0]), slice(first[1], last[1]))
        grid = np.stack(np.meshgrid(*map(np.arange, first, last), indexing="ij"), axis=-1)
        centres = np.zeros((grid[..., 0].size, 3))
        centres[:, :2] = (grid.reshape(-1, 2) + low) * cell
        rows, inside = _sampled(layers, apply(inverse(T), centres)[:, :2])
        for seen, name in zip(total, _MASKS, strict=True):
            here = inside & getattr(layers, name).ravel()[rows]
            seen[part] |= here.reshape(grid.shape[:2])
    wall, furniture, free, bare = total
    free &= ~wall
    bare &= free & ~furniture
    origin = (float(low[0] * cell), float(low[1] * cell))
    return StoreyLayers(cell, origin, wall, furniture, free, bare)


def _corners(layers: StoreyLayers) -> NDArray[np.float64]:
    """Return the centres of a raster's four corner cells: (4, 3), m, z = 0."""
    nx, ny = layers.wall.shape
    ends = np.array([[0, 0], [0, ny - 1], [nx - 1, 0], [nx - 1, ny - 1]])
    flat = np.asarray(layers.origin) + layers.cell * ends
    return np.column_stack([flat, np.zeros(4)])


def _sampled(
    layers: StoreyLayers, positions: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return the flat index of the cell at each position (n, 2), and whether there is one."""
    cells, inside = layers.cells_at(positions)
    return cells[:, 0] * layers.wall.shape[1] + cells[:, 1], inside
