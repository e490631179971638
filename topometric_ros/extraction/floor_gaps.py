"""Closing gaps in the navigable volume where the floor was not seen, by evidence (§6.1).

The draft widens the neighbourhood over which navigable voxels are joined, and gets beds and the
ceiling with it. Here a cell without floor is added only where something speaks for a floor and
nothing against it:

- *height and slope*: floor was seen on both sides of the gap, at heights that a ramp joins;
- *free space above*: the stick fits on the line between them, with headroom over it, so walls,
  beds and tables end the gap; a wide gap needs a ceiling above it as well, as indoors;
- *glass*: across a gap as narrow as a pane a few specks do not end it, but anything solid does;
- *nothing below*: where a lower storey is seen through the gap it is an opening;
- *the sensor's way*, where it is known: what carried the sensor stood there, whatever was seen.

`floor_bridges.py` looks along the lines. Treads of stairs too steep or too narrow for the stick
are those of `stairs.py`.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.floor_bridges import NO_FLOOR, SLAB, bridged
from topometric_ros.extraction.navigation import NavigationConfig
from topometric_ros.extraction.storeys import StoreyHeights
from topometric_ros.voxels.components import connected_components
from topometric_ros.voxels.grid import VoxelGrid, in_morton_order
from topometric_ros.voxels.index import VoxelIndex
from topometric_ros.voxels.kernels import circle, kernel_of

_BAND = (-0.5, 1.2)
"""Heights over a storey's floor, m, of what is floor of that storey, ramps and landings too."""
_AT_FLOOR = 0.15
"""How far from its storey's floor a piece of floor that stands alone may lie, m."""
_FOOT = 0.2
"""Radius of what carries the sensor, m."""
_STRIDE = 1.0
"""Places of the sensor up to this far apart, m, were walked between."""
_STEADY = 0.15
"""The sensor's height over the floor is trusted where half of it is within this, m."""


def close_gaps(
    navigable: NDArray[np.int32],
    standing: NDArray[np.int32],
    grid: VoxelGrid,
    storeys: Sequence[StoreyHeights],
    config: NavigationConfig,
    way: NDArray[np.float64] | None = None,
) -> NDArray[np.int32]:
    """Add to the navigable volume the floor that must be there though it was not seen.

    Parameters
    ----------
    navigable : (M, 3) int32, cells of the grid in Morton order
    standing : (S, 3) int32, the cells on which the stick fits: pieces of floor that are too small
        to be told from shelves by themselves count once floor is closed up to them
    grid : the occupied voxels
    storeys : lowest first
    config : `gap` and `roofed_gap`; with both 0 only the way is used
    way : (K, 3) float64, m, level frame, where the sensor was, in order; None: not known

    Returns
    -------
    (N, 3) int32, the same cells and those added, which need not be occupied, in Morton order
    """
    if len(navigable) == 0 or (way is None and max(config.gap, config.roofed_gap) == 0.0):
        return navigable
    # Treads are navigable though the stick fits on none of them, so both have a say.
    places = np.concatenate([navigable[:, :2], standing[:, :2]])
    corner = places.min(axis=0)
    shape = tuple((places.max(axis=0) - corner + 1).tolist())
    added = [navigable]
    for number, storey in enumerate(storeys):
        below = storeys[number - 1] if number else None
        above = storeys[number + 1] if number + 1 < len(storeys) else None
        known = [_of_storey(cells, grid, storey, below, above) for cells in (navigable, standing)]
        z = grid.origin[2] + known[1][:, 2] * grid.voxel_size
        known[1] = known[1][np.abs(z - storey.floor) <= max(_AT_FLOOR, grid.voxel_size)]
        floor = _lowest(np.concatenate(known), corner, shape)
        added.append(known[1])
        if way is not None:
            here = way[(way[:, 2] >= storey.floor) & (way[:, 2] < storey.ceiling)]
            added.append(_walked(floor, here, corner, grid))
        added.append(bridged(floor, corner, grid.index, grid.voxel_size, config, number == 0))
    every = in_morton_order(np.concatenate(added))
    if len(storeys) > 1:
        every = every[_not_under_floor(every, VoxelIndex(every), grid.index, grid.voxel_size)]
    return _joined(
        every, VoxelIndex(navigable), math.floor(config.dilation / grid.voxel_size + 0.5)
    )


def _of_storey(
    cells: NDArray[np.int32],
    grid: VoxelGrid,
    storey: StoreyHeights,
    below: StoreyHeights | None,
    above: StoreyHeights | None,
) -> NDArray[np.int32]:
    """Return the cells that may be floor of a storey; the ceiling below has room above it too."""
    z = grid.origin[2] + cells[:, 2] * grid.voxel_size
    high = (
        storey.floor + _BAND[1]
        if above is None
        else min(storey.floor + _BAND[1], above.floor + _BAND[0])
    )
    inside = (z >= storey.floor + _BAND[0]) & (z < high)
    if below is not None and below.ceiling_seen:
        off = np.abs(z - below.ceiling) < np.abs(z - storey.floor)
        inside &= ~(off & (np.abs(z - below.ceiling) <= max(_AT_FLOOR, grid.voxel_size)))
    return cells[inside]


def _not_under_floor(
    cells: NDArray[np.int32], index: VoxelIndex, occupied: VoxelIndex, size: float
) -> NDArray[np.bool_]:
    """Return which cells have no floor that was added right above them: (N,) bool.

    Where a floor is missing the ceiling under it seems to be one.
    """
    kept = np.ones(len(cells), bool)
    for rise in range(1, math.floor(SLAB / size) + 1):
        above = cells + np.array([0, 0, rise], np.int32)
        kept &= ~((index.rows(above) >= 0) & (occupied.rows(above) < 0))
    return kept


def _joined(cells: NDArray[np.int32], known: VoxelIndex, rise: int) -> NDArray[np.int32]:
    """Return the cells of the pieces that hold cells that were navigable before."""
    flat, tall = np.arange(-1, 2), np.arange(-rise - 1, rise + 2)
    near = np.stack(np.meshgrid(flat, flat, tall, indexing="ij"), -1).reshape(-1, 3)
    component = connected_components(cells, kernel_of(near))
    return cells[(np.bincount(component, known.rows(cells) >= 0) > 0)[component]]


def _lowest(
    cells: NDArray[np.int32], corner: NDArray[np.int32], shape: tuple[int, ...]
) -> NDArray[np.int32]:
    """Return the lowest of the cells in each column: (nx, ny), NO_FLOOR where none is."""
    highest = np.full(shape, np.iinfo(np.int32).max, np.int32)
    np.minimum.at(highest, tuple((cells[:, :2] - corner).T), cells[:, 2])
    return np.where(highest == np.iinfo(np.int32).max, NO_FLOOR, highest).astype(np.int32)


def _walked(
    floor: NDArray[np.int32], way: NDArray[np.float64], corner: NDArray[np.int32], grid: VoxelGrid
) -> NDArray[np.int32]:
    """Return the floor under the sensor's way where none was seen: (A, 3) int32 cells."""
    nothing = np.zeros((0, 3), np.int32)
    if len(way) == 0:
        return nothing
    size = grid.voxel_size
    places = _between(way, size)
    cells = np.floor((places - grid.origin) / size + 0.5).astype(np.int64)
    inside = np.all((cells[:, :2] >= corner) & (cells[:, :2] < corner + floor.shape), axis=1)
    places, at = places[inside], cells[inside][:, :2] - corner
    seen = floor[tuple(at.T)]
    heights = places[seen != NO_FLOOR, 2] - (grid.origin[2] + seen[seen != NO_FLOOR] * size)
    if len(heights) == 0:
        return nothing
    height = float(np.median(heights))
    if float(np.median(np.abs(heights - height))) > _STEADY:
        return nothing
    z = np.floor((places[:, 2] - height - grid.origin[2]) / size + 0.5).astype(np.int32)
    disk = circle(_FOOT / size).coords[:, :2]
    under = (at[:, None] + disk).reshape(-1, 2)
    z = np.repeat(z, len(disk))
    known = np.all((under >= 0) & (under < floor.shape), axis=1)
    under, z = under[known], z[known]
    new = floor[tuple(under.T)] == NO_FLOOR
    under, z = under[new], z[new]
    lowest = _lowest(
        np.column_stack([under, z]).astype(np.int32), np.zeros(2, np.int32), floor.shape
    )
    added = lowest != NO_FLOOR
    floor[added] = lowest[added]
    return np.column_stack([np.argwhere(added) + corner, lowest[added]]).astype(np.int32)


def _between(way: NDArray[np.float64], size: float) -> NDArray[np.float64]:
    """Return places along the way, at most a voxel apart where it was walked in one go: (P, 3)."""
    parts = [way]
    for start, end in itertools.pairwise(way):
        length = float(np.linalg.norm(end - start))
        if size < length <= _STRIDE:
            share = np.linspace(0.0, 1.0, math.ceil(length / size) + 1)[1:-1, None]
            parts.append(start + share * (end - start))
    return np.concatenate(parts)
