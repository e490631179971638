"""Storeys by headroom: a floor is where much has room to stand above it, a ceiling where that ends.

Everything is read from columns of 0.1 m voxels: how many cells are free above each voxel. Levels
are cells of that size; the results are metres, as fine as the points allow.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.extraction.columns import Columns
from topometric_ros.extraction.slabs import FREE, ceiling_height, floor_height

RASTER = 0.1
"""Edge (m) of the voxels that storeys and rooms are read from, whatever the map's voxel size."""

_THINNEST_SLAB = 0.08
"""A thinner slab's faces are told by what is free beside them, not by their heights, m."""

_FACE = 0.06
"""Voxels this near to a floor or a ceiling lie on it, m."""


@dataclass(frozen=True)
class StoreyConfig:
    """How floors and ceilings are told from tables, shelves and slabs."""

    headroom: float = parameter(
        1.9, "Free height above a floor.", unit="m", minimum=1.0, maximum=3.0
    )
    tallest: float = parameter(
        8.0, "Largest free height that still has a ceiling.", unit="m", minimum=3.0, maximum=50.0
    )
    smallest_share: float = parameter(
        0.06, "Smallest floor as a share of the largest.", minimum=0.0, maximum=1.0
    )
    least_share: float = parameter(
        0.02,
        "Smallest floor with walls round it, as where an agent looked up a stairwell.",
        minimum=0.0,
        maximum=1.0,
    )
    walled: float = parameter(
        0.5,
        "Walls and furniture above a floor below `smallest_share` that make it a storey, in "
        "voxels over those of the floor.",
        minimum=0.0,
        maximum=10.0,
    )
    storey_height: float = parameter(
        2.4,
        "Smallest height between a floor below `smallest_share` and others: landings lie between.",
        unit="m",
        minimum=1.0,
        maximum=5.0,
    )
    smallest_area: float = parameter(1.0, "Smallest floor.", unit="m²", minimum=0.05, maximum=100.0)
    separation: float = parameter(
        1.8, "Smallest height between two floors.", unit="m", minimum=1.0, maximum=5.0
    )
    roofless_share: float = parameter(
        0.3,
        "Smallest floor that has no ceiling, as a share of the largest level with headroom.",
        minimum=0.0,
        maximum=1.0,
    )
    roofless_separation: float = parameter(
        2.0,
        "Smallest height between a floor with no ceiling and other floors.",
        unit="m",
        minimum=1.0,
        maximum=5.0,
    )
    standing_share: float = parameter(
        0.15,
        "Walls and furniture above a floor with no ceiling, as a share of the most above any.",
        minimum=0.0,
        maximum=1.0,
    )
    prominence: float = parameter(
        2.0,
        "How much larger a floor is than the levels within a metre of it on average.",
        minimum=1.0,
        maximum=100.0,
    )
    ceiling_share: float = parameter(
        0.05,
        "Smallest ceiling, as a share of the floor below that has headroom.",
        minimum=0.0,
        maximum=1.0,
    )
    overhead: float = parameter(
        0.8,
        "How much farther from walls a floor's part is than what lies free below it, where it is "
        "rather the ceiling there, seen from below; 0: never.",
        unit="m",
        minimum=0.0,
        maximum=10.0,
    )
    usual_height: float = parameter(
        2.7, "Ceiling above the floor where none was seen.", unit="m", minimum=1.9, maximum=6.0
    )


@dataclass(frozen=True)
class StoreyHeights:
    """One storey: `floor` and `ceiling` in m, level frame.

    `ceiling` is where the storey's space is taken to end, `ceiling_seen` whether a ceiling was.
    """

    floor: float
    ceiling: float
    ceiling_seen: bool


@dataclass(frozen=True)
class _Levels:
    """Histograms over z, each summed over three bins; index 0 is the cell `bottom`."""

    bottom: int
    floors: NDArray[np.int64]
    """F: voxels with headroom and something above it."""
    ceilings: NDArray[np.int64]
    """G: what bounds those gaps above."""
    open: NDArray[np.int64]
    """F2: voxels with headroom, whether or not there is something above it."""
    standing: NDArray[np.int64]
    """Voxels of walls and furniture 0.3 to 1.5 m above."""


def _levels(columns: Columns, config: StoreyConfig) -> _Levels:
    room = round(config.headroom / RASTER)
    tall = round(config.tallest / RASTER)
    bottom = int(columns.z.min()) - 1
    size = int(columns.z.max()) - bottom + 2
    z = columns.z - bottom
    # The top of a wall has headroom too, but wall below it: a floor is a layer of its own.
    layer = columns.horizontal | (columns.below > 1)
    covered = (columns.above >= room) & (columns.above <= tall)
    # A gap of `room` cells between centres leaves room - 1 of them free.
    free = (columns.above > room) & layer
    upright = np.bincount(z[~columns.horizontal], minlength=size)
    total = np.concatenate([[0], np.cumsum(upright)])
    low = np.minimum(np.arange(size) + 3, size)
    high = np.minimum(np.arange(size) + 16, size)
    return _Levels(
        bottom=bottom,
        floors=_three(np.bincount(z[covered], minlength=size)),
        ceilings=_three(np.bincount((z + columns.above)[covered], minlength=size)),
        open=_three(np.bincount(z[free], minlength=size)),
        standing=total[high] - total[low],
    )


def _three(counts: NDArray[np.int64]) -> NDArray[np.int64]:
    """Sum each bin with its two neighbours."""
    padded = np.pad(counts, 1)
    return padded[:-2] + padded[1:-1] + padded[2:]


def _maxima(counts: NDArray[np.int64], least: float) -> list[int]:
    """Return the bins that are local maxima and reach `least`, largest first, ties lowest first.

    On a plateau the middle bin is the maximum.
    """
    found = []
    i = 0
    while i < len(counts):
        j = i
        while j + 1 < len(counts) and counts[j + 1] == counts[i]:
            j += 1
        left = counts[i - 1] if i else -1
        right = counts[j + 1] if j + 1 < len(counts) else -1
        if counts[i] >= max(least, 1) and counts[i] > left and counts[i] > right:
            found.append((i + j) // 2)
        i = j + 1
    return sorted(found, key=lambda b: (-counts[b], b))


def _is_top_of_ceiling(levels: _Levels, level: int) -> bool:
    """Whether a level with headroom above is rather a ceiling with the true floor just above it."""
    floors, ceilings = levels.floors, levels.ceilings
    if ceilings[level] <= floors[level]:
        return False
    above = slice(level + 3, level + 10)
    return bool(np.any((floors[above] >= 0.3 * floors[level]) & (ceilings[above] < floors[above])))


def _stands_out(counts: NDArray[np.int64], level: int, factor: float) -> bool:
    """Whether a bin holds `factor` times what the bins within a metre of it do on average."""
    reach = round(1.0 / RASTER)
    around = np.concatenate(
        [counts[max(0, level - reach) : max(0, level - 2)], counts[level + 3 : level + reach + 1]]
    )
    return len(around) == 0 or bool(counts[level] >= factor * around.mean())


def _floor_levels(levels: _Levels, config: StoreyConfig) -> list[int]:
    """Return the cells of the floors, lowest first: those with a ceiling, then those without."""
    floors: list[int] = []
    covered, open_ = levels.floors, levels.open
    for level in _candidates(covered, config):
        small = covered[level] < config.smallest_share * covered.max()
        if not _is_clear(level, floors, config.storey_height if small else config.separation):
            continue
        if small and levels.standing[level] < config.walled * covered[level]:
            continue
        if _stands_out(covered, level, config.prominence) and not _is_top_of_ceiling(levels, level):
            floors.append(level)
    candidates = _candidates(open_, config)
    share = config.roofless_share * open_.max()
    large = [level for level in candidates if open_[level] >= share]
    most = max((levels.standing[level] for level in large + floors), default=0)
    for level in candidates:
        small = open_[level] < share
        apart = config.storey_height if small else config.roofless_separation
        least = config.standing_share * most
        if small:
            least = max(least, config.walled * open_[level])
        stood_on = levels.standing[level] >= max(least, len(floors) > 0)
        if (
            stood_on
            and _is_clear(level, floors, apart)
            and _stands_out(open_, level, config.prominence)
        ):
            floors.append(level)
    return sorted(floors)


def _candidates(counts: NDArray[np.int64], config: StoreyConfig) -> list[int]:
    """Return the levels that may be floors, the largest first."""
    area = config.smallest_area / RASTER**2
    return _maxima(counts, max(config.least_share * counts.max(), area))


def _is_clear(level: int, floors: Sequence[int], apart: float) -> bool:
    """Whether a level lies `apart` (m) or more from every floor."""
    return all(abs(level - f) >= round(apart / RASTER) for f in floors)


def _ceiling_level(
    columns: Columns, floor: int, following: int | None, config: StoreyConfig
) -> tuple[int, bool]:
    """Return the cell of the ceiling over the floor at cell `floor`, and whether it was seen.

    Door lintels alone, where a scanner saw no ceiling, are too few to be one.
    """
    room = round(config.headroom / RASTER)
    tall = round(config.tallest / RASTER)
    near = np.abs(columns.z - floor) <= 2
    starts = near & (columns.above >= room) & (columns.above <= tall)
    counts = _three(np.bincount((columns.z + columns.above)[starts] - floor, minlength=1))
    ceiling = int(np.argmax(counts))
    open_area = np.count_nonzero(near & (columns.above > room))
    seen = bool(counts[ceiling] > config.ceiling_share * open_area)
    ceiling = floor + (ceiling if seen else round(config.usual_height / RASTER))
    if following is not None and ceiling > following:
        return following, seen
    return ceiling, seen


def find_storeys(
    columns: Columns,
    heights: NDArray[np.float64],
    origin_z: float,
    config: StoreyConfig,
) -> tuple[StoreyHeights, ...]:
    """Find the floors and ceilings of a building, lowest first.

    Parameters
    ----------
    columns : columns of 0.1 m voxels
    heights : (N,) float64, m, mean height of the points seen in each voxel
    origin_z : m, height of the centres of the voxels with z = 0

    Returns
    -------
    The storeys; empty where nothing has headroom above it over the smallest area.
    """
    levels = _levels(columns, config)
    floors = [level + levels.bottom for level in _floor_levels(levels, config)]
    fine = [_fine_floor(columns, heights, level, origin_z) for level in floors]
    storeys = []
    for index, (floor, floor_z) in enumerate(zip(floors, fine, strict=True)):
        last = index + 1 == len(floors)
        following = None if last else floors[index + 1]
        following_z = None if last else fine[index + 1]
        ceiling, seen = _ceiling_level(columns, floor, following, config)
        ceiling_z = floor_z + config.usual_height
        if seen or ceiling == following:
            level_z = origin_z + ceiling * RASTER
            found = ceiling_height(columns, heights, level_z, following_z)
            ceiling_z = level_z if found is None else found
            if found is None and following_z is not None:
                ceiling_z = min(ceiling_z, following_z - RASTER)
        storeys.append(StoreyHeights(floor_z, max(ceiling_z, floor_z + 1.0), seen))
    return tuple(storeys)


def _fine_floor(
    columns: Columns, heights: NDArray[np.float64], level: int, origin_z: float
) -> float:
    """Return the height of a floor; where its face does not show, the median of its layer."""
    found = floor_height(columns, heights, origin_z + level * RASTER)
    if found is not None:
        return found
    near = np.abs(columns.z - level) <= 1
    chosen = heights[near & (columns.above > FREE)]
    return float(np.median(chosen if len(chosen) else heights[near]))


def assign_storeys(
    columns: Columns, heights: NDArray[np.float64], storeys: Sequence[StoreyHeights]
) -> NDArray[np.int32]:
    """Return the index of the storey of every voxel: (N,) int32; below the lowest floor 0.

    What lies on a ceiling is the lower storey's and what lies on a floor the upper one's. Between
    and beside them, what is seen from above belongs to the upper storey and what is seen from
    below to the lower one; the rest to the nearer surface.
    """
    storey = np.zeros(len(columns.z), np.int32)
    free_above, free_below = columns.above > FREE, columns.below > FREE
    for index in range(1, len(storeys)):
        c, f = storeys[index - 1].ceiling, storeys[index].floor
        upper = heights >= (c + f) / 2
        told = np.zeros(len(heights), bool)
        if f - c >= _THINNEST_SLAB:
            told = np.minimum(np.abs(heights - c), np.abs(heights - f)) <= min(_FACE, (f - c) / 2)
        seen_above = free_above & ~free_below & ~told
        seen_below = free_below & ~free_above & ~told
        upper[seen_above] = heights[seen_above] >= f - 3 * RASTER
        upper[seen_below] = heights[seen_below] >= f + 2 * RASTER
        upper[heights > f + RASTER] = True
        upper[heights < c - RASTER] = False
        storey[upper] = index
    return storey
