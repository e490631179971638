"""Rooms and links proposed from labelled points: outlines of what each room covers, and rooms
whose floors meet. Walls keep the floors of two rooms apart; only an opening lets them meet.
"""

from __future__ import annotations

import itertools

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from topometric_ros.simulation.labelled import TrueLink, TrueRoom, join_rings
from topometric_ros.simulation.outlines import simplify, trace_outlines
from topometric_ros.simulation.room_kinds import kind_of_name

CELL = 0.1
"""Edge of the cells that floors are compared in, m."""
_STOREY = 1.5
"""Floors that differ by more belong to different storeys, m."""
_FLOOR = 0.15
"""How far above a room's floor its points still belong to it, m."""
_GAP = 0.1
"""Floors nearer than this meet, m: a closed door is thinner, nearly all walls are thicker."""
_NARROWEST, _WIDEST_DOOR = 0.5, 1.6


def rooms_and_links(
    points: NDArray[np.float64], labels: NDArray[np.int64], names: list[str]
) -> tuple[tuple[TrueRoom, ...], tuple[TrueLink, ...]]:
    """Return the rooms that labelled points cover, and a link where two rooms' floors meet.

    Parameters
    ----------
    points : (N, 3), m, building frame
    labels : (N,) index of the room in `names`, -1 none
    """
    origin = np.floor(points[:, :2].min(axis=0) / CELL) - 3
    clouds = [points[labels == k] for k in range(len(names))]
    heights = [np.percentile(cloud[:, 2], (1, 99)) if len(cloud) else (0, 0) for cloud in clouds]
    storeys = _storeys([float(low) for low, _ in heights])
    rooms = []
    for k, (cloud, (low, high)) in enumerate(zip(clouds, heights, strict=True)):
        polygon = _outline(cloud, origin)
        kind = kind_of_name(names[k])
        rooms.append(TrueRoom(k, names[k], kind, storeys[k], polygon, float(low), float(high)))
    floors = [
        cloud[cloud[:, 2] < low + _FLOOR] for cloud, (low, _) in zip(clouds, heights, strict=True)
    ]
    links = []
    for a, b in itertools.combinations(range(len(names)), 2):
        if storeys[a] == storeys[b]:
            links += _meetings(rooms[a], rooms[b], floors[a], floors[b], origin)
    return tuple(rooms), tuple(links)


def _storeys(floors: list[float]) -> list[int]:
    """Number the storeys from the lowest: a new one begins where the floors leave a gap."""
    order = np.argsort(floors, kind="stable")
    gaps = np.diff(np.array(floors)[order], prepend=floors[int(order[0])]) > _STOREY
    storeys = np.zeros(len(floors), dtype=int)
    storeys[order] = np.cumsum(gaps)
    return [int(storey) for storey in storeys]


def _cells(points: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return the cells with points in them: (C, 2)."""
    cells = np.floor(points[:, :2] / CELL).astype(np.int64) - origin.astype(np.int64)
    return np.unique(cells, axis=0)


def _outline(points: NDArray[np.float64], origin: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the outline of a room's points seen from above, small gaps closed: (K, 2), m."""
    if not len(points):
        return np.zeros((3, 2))
    cells = _cells(points, origin)
    corner = cells.min(axis=0) - 3
    mask = np.zeros(np.ptp(cells, axis=0) + 7, dtype=bool)
    mask[tuple((cells - corner).T)] = True
    mask = ndimage.binary_fill_holes(ndimage.binary_closing(mask, iterations=2)) | mask
    rings = [simplify(ring, 0.75) for ring in trace_outlines(mask)]
    return CELL * (join_rings(rings) + corner + origin)


def _meetings(
    a: TrueRoom,
    b: TrueRoom,
    floor_a: NDArray[np.float64],
    floor_b: NDArray[np.float64],
    origin: NDArray[np.float64],
) -> list[TrueLink]:
    """Return a link for each stretch along which two floors, points (N, 3), come near."""
    floor_a, floor_b = _near_bounds(floor_a, floor_b), _near_bounds(floor_b, floor_a)
    if not len(floor_a) or not len(floor_b):
        return []
    gaps = cKDTree(floor_a).query(floor_b, distance_upper_bound=_GAP)[0]
    cells = _cells(floor_b[np.isfinite(gaps)], origin)
    if not len(cells):
        return []
    corner = cells.min(axis=0)
    mask = np.zeros(np.ptp(cells, axis=0) + 1, dtype=bool)
    mask[tuple((cells - corner).T)] = True
    # A missing cell does not part a stretch.
    joined = ndimage.binary_dilation(np.pad(mask, 1), np.ones((3, 3)))
    stretches, count = ndimage.label(joined, np.ones((3, 3)))
    links = []
    for k in range(1, count + 1):
        found = np.argwhere((stretches[1:-1, 1:-1] == k) & mask)
        width = CELL * float(np.ptp(found, axis=0).max() + 1)
        if width < _NARROWEST:
            continue
        middle = found[np.argmin(((found - found.mean(axis=0)) ** 2).sum(axis=1))]
        x, y = CELL * (middle + corner + origin + 0.5)
        kind = "door" if width <= _WIDEST_DOOR else "virtual"
        place = np.array([x, y, (a.z_low + b.z_low) / 2])
        links.append(TrueLink((a.id, b.id), kind, place, width))
    return links


def _near_bounds(points: NDArray[np.float64], others: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the points (n, 3) near the smallest upright box round others (m, 3)."""
    if not len(others):
        return others
    low, high = others[:, :2].min(axis=0) - _GAP, others[:, :2].max(axis=0) + _GAP
    return points[((points[:, :2] >= low) & (points[:, :2] <= high)).all(axis=1)]
