"""A storey from above, without its furniture: walls, the floor they enclose and how wide it is.

Walls are read in a band above the furniture and the doors, where lintels seal the doorways. The
rasters are (nx, ny) bool or float64 with 0.1 m cells and an empty margin round what was seen.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.configuration import parameter
from topometric_ros.extraction.columns import Columns
from topometric_ros.extraction.masks import BESIDE, closed, depth, dilated, opened
from topometric_ros.extraction.storeys import RASTER, StoreyHeights
from topometric_ros.voxels.grid import bounds

_EIGHT = np.ones((3, 3), bool)

_INSIDE = 3
"""Cells from a face of a wall to its inside, at most."""

_AROUND = 21
_ROOF = 80
"""Cells that stand on nothing in a square of 2.1 m: more than the lintel of a wide door has."""

_BESIDE = 2
"""Cells round a pillar that are looked at."""

_HEADROOM = 14
"""Cells free above a tread, which a lamp or a lintel does not have."""

_TOP = 0.15
"""What lies this near to the ceiling is no tread of this storey, m."""

_OPEN = 30.0
"""Cells from the nearest wall beyond which it narrows nothing."""

MARGIN = 10
"""Empty cells round the raster, so that no operation meets its edge."""


@dataclass(frozen=True)
class WallsConfig:
    """The band of heights that walls are read from, and how gaps in them close."""

    band_bottom: float = parameter(
        1.9, "Lower end of the band above the floor.", unit="m", minimum=0.5, maximum=3.0
    )
    band_height: float = parameter(
        0.65,
        "The band starts at least this far under the ceiling, so that low rooms have one.",
        unit="m",
        minimum=0.3,
        maximum=2.0,
    )
    band_top: float = parameter(
        0.25, "Upper end of the band under the ceiling.", unit="m", minimum=0.0, maximum=1.0
    )
    smallest_count: int = parameter(
        2, "Occupied cells of the band that make a column a wall.", minimum=1, maximum=20
    )
    closing: float = parameter(
        0.3, "Gaps in walls and floors up to twice this wide close.", unit="m", maximum=2.0
    )
    sloped_roofs: bool = parameter(
        True,
        "Drop thick wall without anything under it: a sloped roof or a flight of stairs in the "
        "band.",
    )
    pillar: float = parameter(
        0.6,
        "Free-standing pieces of wall up to this wide divide no room: pillars, lamps.",
        unit="m",
        minimum=0.0,
        maximum=2.0,
    )
    beside_stairs: float = parameter(
        1.5,
        "Free-standing pieces of wall beside a flight of stairs up to this wide divide no room.",
        unit="m",
        minimum=0.0,
        maximum=5.0,
    )
    roof_support: int = parameter(
        10, "Occupied cells 0.3 to 1.5 m above the floor that make wall of it.", minimum=1
    )


@dataclass(frozen=True)
class StoreyRaster:
    """One storey from above; cell (i, j) is the column at voxel coordinates `corner + (i, j)`.

    `observed` columns hold any voxel of the storey, `domain` is the floor between the walls
    whether seen or not, `distance` (cells, float64) that from the nearest wall or the unknown,
    `clearance` that from the nearest wall alone, at most 30: the rim of what was seen is no wall.
    """

    corner: NDArray[np.int64]
    observed: NDArray[np.bool_]
    wall: NDArray[np.bool_]
    domain: NDArray[np.bool_]
    distance: NDArray[np.float64]
    clearance: NDArray[np.float64]


def storey_raster(
    columns: Columns,
    heights: NDArray[np.float64],
    members: NDArray[np.bool_],
    storey: StoreyHeights,
    config: WallsConfig,
) -> StoreyRaster:
    """Draw the walls and the floor of one storey.

    Parameters
    ----------
    columns : columns of the 0.1 m voxels of the whole building
    heights : (N,) float64, m, mean height of the points seen in each voxel
    members : (N,) bool, the voxels of this storey, at least one
    storey : its floor and ceiling

    Notes
    -----
    Where a flight of stairs runs through the band it is no wall: treads are level, have headroom
    and nothing under them, and together they are wider than a lintel.
    """
    cells = columns.raster_cells()[members].astype(np.int64)
    low, high = bounds(cells)
    low -= MARGIN
    shape = tuple(high - low + 1 + MARGIN)
    flat = np.ravel_multi_index(tuple((cells - low).T), shape)
    above_floor = heights[members] - storey.floor

    def count(bottom: float, top: float, of: NDArray[np.bool_] | None = None) -> NDArray[np.int64]:
        inside = (above_floor >= bottom) & (above_floor <= top)
        if of is not None:
            inside &= of
        return np.bincount(flat[inside], minlength=shape[0] * shape[1]).reshape(shape)

    height = storey.ceiling - storey.floor
    bottom = min(config.band_bottom, height - config.band_height)
    wall = count(bottom, height - config.band_top) >= config.smallest_count
    closing = config.closing / RASTER
    flight = np.zeros(shape, bool)
    if config.sloped_roofs:
        treads = count(bottom, height - _TOP, columns.above[members] > _HEADROOM) > 0
        support = count(0.3, 1.5) >= config.roof_support
        flight = opened(closed(treads, 1) & ~dilated(support, BESIDE), closing)
        wall = _without_roofs(wall, support, flight, closing)
    else:
        wall = closed(wall, closing)
    observed = np.zeros(shape, bool)
    observed.ravel()[flat] = True
    return _raster(columns.corner + low, observed, wall, flight, config)


def _raster(
    corner: NDArray[np.int64],
    observed: NDArray[np.bool_],
    wall: NDArray[np.bool_],
    flight: NDArray[np.bool_],
    config: WallsConfig,
) -> StoreyRaster:
    """Complete a raster from what was seen, its walls and the stairs that run through the band."""
    ground = closed(observed, config.closing / RASTER)
    near_flight = dilated(flight, _INSIDE)
    sizes = np.where(near_flight, max(config.pillar, config.beside_stairs), config.pillar)
    wall = _without_pillars(wall, ground, np.round(sizes / RASTER))
    domain = ground & ~wall
    inside = (domain | dilated(wall, 2)) & ~wall
    distance = depth(inside)
    return StoreyRaster(corner, observed, wall, domain, distance, clearance(wall))


def clearance(wall: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return how far the nearest wall is from every cell: (nx, ny) float64, cells, at most 30."""
    if not wall.any():
        return np.full(wall.shape, _OPEN)
    return np.minimum(depth(~wall), _OPEN)


def _without_pillars(
    wall: NDArray[np.bool_], ground: NDArray[np.bool_], sizes: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Drop walls that stand alone with ground seen all round and are no wider than `sizes`.

    These (nx, ny) are in cells and hold for the walls that lie in theirs. Where less was seen, a
    small piece may be all that was seen of a wall.
    """
    parts, count = ndimage.label(wall, _EIGHT)
    kept = np.ones(count + 1, bool)
    largest = ndimage.maximum(sizes, parts, np.arange(count + 1))
    for part, (x, y) in enumerate(ndimage.find_objects(parts), 1):
        kept[part] = max(x.stop - x.start, y.stop - y.start) > largest[part]
    kept[np.unique(parts[dilated(~ground, _BESIDE)])] = True
    return wall & kept[parts]


def _without_roofs(
    seen: NDArray[np.bool_],
    support: NDArray[np.bool_],
    flight: NDArray[np.bool_],
    radius: float,
) -> NDArray[np.bool_]:
    """Close walls and drop roofs, which are thick and stand on nothing.

    A roof is known by a place that is too thick and has too much round it that stands on nothing
    for a lintel, and is too far from all that stands for the inside of a wall. What stands on
    nothing and hangs together with it, or with a flight of stairs, goes too, 0.6 m far.
    """
    wall = closed(seen, radius)
    hanging = wall & ~dilated(support, BESIDE)
    around = ndimage.uniform_filter(hanging.astype(float), _AROUND, mode="constant") * _AROUND**2
    core = opened(wall, radius) & ~dilated(support, _INSIDE) & (around >= _ROOF)
    core |= flight & wall
    parts, _ = ndimage.label(hanging, _EIGHT)
    of_roof = np.bincount(parts[core & hanging], minlength=int(parts.max()) + 1) > 0
    return wall & ~(hanging & of_roof[parts] & dilated(core, 2 * _INSIDE))
