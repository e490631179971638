"""What tells a doorway from a bend: features of every two pieces of floor that touch.

At the narrowest place between two pieces, the saddle, the walls on both sides are examined, and
how much of each piece sees the other is counted: the thesis' mutual visibility (§4.2.8), used to
merge pieces instead of to cluster views.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.extraction.masks import depth, nearest_unset, sees
from topometric_ros.extraction.walls import StoreyRaster

_CORNER_RADIUS = 4.5
"""Cells round the end of a wall in which free space is counted."""
_LINE_CELLS = 8
"""How far beyond its end a wall is followed, cells."""
_LINE_MISSES = 2
"""Cells without wall beside them that end it."""
_OPPOSITE_COSINE = float(np.cos(np.radians(50.0)))


@dataclass(frozen=True)
class PairFeatures:
    """Touching pieces; pieces are numbered from 0, row k of every array is one pair a < b.

    `saddle` is the distance from the walls at the widest point of their common border (cells),
    `corner` the larger wall-free share round the two wall ends there, `line` how far the walls go
    on beyond them, 0 to 1. `seen` and `pairs` (K, K) int64 count, for all pieces, the sample pairs
    within range and those that see each other; `peak` (K,) is the largest distance of each piece.
    """

    a: NDArray[np.int64]
    b: NDArray[np.int64]
    saddle: NDArray[np.float64]
    corner: NDArray[np.float64]
    line: NDArray[np.float64]
    peak: NDArray[np.float64]
    pairs: NDArray[np.int64]
    seen: NDArray[np.int64]


def pair_features(
    raster: StoreyRaster,
    pieces: NDArray[np.int32],
    sample_step: int,
    view_range: float,
    reach: float = 5.0,
) -> PairFeatures:
    """Measure every two touching pieces.

    Parameters
    ----------
    raster : the storey
    pieces : (nx, ny) int32, pieces numbered from 1, 0 none
    sample_step, view_range : cells between the points that look, and how far they look
    reach : cells by which pieces are extended before they are tested for touching
    """
    count = int(pieces.max())
    peak = raster.clearance.ravel()[_peaks(raster.clearance, pieces, count)]
    pair, saddle, cells = _saddles(extended(pieces, reach), raster.clearance)
    corner, line = _openings(raster.wall, cells)
    points, owner = _samples(raster.distance, pieces, sample_step)
    space, _ = ndimage.label(~raster.wall, np.ones((3, 3)))
    counts = np.zeros((2, count, count), np.int64)
    pairs, seen = _visibility(space, points, owner, view_range**2, counts)
    return PairFeatures(pair[:, 0], pair[:, 1], saddle, corner, line, peak, pairs, seen)


def extended(labels: NDArray[np.int32], reach: float) -> NDArray[np.int32]:
    """Give cells without a label (0) that of the nearest labelled cell within `reach` cells."""
    if not labels.any():
        return labels.copy()
    free = labels == 0
    near = np.argwhere(free & (depth(free) <= reach))
    result = labels.copy()
    result[tuple(near.T)] = labels[tuple(nearest_unset(free, near).T)]
    return result


def _saddles(
    labels: NDArray[np.int32], distance: NDArray[np.float64]
) -> tuple[NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    """Return pairs (P, 2), numbered from 0, the widths of their saddles (P,) and cells (P, 2)."""
    parts = []
    x, y = np.meshgrid(*(np.arange(n) for n in labels.shape), indexing="ij")
    for near, far in (
        ((slice(None, -1), slice(None)), (slice(1, None), slice(None))),
        ((slice(None), slice(None, -1)), (slice(None), slice(1, None))),
    ):
        one, other = labels[near], labels[far]
        narrow = np.minimum(distance[near], distance[far])
        touch = (one != other) & (one > 0) & (other > 0) & (narrow > 0)
        at_near = distance[near] <= distance[far]
        parts.append(
            np.stack(
                [
                    np.minimum(one, other)[touch] - 1,
                    np.maximum(one, other)[touch] - 1,
                    narrow[touch],
                    np.where(at_near, x[near], x[far])[touch],
                    np.where(at_near, y[near], y[far])[touch],
                ],
                -1,
            )
        )
    rows = np.concatenate(parts)
    rows = rows[np.lexsort((rows[:, 4], rows[:, 3], -rows[:, 2], rows[:, 1], rows[:, 0]))]
    first = np.ones(len(rows), bool)
    first[1:] = np.any(np.diff(rows[:, :2], axis=0) != 0, axis=1)
    rows = rows[first]
    return rows[:, :2].astype(np.int64), rows[:, 2], rows[:, 3:].astype(np.int64)


def _openings(
    wall: NDArray[np.bool_], cells: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return how wall-free the ends of each opening are and how far the walls go on beyond."""
    if not wall.any():
        return np.full(len(cells), 0.5), np.zeros(len(cells))
    corner, line = np.empty(len(cells)), np.empty(len(cells))
    for row, ((i, j), (x, y)) in enumerate(zip(cells, nearest_unset(~wall, cells), strict=True)):
        corner[row], line[row] = _opening(wall, i, j, x, y)
    return corner, line


@njit(cache=True, nogil=True)
def _opening(wall, i, j, x, y):  # type: ignore[no-untyped-def]
    """Examine the opening at saddle (i, j) whose nearest wall cell is (x, y)."""
    ux, uy = float(i - x), float(j - y)
    length = np.sqrt(ux * ux + uy * uy)
    limit = 2.2 * length + 1.0
    best, best_x, best_y = limit * limit + 1e-9, -1, -1
    reach = int(limit)
    for a in range(max(0, i - reach), min(wall.shape[0], i + reach + 1)):
        for b in range(max(0, j - reach), min(wall.shape[1], j + reach + 1)):
            if not wall[a, b]:
                continue
            vx, vy = float(a - i), float(b - j)
            square = vx * vx + vy * vy
            along = vx * ux + vy * uy
            if square < best and along >= _OPPOSITE_COSINE * length * np.sqrt(square):
                best, best_x, best_y = square, a, b
    corner = _free_share(wall, x, y)
    if best_x < 0:
        return max(corner, 0.5), 0.0
    corner = max(corner, _free_share(wall, best_x, best_y))
    line = max(_continuation(wall, best_x, best_y, x, y), _continuation(wall, x, y, best_x, best_y))
    return corner, line


@njit(cache=True, nogil=True)
def _free_share(wall, x, y):  # type: ignore[no-untyped-def]
    """Share of a 0.45 m disk that is no wall."""
    reach = int(_CORNER_RADIUS)
    cells, free = 0, 0
    for di in range(-reach, reach + 1):
        for dj in range(-reach, reach + 1):
            if di * di + dj * dj > _CORNER_RADIUS * _CORNER_RADIUS:
                continue
            cells += 1
            a, b = x + di, y + dj
            inside = 0 <= a < wall.shape[0] and 0 <= b < wall.shape[1]
            if not (inside and wall[a, b]):
                free += 1
    return free / cells


@njit(cache=True, nogil=True)
def _continuation(wall, from_x, from_y, x, y):  # type: ignore[no-untyped-def]
    """Share of the cells beyond (x, y), seen from the other end, that have wall around them."""
    dx, dy = float(x - from_x), float(y - from_y)
    length = np.sqrt(dx * dx + dy * dy)
    if length == 0.0:
        return 0.0
    hits, misses = 0, 0
    for step in range(1, _LINE_CELLS + 1):
        a = int(np.floor(x + dx / length * step + 0.5))
        b = int(np.floor(y + dy / length * step + 0.5))
        hit = False
        for i in range(max(0, a - 1), min(wall.shape[0], a + 2)):
            for j in range(max(0, b - 1), min(wall.shape[1], b + 2)):
                hit = hit or wall[i, j]
        if hit:
            hits += 1
        else:
            misses += 1
            if misses == _LINE_MISSES:
                break
    return hits / _LINE_CELLS


def _samples(
    distance: NDArray[np.float64], pieces: NDArray[np.int32], step: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the points that look, (S, 2) cells, and their pieces (S,): a lattice and the peaks."""
    chosen = np.zeros(pieces.shape, bool)
    chosen[::step, ::step] = distance[::step, ::step] >= 1.5
    chosen.ravel()[_peaks(distance, pieces, int(pieces.max()))] = True
    chosen &= pieces > 0
    points = np.argwhere(chosen)
    return points, pieces[chosen].astype(np.int64) - 1


@njit(cache=True, nogil=True)
def _peaks(values, pieces, count):  # type: ignore[no-untyped-def]
    """Flat cell of the largest value of each piece, ties by the highest (x, y): (count,) int64."""
    peaks = np.zeros(count, np.int64)
    highest = np.full(count, -np.inf)
    flat = values.ravel()
    for cell, piece in enumerate(pieces.ravel()):
        if piece > 0 and flat[cell] >= highest[piece - 1]:
            highest[piece - 1] = flat[cell]
            peaks[piece - 1] = cell
    return peaks


@njit(cache=True, nogil=True)
def _visibility(space, points, owner, square_range, counts):  # type: ignore[no-untyped-def]
    """Count the pairs of points within range, and those that see each other, for every two pieces.

    `space` (nx, ny) numbers what walls part, 0 for the walls themselves: no view leads from one
    part to another. `points` (S, 2) are sorted by x. `counts` is (2, K, K), zero: pairs and seeing
    pairs, symmetric.
    """
    flat, width = space.ravel(), space.shape[1]
    places = points[:, 0] * width + points[:, 1]
    first = 0
    for one in range(len(points)):
        while (points[one, 0] - points[first, 0]) ** 2 > square_range:  # sorted by x
            first += 1
        for other in range(first, one):
            dx = points[one, 0] - points[other, 0]
            dy = points[one, 1] - points[other, 1]
            if dx * dx + dy * dy > square_range:
                continue
            a, b = owner[one], owner[other]
            start, end = places[other], places[one]
            in_view = flat[start] == flat[end] and sees(flat, width, start, end, dx, dy)
            counts[0, a, b] += 1
            counts[1, a, b] += in_view
            if a != b:
                counts[0, b, a] += 1
                counts[1, b, a] += in_view
    return counts[0], counts[1]
