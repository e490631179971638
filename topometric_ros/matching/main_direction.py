"""The main direction of a map's walls: where their projection on a line is sharpest.

Walls pile up on few places of a line that runs across them. The larger a building, the sharper the
piles, so the direction is known best (0.02°) where the search needs it best. A building without a
main direction gets some direction, which does no harm: the search sweeps all yaws in any case.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.matching.search_fields import MapFields

_PILE = 0.2
"""Width of the places that walls pile up on, m."""

Grids = tuple[tuple[float, float], ...]

_GRIDS: Grids = ((45.0, 0.5), (0.5, 0.1), (0.1, 0.02))
"""Half-range and step of the directions that are tried, one grid round the best of the last, °."""


def main_direction(fields: MapFields) -> float:
    """Return the direction of most walls in the level frame, in [0, π/2) rad; 0 without walls."""
    walls = [storey.walls for storey in fields.storeys if len(storey.walls)]
    return sharpest_direction(walls, _GRIDS) if walls else 0.0


def sharpest_direction(walls: list[NDArray[np.float64]], grids: Grids) -> float:
    """Return where the projections of cells (n, 2) each, m, are sharpest, in [0, π/2) rad.

    `grids` are the half-range and step, °, of the directions tried round 45° and then round the
    best so far.
    """
    best = np.pi / 4.0
    for half, step in grids:
        n = round(half / step)
        tried = best + np.radians(step) * np.arange(-n, n + 1)
        best = tried[int(np.argmax([_sharpness(walls, direction) for direction in tried]))]
    return float(best % (np.pi / 2.0))


def _sharpness(walls: list[NDArray[np.float64]], direction: float) -> float:
    """Sum of the squared sizes of the piles along a direction and across it."""
    c, s = np.cos(direction), np.sin(direction)
    total = 0.0
    for cells in walls:
        for axis in ((c, s), (-s, c)):
            pile = np.floor(cells @ np.array(axis) / _PILE).astype(np.int64)
            total += float((np.bincount(pile - pile.min()).astype(np.float64) ** 2).sum())
    return total
