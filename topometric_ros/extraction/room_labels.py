"""From the rooms' floors to the points: walls belong to the room that they are seen from.

Rooms are found on cells of 0.1 m, and a wall between two of them is hardly thicker. So points take
the nearest room on cells of half that size, after every room has grown, up to 0.1 m, into what of
the walls' cells is in truth free: the wall's face stops it.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_PARTS = 2
"""Fine cells along the edge of a cell."""

_GROWTH = 2
_FEWEST = 2
_CROSS = ndimage.generate_binary_structure(2, 1)


def label_points(
    regions: NDArray[np.int32],
    wall: NDArray[np.bool_],
    places: NDArray[np.float64],
    upright: NDArray[np.bool_],
    reach: float,
) -> NDArray[np.int32]:
    """Return the room of every point of a storey.

    Parameters
    ----------
    regions : (nx, ny) int32, rooms numbered from 1, 0 where there is none
    wall : (nx, ny) bool, the cells of walls
    places : (P, 2) float64, cells, positions in the raster; cell (i, j) is centred on (i, j) and
        all lie within it
    upright : (P,) bool, points above the floor and under the ceiling, which walls are made of
    reach : cells; points farther from every room belong to none

    Returns
    -------
    (P,) int32, from 1, 0 none
    """
    fine = np.floor((places + 0.5) * _PARTS).astype(np.int64)
    labels = _twice(regions)
    faces = np.bincount(
        np.ravel_multi_index(tuple(fine[upright].T), labels.shape), minlength=labels.size
    ).reshape(labels.shape)
    blocked = ndimage.binary_closing(faces >= _FEWEST, np.ones((3, 3)))
    labels = _grown(labels, _twice(wall) & ~blocked)
    distance, (x, y) = ndimage.distance_transform_edt(labels == 0, return_indices=True)
    nearest = np.where(distance <= reach * _PARTS, labels[x, y], 0).astype(np.int32)
    found: NDArray[np.int32] = nearest[fine[:, 0], fine[:, 1]]
    return found


def _twice(cells: NDArray) -> NDArray:  # type: ignore[type-arg]
    """Divide every cell into fine ones."""
    return np.repeat(np.repeat(cells, _PARTS, 0), _PARTS, 1)


def _grown(labels: NDArray[np.int32], free: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Let rooms grow into free cells that touch one room only."""
    none = np.iinfo(np.int32).max
    for _ in range(_GROWTH):
        highest = ndimage.maximum_filter(labels, footprint=_CROSS)
        lowest = ndimage.minimum_filter(np.where(labels > 0, labels, none), footprint=_CROSS)
        labels = np.where(free & (labels == 0) & (highest == lowest), highest, labels)
    return labels
