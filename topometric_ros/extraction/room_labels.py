"""From the rooms' floors to the points: walls belong to the room that they are seen from.

Rooms are found on cells of 0.1 m, and a wall between two of them is hardly thicker. So points take
the nearest room on cells of half that size, after every room has grown, up to 0.1 m, into what of
the walls' cells is in truth free: the wall's face stops it. What lies behind a wall, as seen
through a door, is of no room on this side.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.extraction.masks import BESIDE, closed, sees

_PARTS = 2
"""Fine cells along the edge of a cell."""

_GROWTH = 2
"""Fine cells by which rooms grow into the walls."""
_FEWEST = 2
"""Upright points of a fine cell that end this growth."""
_NEAR = 6
"""Fine cells up to which a point takes the nearest room whatever is between."""


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
    labels = _twice(regions)
    fine, faces, wanted = _on_fine_cells(places, upright, labels.shape)
    blocked = closed(faces >= _FEWEST, BESIDE)
    solid = _twice(wall)
    labels = _grown(labels, solid & ~blocked)
    nearest = _nearest(labels, wanted, solid, reach * _PARTS)
    found: NDArray[np.int32] = nearest.ravel()[fine]
    return found


def _twice(cells: NDArray) -> NDArray:  # type: ignore[type-arg]
    """Divide every cell into fine ones."""
    return np.repeat(np.repeat(cells, _PARTS, 0), _PARTS, 1)


@njit(cache=True, nogil=True)
def _on_fine_cells(places, upright, shape):  # type: ignore[no-untyped-def]
    """Flat fine cell of each point (P,), upright points in each cell, and which hold any point."""
    fine = np.empty(len(places), np.int64)
    faces = np.zeros(shape, np.int64)
    wanted = np.zeros(shape, np.bool_)
    for k in range(len(places)):
        i = int(np.floor((places[k, 0] + 0.5) * _PARTS))
        j = int(np.floor((places[k, 1] + 0.5) * _PARTS))
        fine[k] = i * shape[1] + j
        faces[i, j] += upright[k]
        wanted[i, j] = True
    return fine, faces, wanted


def _grown(labels: NDArray[np.int32], free: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Let rooms grow into free cells that touch one room only."""
    for _ in range(_GROWTH):
        labels = _grown_once(labels, free)
    return labels


@njit(cache=True, nogil=True)
def _grown_once(labels, free):  # type: ignore[no-untyped-def]
    nx, ny = labels.shape
    result = labels.copy()
    for i in range(nx):
        for j in range(ny):
            if not free[i, j] or labels[i, j] != 0:
                continue
            only, several = 0, False
            for di, dj in ((-1, 0), (1, 0), (0, -1), (0, 1)):
                a, b = i + di, j + dj
                if 0 <= a < nx and 0 <= b < ny and labels[a, b] > 0:
                    several |= only > 0 and only != labels[a, b]
                    only = labels[a, b]
            if only > 0 and not several:
                result[i, j] = only
    return result


@njit(cache=True, nogil=True)
def _nearest(labels, wanted, wall, reach):  # type: ignore[no-untyped-def]
    """Label of the labelled cell nearest to each wanted one; 0 beyond reach.

    From farther than `_NEAR` cells only those count that no wall hides: what was seen through a
    door or a window belongs to no room on this side.
    """
    nx, ny = labels.shape
    left = np.full((nx, ny), -1, np.int32)
    right = np.full((nx, ny), -1, np.int32)
    for i in range(nx):
        last = -1
        for j in range(ny):
            last = j if labels[i, j] > 0 else last
            left[i, j] = last
        last = -1
        for j in range(ny - 1, -1, -1):
            last = j if labels[i, j] > 0 else last
            right[i, j] = last
    space = np.logical_not(wall).ravel()
    result = np.zeros((nx, ny), np.int32)
    farthest = int(np.floor(reach * reach + 1e-9))
    for i in range(nx):
        for j in range(ny):
            if wanted[i, j]:
                row, column = _search(labels, left, right, space, i, j, farthest, False)
                square = (row - i) ** 2 + (column - j) ** 2
                far = row >= 0 and square > _NEAR**2
                if far and not _seen_from(space, ny, i, j, row, column):
                    row, column = _search(labels, left, right, space, i, j, farthest, True)
                if row >= 0:
                    result[i, j] = labels[row, column]
    return result


@njit(cache=True, nogil=True)
def _search(labels, left, right, space, i, j, farthest, in_sight):  # type: ignore[no-untyped-def]
    """The labelled cell nearest to one, ties by the lowest label; (-1, -1): none.

    `left` and `right` are the nearest labelled columns of every row, so only rows are gone
    through, from the cell's own outwards, until none can be nearer.
    """
    best, found, step = farthest, (-1, -1), 0
    while step * step <= best:
        for row in (i - step, i + step):
            if not 0 <= row < labels.shape[0]:
                continue
            for column in (left[row, j], right[row, j]):
                square = step * step + (column - j) * (column - j)
                if column < 0 or square > best:
                    continue
                if square == best and found[0] >= 0 and labels[row, column] >= labels[found]:
                    continue
                if not in_sight or _seen_from(space, labels.shape[1], i, j, row, column):
                    best, found = square, (row, column)
        step += 1
    return found


@njit(cache=True, nogil=True)
def _seen_from(space, width, i, j, row, column):  # type: ignore[no-untyped-def]
    """Whether no wall, other than the one that (i, j) lies in, hides (row, column) from it."""
    return sees(space, width, i * width + j, row * width + column, row - i, column - j)
