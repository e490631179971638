"""Where a floor and the ceiling below it lie in a slab, finer than a voxel.

Storeys are found in layers of 0.1 m (`storeys.py`); a slab is hardly thicker, and a layer in the
wrong storey is a twentieth of its rooms. So both faces of every slab are looked for again in the
mean heights of the points: a floor among the voxels with free space above, a ceiling among those
with free space below. Voxels that look both ways, as where one face of the slab was not seen,
tell nothing and are left out.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.columns import NOTHING, Columns

FREE = 10
"""Cells above or below a voxel that are free space beside a slab and no gap within it."""

SLAB = 5
"""Cells from one face of a slab to the other, at most."""

_SEARCH = 0.3
"""How far from its layer a face is looked for, m."""

_STEP = 0.02
"""Bins of heights, m."""
_SHARE = 0.3
"""Share of the fullest two bins that the outermost face must have."""
_FEWEST = 100
"""Voxels that tell a height."""
_KNOWN_SHARE = 0.2
"""Share of a layer's voxels of which it must be known which side is free."""


def floor_height(columns: Columns, heights: NDArray[np.float64], level: float) -> float | None:
    """Return the height of the floor near `level` (m), the upper face of its slab.

    Parameters
    ----------
    columns : columns of 0.1 m voxels
    heights : (N,) float64, m, mean height of the points seen in each voxel

    Returns
    -------
    m, or None where fewer than 100 voxels (1 m²) tell
    """
    facing = columns.above > FREE
    sure = columns.below <= SLAB
    alone = columns.below == NOTHING
    known = sure | (alone & (columns.above < NOTHING))
    found = _outermost(heights[facing & known] - level, heights[facing & (sure | alone)] - level)
    return None if found is None else level + found


def ceiling_height(
    columns: Columns, heights: NDArray[np.float64], level: float, following: float | None
) -> float | None:
    """Return the height of the ceiling near `level` (m), the lower face of its slab.

    Parameters
    ----------
    columns, heights : as for `floor_height`
    following : height of the next floor, m, which the ceiling lies under; None for the last one
    """
    facing = columns.below > FREE
    sure = columns.above <= SLAB
    alone = columns.above == NOTHING
    known = sure | (alone & (columns.below < NOTHING))
    if following is not None:
        facing &= heights < following - 0.05
    beside = known if following is not None else sure | alone
    found = _outermost(level - heights[facing & known], level - heights[facing & beside])
    return None if found is None else level - found


def _outermost(known: NDArray[np.float64], all_: NDArray[np.float64]) -> float | None:
    """Return the highest offset (m) that holds a fair share of what the fullest holds.

    Known faces decide, unless they are few beside all that may be one.
    """
    near, all_near = (offsets[np.abs(offsets) < _SEARCH] for offsets in (known, all_))
    if len(near) < _KNOWN_SHARE * len(all_near):
        near = all_near
    if len(near) < _FEWEST:
        return None
    bins = np.floor((near + _SEARCH) / _STEP).astype(np.int64)
    counts = np.bincount(bins)
    # Noise may put a face on the border of two bins; a window of two keeps its peak whole.
    pairs = counts + np.append(counts[1:], 0)
    top = int(np.flatnonzero(pairs >= _SHARE * pairs.max())[-1])
    return float(np.median(near[np.abs(near + _SEARCH - (top + 1) * _STEP) <= 2 * _STEP]))
