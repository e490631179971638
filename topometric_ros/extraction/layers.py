"""What each storey looks like from above: walls, furniture and seen-free floor as 0.1 m rasters.

The rasters are what the global search slides over each other and what the verification reads.
Their idea is that *free space decides*: a wall of one map that stands where the other saw nothing
but floor disproves a pose, however well everything else fits.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.configuration import parameter
from topometric_ros.extraction.errors import ExtractionError
from topometric_ros.extraction.masks import BESIDE, closed, dilated
from topometric_ros.topometric_map import StoreyLayers
from topometric_ros.voxels.grid import bounds

CELL = 0.1
"""Edge of a raster cell in metres: the thresholds below and in `matching` are made for it."""

BIN = 0.05
"""Height in metres of the bins whose number decides what is a wall and what is furniture."""

_TILE = 1.0
"""Edge in metres of the tiles in which a sloping floor is followed."""

_POINTS_OF_TILE = 60
"""Points within 6 cm of height that make a tile's floor; a full one has 400."""

_PADDING = 12
"""Empty cells round each raster, so that closing and dilating never meet its edge."""

_MOST_CELLS = 36_000_000
"""600 m x 600 m: more is a stray point, and would take gigabytes."""


class LayersError(ExtractionError):
    """A storey too wide for its rasters."""


@dataclass(frozen=True)
class LayersConfig:
    """Heights above a storey's floor, and how full a column must be, to be wall or furniture."""

    wall_bottom: float = parameter(
        0.95, "Lower end of the band that walls fill.", unit="m", minimum=0.3, maximum=2.0
    )
    wall_top: float = parameter(
        2.05, "Upper end of the band that walls fill.", unit="m", minimum=0.5, maximum=2.5
    )
    wall_bins: int = parameter(
        4, "Occupied 5 cm bins of the walls' band that make a cell a wall.", minimum=1, maximum=30
    )
    furniture_bottom: float = parameter(
        0.2, "Lower end of the band that furniture fills.", unit="m", minimum=0.05, maximum=1.0
    )
    furniture_bins: int = parameter(
        3, "Occupied 5 cm bins below the walls' band that make furniture.", minimum=1, maximum=30
    )
    floor_tolerance: float = parameter(
        0.12,
        "Points this near to the floor's height are floor.",
        unit="m",
        minimum=0.02,
        maximum=0.3,
    )
    floor_drift: float = parameter(
        0.3, "How far a sloping or drifting floor is followed; 0: not at all.", unit="m",
        minimum=0.0, maximum=0.6,
    )  # fmt: skip
    floor_closing: int = parameter(
        3, "Radius in cells of the disk that closes gaps in the seen floor.", minimum=0, maximum=10
    )
    floor_search_below: float = parameter(
        0.1, "How far below a proposed floor its exact height is sought.", unit="m", minimum=0.0,
        maximum=0.5,
    )  # fmt: skip
    floor_search_above: float = parameter(
        0.4, "How far above a proposed floor its exact height is sought.", unit="m", minimum=0.0,
        maximum=1.0,
    )  # fmt: skip
    floor_share: float = parameter(
        0.3, "The floor is the highest 2 cm bin with this share of the fullest.", minimum=0.05,
        maximum=1.0,
    )  # fmt: skip


def refine_floor(points: NDArray[np.float64], z: float, config: LayersConfig) -> float:
    """Return a floor's height to 2 cm.

    A slab has two faces and a floor stands on the upper one, so it is the highest bin that holds
    a fair share of the fullest, not the fullest itself.

    Parameters
    ----------
    points : (P, 3) float64, m, level frame, thinned
    z : height of the proposed floor, m

    Returns
    -------
    Height in m, or `z` where no point lies in the range that is searched.
    """
    step = 0.02
    above = points[:, 2] - z
    near = above[(above > -config.floor_search_below) & (above < config.floor_search_above)]
    if len(near) == 0:
        return float(z)
    bins = np.floor((near + config.floor_search_below) / step).astype(np.int64)
    counts = np.bincount(bins)
    # Noise may put the floor on the border of two bins; a window of two keeps its peak whole.
    pairs = counts + np.append(counts[1:], 0)
    top = int(np.flatnonzero(pairs >= config.floor_share * pairs.max())[-1])
    face = near[np.abs(near + config.floor_search_below - (top + 1) * step) <= 3 * step]
    return float(z + np.median(face))


def storey_layers(
    points: NDArray[np.float64], floors: Sequence[float], config: LayersConfig
) -> tuple[StoreyLayers, ...]:
    """Return the bird's-eye rasters of every storey.

    A cell is *wall* where enough 5 cm bins of the band 0.95-2.05 m above the floor are occupied,
    *furniture* where enough of 0.2-0.95 m are and no wall is next to it, *free* where floor was
    seen (small gaps closed) with no point in the walls' band and no wall next to it, and *bare*
    where it is free with no point above 0.2 m either.

    Parameters
    ----------
    points : (P, 3) float64, m, level frame, thinned to about 5 cm
    floors : heights of the floors, m, as :func:`refine_floor` gives them
    config : LayersConfig

    Returns
    -------
    One StoreyLayers a floor, in the order of `floors`. Cell centres are integer multiples of 0.1 m
    in the level frame, so a growing map keeps its cells; each raster is cropped to what it holds.

    Raises
    ------
    LayersError
        A storey spans more than 600 m x 600 m.
    """
    result = []
    for z in floors:
        # What may be of this storey once its floor is followed.
        bottom = -config.floor_tolerance - config.floor_drift
        part = _between(points, z, bottom, config.wall_top + config.floor_drift)
        _check_extent(part)
        result.append(_layers_of_storey(part, above_floor(part, z, config), config))
    return tuple(result)


@njit(cache=True, nogil=True)
def _between(points, z, bottom, top):  # type: ignore[no-untyped-def]
    """Points whose height above `z` lies between two: (K, 3)."""
    part = np.empty_like(points)
    count = 0
    for p in range(len(points)):
        if bottom < points[p, 2] - z < top:
            part[count] = points[p]
            count += 1
    return part[:count].copy()


def _check_extent(points: NDArray[np.float64]) -> None:
    """Raise LayersError where points (P, 3) span more than rasters can hold."""
    if len(points) == 0:
        return
    low, high = bounds(points)
    x, y, _ = high - low
    if x * y > _MOST_CELLS * CELL**2:
        raise LayersError(
            f"a storey spans {x:.0f} m x {y:.0f} m: remove the points far outside the building"
        )


def above_floor(points: NDArray[np.float64], z: float, config: LayersConfig) -> NDArray[np.float64]:
    """Return the height of every point above the floor below it: (P,) float64, m.

    Floors slope and odometry drifts: over a real storey the floor's height varied by 0.2 m, more
    than the noise that tells floor from what stands on it. So the floor is followed from tile to
    tile of 1 m, from where it is at height `z`, as long as it rises or falls by 5 % at most; a
    step, or the ceiling of the storey below seen through an unmapped floor, is not followed.
    """
    heights = points[:, 2] - z
    near = np.abs(heights) < config.floor_drift
    if config.floor_drift == 0.0 or not near.any():
        return heights
    on_floor = np.floor(points[near, :2] / _TILE).astype(np.int64)
    low, high = bounds(on_floor)
    shape = high - low + 1
    offset = _followed(*_floor_of_tiles(on_floor - low, heights[near], shape, config), config)
    _take_off(points, low, offset, heights)
    return heights


@njit(cache=True, nogil=True)
def _take_off(points, low, offset, heights):  # type: ignore[no-untyped-def]
    """Take the floor's height in the nearest of the tiles from `low` on off heights, in place."""
    for p in range(len(points)):
        i = np.int64(np.floor(points[p, 0] / _TILE)) - low[0]
        j = np.int64(np.floor(points[p, 1] / _TILE)) - low[1]
        i = min(max(i, 0), offset.shape[0] - 1)
        j = min(max(j, 0), offset.shape[1] - 1)
        heights[p] -= offset[i, j]


def _floor_of_tiles(
    tile: NDArray[np.int64],
    heights: NDArray[np.float64],
    shape: NDArray[np.int64],
    config: LayersConfig,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return where most points of each tile lie in height, m, and whether they are many."""
    step = 0.02
    bins = np.floor((heights + config.floor_drift) / step).astype(np.int64)
    number = int(np.ceil(2.0 * config.floor_drift / step)) + 1
    flat = (tile[:, 0] * shape[1] + tile[:, 1]) * number + bins
    counts = np.bincount(flat, minlength=int(shape[0] * shape[1]) * number)
    counts = counts.reshape(int(shape[0]), int(shape[1]), number)
    window = ndimage.uniform_filter1d(counts.astype(float), 3, mode="constant") * 3.0
    fullest = window.argmax(axis=2)
    many = window.max(axis=2) >= _POINTS_OF_TILE
    return (fullest + 0.5) * step - config.floor_drift, many


def _followed(
    height: NDArray[np.float64], many: NDArray[np.bool_], config: LayersConfig
) -> NDArray[np.float64]:
    """Return the floor of every tile: that of the tiles reached, elsewhere the nearest's."""
    rise = 0.05
    reached = many & (np.abs(height) <= config.floor_tolerance / 2.0)
    around = np.ones((3, 3))
    while True:
        weight = ndimage.convolve(reached.astype(float), around, mode="constant")
        total = ndimage.convolve(np.where(reached, height, 0.0), around, mode="constant")
        beside = total / np.maximum(weight, 1.0)
        more = many & ~reached & (weight > 0.0) & (np.abs(height - beside) <= rise)
        if not more.any():
            break
        reached |= more
    if not reached.any():
        return np.zeros(height.shape)
    index = ndimage.distance_transform_edt(~reached, return_distances=False, return_indices=True)
    return height[index[0], index[1]]


def _layers_of_storey(
    points: NDArray[np.float64], heights: NDArray[np.float64], config: LayersConfig
) -> StoreyLayers:
    """Rasters of the points (P, 3) of one storey; `heights` (P,) are metres above its floor."""
    columns, heights = _columns_of(points, heights, -config.floor_tolerance, config.wall_top)
    if len(columns) == 0:
        empty = np.zeros((1, 1), bool)
        return StoreyLayers(CELL, (0.0, 0.0), empty, empty, empty, empty)
    low, high = bounds(columns)
    low -= _PADDING
    shape = high - low + 1 + _PADDING
    wall_bins, furniture_bins, floor = _count_bins(
        columns - low,
        heights,
        (int(shape[0]), int(shape[1])),
        config.wall_bottom,
        config.furniture_bottom,
        config.floor_tolerance,
    )
    wall = wall_bins >= config.wall_bins
    beside_wall = dilated(wall, BESIDE)
    furniture = (furniture_bins >= config.furniture_bins) & ~beside_wall
    radius = config.floor_closing
    free = closed(floor, math.sqrt(radius * radius + radius)) & ~beside_wall & (wall_bins == 0)
    bare = free & (furniture_bins == 0)
    return _cropped(low, wall, furniture, free, bare)


@njit(cache=True, nogil=True)
def _columns_of(points, heights, bottom, top):  # type: ignore[no-untyped-def]
    """Columns (K, 2) int64 and heights (K,) of the points whose height lies between two."""
    columns = np.empty((len(points), 2), np.int64)
    kept = np.empty(len(points))
    count = 0
    for p in range(len(points)):
        if bottom < heights[p] < top:
            columns[count, 0] = np.int64(np.floor(points[p, 0] / CELL + 0.5))
            columns[count, 1] = np.int64(np.floor(points[p, 1] / CELL + 0.5))
            kept[count] = heights[p]
            count += 1
    return columns[:count], kept[:count]


def _cropped(low: NDArray[np.int64], *masks: NDArray[np.bool_]) -> StoreyLayers:
    """Cut the four masks to the smallest rectangle that holds all that is set in any."""
    seen = masks[0] | masks[1] | masks[2] | masks[3]
    if not seen.any():
        empty = np.zeros((1, 1), bool)
        return StoreyLayers(CELL, (0.0, 0.0), empty, empty, empty, empty)
    rows, cols = (np.flatnonzero(seen.any(axis=axis)) for axis in (1, 0))
    window = np.s_[rows[0] : rows[-1] + 1, cols[0] : cols[-1] + 1]
    origin = (float((low[0] + rows[0]) * CELL), float((low[1] + cols[0]) * CELL))
    wall, furniture, free, bare = (np.ascontiguousarray(mask[window]) for mask in masks)
    return StoreyLayers(CELL, origin, wall, furniture, free, bare)


@njit(cache=True, nogil=True)
def _count_bins(  # type: ignore[no-untyped-def]
    columns, heights, shape, wall_bottom, furniture_bottom, floor_tolerance
):
    """Count each cell's occupied bins in the walls' and furniture's bands; mark seen floor."""
    wall_bits = np.zeros(shape, np.uint64)
    furniture_bits = np.zeros(shape, np.uint64)
    floor = np.zeros(shape, np.bool_)
    for p in range(len(heights)):
        i, j, z = columns[p, 0], columns[p, 1], heights[p]
        if z >= wall_bottom:
            wall_bits[i, j] |= np.uint64(1) << np.uint64((z - wall_bottom) / BIN)
        elif z >= furniture_bottom:
            furniture_bits[i, j] |= np.uint64(1) << np.uint64((z - furniture_bottom) / BIN)
        if abs(z) < floor_tolerance:
            floor[i, j] = True
    wall_bins = np.zeros(shape, np.uint8)
    furniture_bins = np.zeros(shape, np.uint8)
    for i in range(shape[0]):
        for j in range(shape[1]):
            wall_bins[i, j] = _ones(wall_bits[i, j])
            furniture_bins[i, j] = _ones(furniture_bits[i, j])
    return wall_bins, furniture_bins, floor


@njit(cache=True, nogil=True)
def _ones(bits):  # type: ignore[no-untyped-def]
    """Count the bits that are set."""
    count = 0
    while bits:
        bits &= bits - np.uint64(1)
        count += 1
    return count
