"""The navigable volume: voxels that an agent could stand on (thesis §4.2.1-4.2.4).

A stick-shaped kernel finds voxels with room above them, an upward dilation joins steps of stairs,
and connected components of the result tell the floor from table tops and shelves.

Deviation: scans from inside show the ceiling as a sheet with nothing above it, on which a stick
fits everywhere, so it would be the largest component of nearly every map. A floor has walls or
other things standing round it; a component without them is left out.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.extraction.columns import Columns, sort_columns
from topometric_ros.extraction.storeys import StoreyHeights
from topometric_ros.voxels.components import connected_components
from topometric_ros.voxels.grid import VoxelGrid
from topometric_ros.voxels.index import VoxelIndex, row_at
from topometric_ros.voxels.kernels import (
    Kernel,
    circle,
    column,
    connectivity,
    convolve,
    dilate,
    kernel_of,
    stick_kernel,
)

logger = logging.getLogger(__name__)

_GAP = 0.3
"""Widest hole in a floor that is not yet its rim, m."""
_BESIDE = 0.4
"""How far from the rim of a component something may stand to count as beside it, m: a stick's
radius, and two voxels of 0.1 m for what the lattice adds."""
_AT_FLOOR = 0.3
_AT_CEILING = 0.2
"""How far from a storey's floor, or ceiling, something still belongs to it, m."""
_STANDING = (0.4, 0.6, 0.8, 1.0, 1.2, 1.4)
"""Heights above the floor at which something that stands there is looked for, m: above noise and
steps, below lintels. Walls are upright, so a few heights will do."""


@dataclass(frozen=True)
class NavigationConfig:
    """How an agent stands and moves; the defaults are the thesis' values."""

    thin_height: float = parameter(
        0.25,
        "Height of the stick's thin part, one voxel wide, above the floor voxel.",
        unit="m",
        minimum=0.0,
        maximum=2.0,
    )
    wide_height: float = parameter(
        0.75, "Height of the stick's wide part.", unit="m", minimum=0.0, maximum=3.0
    )
    diameter: float = parameter(
        0.3, "Diameter of the stick's wide part.", unit="m", minimum=0.0, maximum=2.0
    )
    dilation: float = parameter(
        0.2,
        "How far unobstructed voxels grow upwards, to join steps of stairs.",
        unit="m",
        minimum=0.0,
        maximum=1.0,
    )
    connectivity: str = parameter(
        "6", "Neighbourhood that joins navigable voxels.", choices=("6", "26")
    )
    keep: str = parameter(
        "largest",
        "Keep the largest component, or all whose area is at least smallest_area.",
        choices=("largest", "all"),
    )
    smallest_enclosure: float = parameter(
        0.1,
        "Smallest share of a component's rim with something standing beside it; 0 keeps roofs.",
        minimum=0.0,
        maximum=1.0,
    )
    largest_off_floor: float = parameter(
        0.0,
        "Larger level patches at the height of a storey's ceiling are no floor, nor are smaller "
        "components that come near no storey's floor; 0 keeps all.",
        unit="m²",
        minimum=0.0,
    )
    smallest_area: float = parameter(
        1.0,
        "Smallest area of a component that is kept where all are.",
        unit="m²",
        minimum=0.0,
    )
    gap: float = parameter(
        0.0,
        "Widest hole in the floor that is closed where nothing stands in it and floor at the same "
        "height, or on one ramp, was seen on both sides; 0 closes none.",
        unit="m",
        minimum=0.0,
        maximum=5.0,
    )
    roofed_gap: float = parameter(
        0.0,
        "Widest hole in the floor that is closed alike where a ceiling is above all of it; "
        "0 closes none.",
        unit="m",
        minimum=0.0,
        maximum=10.0,
    )
    treads: bool = parameter(
        False,
        "Add the treads of stairs on which the stick does not fit, as it does not on steep ones.",
    )


def unobstructed(
    grid: VoxelGrid, config: NavigationConfig, columns: Columns | None = None
) -> NDArray[np.bool_]:
    """Return which voxels have no other voxel within the stick kernel: (N,) bool (eq. 22).

    Eq. 22 sums over the kernel; whether the sum is 0 is read from the grid's `columns` instead,
    sorted here if the caller has none, in a fifth of the time.
    """
    stick = stick_kernel(grid.voxel_size, config.thin_height, config.wide_height, config.diameter)
    if len(grid) == 0:
        return np.zeros(0, bool)
    columns = sort_columns(grid.coords) if columns is None else columns
    offsets = stick.offsets()[stick.weights > 0]
    sides, of = np.unique(offsets[:, :2], axis=0, return_inverse=True)
    lowest = np.full(len(sides), np.iinfo(np.int32).max, np.int32)
    highest = np.zeros(len(sides), np.int32)
    np.minimum.at(lowest, of.reshape(-1), offsets[:, 2])
    np.maximum.at(highest, of.reshape(-1), offsets[:, 2])
    place = np.full(columns.shape, -1, np.int32)
    place[tuple(columns.cells.T)] = np.arange(len(columns.cells))
    z = columns.z[columns.order]
    free = np.empty(len(grid), bool)
    free[columns.order] = _stick_fits(
        z, columns.starts, columns.cells, place, sides, lowest, highest
    )
    return free


@njit(cache=True, nogil=True)
def _stick_fits(z, starts, cells, place, sides, lowest, highest):  # type: ignore[no-untyped-def]
    """Which voxels, sorted by columns, have none from `lowest` to `highest` above them.

    The heights hold in the column at each of the `sides` (K, 2); `place` is the column of a cell.
    """
    free = np.ones(len(z), np.bool_)
    for c in range(len(cells)):
        for k in range(len(sides)):
            i, j = cells[c, 0] + sides[k, 0], cells[c, 1] + sides[k, 1]
            if not (0 <= i < place.shape[0] and 0 <= j < place.shape[1]) or place[i, j] < 0:
                continue
            other, end = starts[place[i, j]], starts[place[i, j] + 1]
            for own in range(starts[c], starts[c + 1]):
                while other < end and z[other] < z[own] + lowest[k]:
                    other += 1
                if other == end:
                    break
                if z[other] <= z[own] + highest[k]:
                    free[own] = False
    return free


def navigable_volume(
    grid: VoxelGrid, config: NavigationConfig, free: NDArray[np.bool_] | None = None
) -> NDArray[np.int32]:
    """Return V_navigation = V_max ∩ V: the voxels that an agent could stand on.

    Parameters
    ----------
    grid : occupied voxels, z up
    config : the agent and what to keep
    free : (N,) bool, what :func:`unobstructed` says of the grid, if the caller has it

    Returns
    -------
    (M, 3) int32, a subset of the grid's cells in Morton order; empty if nothing can be stood on
    """
    standing = grid.coords[unobstructed(grid, config) if free is None else free]
    if len(standing) == 0:
        return np.zeros((0, 3), np.int32)
    height = math.floor(config.dilation / grid.voxel_size + 0.5)
    dilated = dilate(standing, column(height))
    volume = VoxelIndex(dilated)
    component = connected_components(dilated, connectivity(config.connectivity), index=volume)
    row = grid.index.rows(dilated)
    large = np.ones(component.max() + 1, bool)
    if config.keep == "all":
        voxels = np.bincount(component[row >= 0], minlength=len(large))
        large = voxels * grid.voxel_size**2 >= config.smallest_area
    enclosure = _enclosure(dilated, component, (row >= 0) & large[component], grid, volume)
    kept = large & (enclosure >= min(config.smallest_enclosure, enclosure.max()))
    if config.keep == "largest":
        kept &= np.cumsum(kept) == 1
    logger.debug("%d navigable components, %d kept", len(kept), kept.sum())
    return grid.coords[np.sort(row[kept[component] & (row >= 0)])]


def on_storeys(
    navigable: NDArray[np.int32],
    grid: VoxelGrid,
    storeys: Sequence[StoreyHeights],
    config: NavigationConfig,
) -> NDArray[np.int32]:
    """Drop what cannot be a floor once the storeys are known: ceilings, and beds and tables.

    A ceiling whose upper side is walls and slabs has things standing beside it as a floor has. It
    is told by its height; steps of stairs that pass there are too small to be one.

    Parameters
    ----------
    navigable : (M, 3) int32, cells of the grid in Morton order
    grid : the occupied voxels
    storeys : their floors and ceilings
    config : `largest_off_floor`; 0 returns everything

    Returns
    -------
    (K, 3) int32, the rows that stay
    """
    if config.largest_off_floor == 0.0 or len(navigable) == 0 or not storeys:
        return navigable
    most = config.largest_off_floor / grid.voxel_size**2
    z = grid.origin[2] + navigable[:, 2] * grid.voxel_size
    floors = np.array([s.floor for s in storeys])
    ceilings = np.array([s.ceiling for s in storeys if s.ceiling_seen])
    at_floor = (np.abs(z[:, None] - floors) <= max(_AT_FLOOR, grid.voxel_size)).any(axis=1)
    at_ceiling = (np.abs(z[:, None] - ceilings) <= max(_AT_CEILING, grid.voxel_size)).any(axis=1)
    kept = np.ones(len(navigable), bool)
    suspects = np.flatnonzero(at_ceiling & ~at_floor)
    if len(suspects):
        patch = connected_components(navigable[suspects], connectivity("26"))
        kept[suspects] = np.bincount(patch)[patch] <= most
    rest = np.flatnonzero(kept)
    if len(rest) == 0:
        return navigable[:0]
    # Steps are joined over the height that an agent climbs.
    steps = _flat_steps(math.floor(config.dilation / grid.voxel_size + 0.5) + 1)
    component = connected_components(navigable[rest], steps)
    touching = np.bincount(component, at_floor[rest]) > 0
    kept[rest] = (touching | (np.bincount(component) > most))[component]
    return navigable[kept]


def _flat_steps(rise: int) -> Kernel:
    """Return the cells beside a voxel, up to `rise` cells higher or lower."""
    flat, tall = np.arange(-1, 2), np.arange(-rise, rise + 1)
    offsets = np.stack(np.meshgrid(flat, flat, tall, indexing="ij"), -1).reshape(-1, 3)
    return kernel_of(offsets)


def _enclosure(
    dilated: NDArray[np.int32],
    component: NDArray[np.int32],
    inside: NDArray[np.bool_],
    grid: VoxelGrid,
    volume: VoxelIndex,
) -> NDArray[np.float64]:
    """Return the share of each component's rim that something stands beside: (C,) float64.

    The rim are the voxels of the grid (`inside`) that the component does not go on from in one of
    four directions; holes of a few voxels, as sparse clouds have, make no rim. `volume` is the
    index of what was `dilated`.
    """
    rim = _rim(volume.table, dilated, inside, math.ceil(_GAP / grid.voxel_size))
    count = component.max() + 1
    rims = np.maximum(np.bincount(component[rim], minlength=count), 1)
    something = convolve(dilated[rim], None, _beside_kernel(grid.voxel_size), "any", grid.index)
    return np.bincount(component[rim], something, count) / rims


@njit(cache=True, nogil=True)
def _rim(table, coords, inside, reach):  # type: ignore[no-untyped-def]
    """Rows of the cells `inside` that have none within `reach` cells in one of four directions."""
    rim = np.empty(len(coords), np.int64)
    count = 0
    for i in range(len(coords)):
        if not inside[i]:
            continue
        x, y, z = coords[i]
        for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
            step = 1
            while step <= reach and row_at(table, x + dx * step, y + dy * step, z) < 0:
                step += 1
            if step > reach:
                rim[count] = i
                count += 1
                break
    return rim[:count].copy()


def _beside_kernel(voxel_size: float) -> Kernel:
    """Return the cells in which something that stands beside a rim voxel is looked for."""
    around = circle(_BESIDE / voxel_size).coords
    heights = sorted({math.floor(z / voxel_size + 0.5) for z in _STANDING})
    tall = np.array([(0, 0, z) for z in heights])
    return kernel_of((around[:, None] + tall).reshape(-1, 3))
