"""Whether a cloud stands on its head, told by doors and furniture.

Doors reach down to the floor and have walls above them, furniture stands on the floor. So below
the ceiling the space falls into rooms, and more of it is free than above the floor.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.extraction.columns import Columns
from topometric_ros.extraction.storeys import RASTER, StoreyHeights

_FURNITURE = (3, 8)
_LINTELS = (3, 5)
"""Cells of 0.1 m away from the floor and from the ceiling in which things are looked for."""

_SPLIT = 0.5
"""The space at the floor counts as split where two cells of it belong together this much less."""

_LESS_FREE = 0.015
"""By how much more of the ceiling than of the floor must have things on it to decide, as a share
of the area: level buildings measured from -0.07 to 0.005, upside down from 0.005 to 0.06."""


def is_upside_down(columns: Columns, storeys: Sequence[StoreyHeights], origin_z: float) -> bool:
    """Return whether the ceilings of a building look like floors, and its floors like ceilings.

    Parameters
    ----------
    columns : columns of 0.1 m voxels
    storeys : those whose ceiling was not seen do not count
    origin_z : m, height of the centres of the voxels with z = 0
    """
    votes = [_differences(columns, s, origin_z) for s in storeys if s.ceiling_seen]
    if not votes:
        return False
    area, low, high, more = (float(sum(v[i] for v in votes)) for i in range(4))
    if low < _SPLIT * high:
        return True
    return low < high / _SPLIT and more > _LESS_FREE * area


def _differences(
    columns: Columns, storey: StoreyHeights, origin_z: float
) -> tuple[float, float, float, float]:
    """Return a storey's cells, how connected they are low and high, and how many more are free low.

    Connected: the probability that two cells belong together, times the number of cells.
    """
    floor = round((storey.floor - origin_z) / RASTER)
    ceiling = round((storey.ceiling - origin_z) / RASTER)
    cells = columns.raster_cells()

    def occupied(low: int, high: int) -> NDArray[np.bool_]:
        mask = np.zeros(columns.shape, bool)
        mask[tuple(cells[(columns.z >= low) & (columns.z <= high)].T)] = True
        return mask

    area = occupied(floor - 1, floor + 1) | occupied(ceiling - 1, ceiling + 1)
    low = area & ~occupied(floor + _FURNITURE[0], floor + _FURNITURE[1])
    high = area & ~occupied(ceiling - _LINTELS[1], ceiling - _LINTELS[0])
    size = float(np.count_nonzero(area))
    more = float(np.count_nonzero(low)) - float(np.count_nonzero(high))
    return size, size * _connected(low), size * _connected(high), more


def _connected(mask: NDArray[np.bool_]) -> float:
    """Return the probability that two cells of a mask hang together."""
    labels, count = ndimage.label(mask)
    if count == 0:
        return 0.0
    shares = np.bincount(labels.ravel())[1:] / np.count_nonzero(mask)
    return float((shares**2).sum())
