"""Ceilings that were seen from below only, and so look like the floor of the storey above.

Where nobody walked upstairs, the ceiling is the topmost layer with nothing on it: as free, as level
and as large as a floor, and a slab's thickness too low. Two things tell it: right below each of its
voxels lies free space down to the storey below, and walls stand where they stand below and not
above.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.extraction.columns import NOTHING, Columns
from topometric_ros.extraction.masks import depth
from topometric_ros.extraction.slabs import FREE, SLAB
from topometric_ros.extraction.storeys import RASTER, StoreyConfig, StoreyHeights, find_storeys

_NEAR = 0.3
"""Voxels this near to a floor (m) may be the ceiling below it."""

_UPPER_FACE = 0.1
"""Voxels that lie higher than this over a ceiling, m, are the floor upon it."""

_BAND = (0.95, 2.05)
_BINS = 4
"""A wall fills so many voxels of a column between these heights over the floor (m)."""

_AREA = 3.0
"""Smallest part of a ceiling that is judged, m²."""

_MARGIN = 2
"""Cells round a part that belong to it: above walls nothing is free below."""

_AROUND = np.ones((3, 3), dtype=bool)


def storeys_without_overhead(
    columns: Columns, heights: NDArray[np.float64], origin_z: float, config: StoreyConfig
) -> tuple[Columns, tuple[StoreyHeights, ...]]:
    """Find the storeys, and once more where one of them was partly a ceiling seen from below.

    Parameters are those of :func:`find_storeys`.

    Returns
    -------
    The columns, in which a voxel of such a ceiling has nothing free above it (`above` is 0), and
    the storeys
    """
    storeys = find_storeys(columns, heights, origin_z, config)
    if config.overhead == 0.0 or len(storeys) < 2:
        return columns, storeys
    ceiling = seen_from_below(columns, heights, storeys, config.overhead)
    if not ceiling.any():
        return columns, storeys
    columns = dataclasses.replace(columns, above=np.where(ceiling, 0, columns.above))
    return columns, find_storeys(columns, heights, origin_z, config)


def is_overhead(columns: Columns) -> NDArray[np.bool_]:
    """Return which voxels (N,) :func:`storeys_without_overhead` has told to be a ceiling."""
    return columns.above == 0


def seen_from_below(
    columns: Columns,
    heights: NDArray[np.float64],
    storeys: Sequence[StoreyHeights],
    farther: float,
) -> NDArray[np.bool_]:
    """Return which voxels at a floor's height are the ceiling below it: (N,) bool.

    Parameters
    ----------
    columns, heights : the 0.1 m voxels and their mean heights, m
    storeys : as found, lowest first
    farther : m; how much farther walls must be above than below, on the mean of a part
    """
    cells = columns.raster_cells() + _MARGIN
    shape = (columns.shape[0] + 2 * _MARGIN, columns.shape[1] + 2 * _MARGIN)
    ceiling = np.zeros(len(heights), bool)
    for lower, upper in itertools.pairwise(storeys):
        near = (np.abs(heights - upper.floor) < _NEAR) & (columns.above > FREE)
        reach = heights - np.minimum(columns.below, NOTHING >> 4) * RASTER
        hanging = near & (columns.below > SLAB) & (reach > lower.floor - _NEAR)
        below, above = (
            _to_walls(cells, heights - storey.floor, columns, shape) for storey in (lower, upper)
        )
        labels, parts = _parts(_raster(cells[hanging], shape))
        area = ndimage.sum_labels(labels > 0, labels, parts) * RASTER**2
        gap = ndimage.mean(above - below, labels, parts)
        chosen = np.isin(labels, parts[(area >= _AREA) & (gap > farther)])
        if chosen.any():
            ceiling |= _of_parts(chosen, cells, heights, near, hanging)
    return ceiling


def _parts(hanging: NDArray[np.bool_]) -> tuple[NDArray[np.int32], NDArray[np.int64]]:
    """Return which part each cell belongs to, 0 where none, and the numbers of the parts.

    The walls below part a ceiling into rooms; what lies a wall's thickness apart is one.
    """
    joined = ndimage.binary_dilation(hanging, _AROUND, iterations=_MARGIN)
    labels, count = ndimage.label(joined, _AROUND)
    return np.where(hanging, labels, 0), np.arange(1, count + 1)


def _of_parts(
    chosen: NDArray[np.bool_],
    cells: NDArray[np.int32],
    heights: NDArray[np.float64],
    near: NDArray[np.bool_],
    hanging: NDArray[np.bool_],
) -> NDArray[np.bool_]:
    """Return the voxels of some parts of a ceiling, their rims included."""
    inside = chosen[cells[:, 0], cells[:, 1]]
    level = float(np.median(heights[inside & hanging]))
    wide = ndimage.binary_dilation(chosen, _AROUND, iterations=_MARGIN)
    around = wide[cells[:, 0], cells[:, 1]]
    return near & around & (heights < level + _UPPER_FACE)


def _to_walls(
    cells: NDArray[np.int32],
    above_floor: NDArray[np.float64],
    columns: Columns,
    shape: tuple[int, int],
) -> NDArray[np.float64]:
    """Return the distance (m) of every cell from a storey's walls."""
    band = (above_floor > _BAND[0]) & (above_floor < _BAND[1]) & ~columns.horizontal
    voxels = np.zeros(shape, np.int64)
    np.add.at(voxels, tuple(cells[band].T), 1)
    wall = voxels >= _BINS
    if not wall.any():
        return np.full(shape, float(np.hypot(*shape)) * RASTER)
    return depth(~wall) * RASTER


def _raster(cells: NDArray[np.int32], shape: tuple[int, int]) -> NDArray[np.bool_]:
    image = np.zeros(shape, bool)
    image[cells[:, 0], cells[:, 1]] = True
    return image
