"""Outlines of sets of cells: traced round their edges, thinned to corners, moved inwards."""

from __future__ import annotations

from collections import defaultdict

import numpy as np
from numpy.typing import NDArray

from topometric_ros.simulation.labelled import signed_area

_AROUND = ((0, -1, 0, 0, 1, 0), (1, 0, 1, 0, 1, 1), (0, 1, 1, 1, 0, 1), (-1, 0, 0, 1, 0, 0))
"""Neighbour (x, y) of a cell, then the first and the last corner of the edge towards it (x, y);
the edges run counter-clockwise, the cell on their left."""


def trace_outlines(cells: NDArray[np.bool_]) -> list[NDArray[np.float64]]:
    """Return the rings round a set of cells, the largest first, in cell corners.

    Outer rings run counter-clockwise, holes clockwise; cells that touch only at a corner are apart.

    Parameters
    ----------
    cells : (X, Y) bool; cell (x, y) covers [x, x + 1] by [y, y + 1]

    Returns
    -------
    list of (K, 2) float64: corners only, no point on a straight line
    """
    padded = np.pad(cells, 1)
    starts: dict[tuple[int, int], list[tuple[int, int]]] = defaultdict(list)
    for dx, dy, x0, y0, x1, y1 in _AROUND:
        outside = ~np.roll(padded, (-dx, -dy), axis=(0, 1))
        for x, y in np.argwhere(padded & outside) - 1:
            starts[int(x) + x0, int(y) + y0].append((int(x) + x1, int(y) + y1))
    rings = []
    while starts:
        rings.append(_follow(starts, min(starts)))
    return sorted(rings, key=lambda ring: (-abs(signed_area(ring)), *ring[0]))


def simplify(ring: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """Return a ring (K, 2) without the corners nearer than `tolerance` to its new edges.

    Douglas & Peucker 1973, on the two halves of the ring.
    """
    if len(ring) < 5:
        return ring
    far = int(np.argmax(((ring - ring[0]) ** 2).sum(axis=1)))
    first = _thin(ring[: far + 1], tolerance)
    second = _thin(np.concatenate([ring[far:], ring[:1]]), tolerance)
    thinned = np.concatenate([first[:-1], second[:-1]])
    return thinned if len(thinned) >= 3 else ring


def inset(ring: NDArray[np.float64], distance: float) -> NDArray[np.float64]:
    """Return a ring (K, 2) of axis-parallel edges moved to its left by `distance`."""
    edges = np.roll(ring, -1, axis=0) - ring
    directions = edges / np.abs(edges).sum(axis=1, keepdims=True)
    left = np.stack([-directions[:, 1], directions[:, 0]], axis=1)
    return ring + distance * (left + np.roll(left, 1, axis=0))


def _follow(
    starts: dict[tuple[int, int], list[tuple[int, int]]], start: tuple[int, int]
) -> NDArray[np.float64]:
    """Take one closed ring out of the edges; at a corner with two ways, turn left."""
    ring = [start]
    at, before = start, None
    while at != start or len(ring) == 1:
        ways = starts[at]
        way = ways[0]
        if before is not None and len(ways) > 1:
            heading = (at[0] - before[0], at[1] - before[1])
            way = max(ways, key=lambda w: heading[0] * (w[1] - at[1]) - heading[1] * (w[0] - at[0]))
        ways.remove(way)
        if not ways:
            del starts[at]
        before, at = at, way
        ring.append(at)
    points = np.array(ring[:-1], dtype=np.float64)
    turns = np.roll(points, -1, axis=0) - 2 * points + np.roll(points, 1, axis=0)
    return points[np.any(turns != 0, axis=1)]


def _thin(line: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """Thin an open line, its two ends kept."""
    kept = np.zeros(len(line), dtype=bool)
    kept[[0, -1]] = True
    stretches = [(0, len(line) - 1)]
    while stretches:
        start, end = stretches.pop()
        if end - start < 2:
            continue
        chord = line[end] - line[start]
        offset = line[start + 1 : end] - line[start]
        length = max(float(np.hypot(*chord)), 1e-12)
        distance = np.abs(chord[0] * offset[:, 1] - chord[1] * offset[:, 0]) / length
        farthest = int(np.argmax(distance))
        if distance[farthest] > tolerance:
            middle = start + 1 + farthest
            kept[middle] = True
            stretches += [(start, middle), (middle, end)]
    return line[kept]
