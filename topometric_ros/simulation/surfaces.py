"""What an agent would see of a part of a building, sampled from its surfaces without casting rays.

Stands in for `simulate` where a building is large: a point costs no ray, and no walk need be
planned. There are no shadows, the only noise is across the surface, and all rooms are seen whole.
Clouds made so say what a size costs, not how well anything works on real scans.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.simulation.building import BuildingError
from topometric_ros.simulation.labelled import LabelledBuilding, TrueRoom

_SPACING = 0.05
"""Points of one surface lie about this far apart, m."""
_CELL = 0.05
"""Cell of the raster that says which room is where, m."""
_AHEAD = 0.07
"""A surface belongs to the room that lies this far in front of it, m."""
_BEYOND = 0.01
"""How far a point may lie outside its room's range of heights, m."""
_STEPS = np.array([0.7548776662466927, 0.5698402909980532])
"""Multiples of these, modulo 1, fill a square evenly (the R2 sequence, Roberts 2018)."""


def sampled_surfaces(
    building: LabelledBuilding,
    stretch: tuple[float, float],
    rng: np.random.Generator,
    noise: float = 0.01,
) -> NDArray[np.float64]:
    """Return points on the inside of the rooms in a stretch along x: (N, 3) float64, m.

    Parameters
    ----------
    building : of triangles whose corners run counter-clockwise seen from where it is not solid
    stretch : lowest and highest x, m, building frame, which the points are in too
    rng : shifts the pattern of points and draws the noise, so that no two agents' points agree
    noise : standard deviation across the surface, m

    Raises
    ------
    BuildingError
        The building is a cloud.
    """
    if building.is_cloud:
        raise BuildingError(f"{building.name}: a cloud has no surfaces to sample")
    triangles = building.vertices[building.faces]
    x = triangles[:, :, 0]
    triangles = triangles[(x.max(axis=1) >= stretch[0]) & (x.min(axis=1) <= stretch[1])]
    points, normals = _on_triangles(triangles, rng)
    inside = (points[:, 0] >= stretch[0]) & (points[:, 0] <= stretch[1])
    points, normals = points[inside], normals[inside]
    seen = np.zeros(len(points), dtype=bool)
    for storey in sorted({room.storey for room in building.rooms}):
        rooms = [room for room in building.rooms if room.storey == storey]
        seen |= _seen_from(rooms, points, normals)
    points, normals = points[seen], normals[seen]
    return points + rng.normal(0.0, noise, (len(points), 1)) * normals


def _on_triangles(
    triangles: NDArray[np.float64], rng: np.random.Generator
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return points (N, 3) evenly over triangles (F, 3, 3) and their unit normals (N, 3)."""
    a, b, c = triangles[:, 0], triangles[:, 1], triangles[:, 2]
    normal = np.cross(b - a, c - a)
    twice = np.linalg.norm(normal, axis=1)
    counts = np.floor(twice / 2 / _SPACING**2 + rng.random(len(twice))).astype(np.int64)
    face = np.repeat(np.arange(len(twice)), counts)
    along = (rng.random(2) + np.arange(len(face))[:, None] * _STEPS) % 1.0
    beyond = along.sum(axis=1) > 1.0
    along[beyond] = 1.0 - along[beyond]
    u, v = along[:, :1], along[:, 1:]
    points = a[face] + u * (b - a)[face] + v * (c - a)[face]
    return points, normal[face] / twice[face, None]


def _seen_from(
    rooms: list[TrueRoom], points: NDArray[np.float64], normals: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return which points (N, 3) face one of the rooms of a storey, with unit normals (N, 3)."""
    corners = np.concatenate([room.polygon for room in rooms])
    low = corners.min(axis=0)
    raster = np.full(tuple(np.ceil(np.ptp(corners, axis=0) / _CELL).astype(int) + 1), -1)
    for index, room in enumerate(rooms):
        _paint(raster, low, room.polygon, index)
    ahead = points + _AHEAD * normals
    cells = np.floor((ahead[:, :2] - low) / _CELL).astype(np.int64)
    within = ((cells >= 0) & (cells < raster.shape)).all(axis=1)
    room_of = np.full(len(points), -1)
    room_of[within] = raster[tuple(cells[within].T)]
    heights = np.array([(room.z_low, room.z_high) for room in rooms])[room_of]
    z = points[:, 2]
    level = (z >= heights[:, 0] - _BEYOND) & (z <= heights[:, 1] + _BEYOND)
    facing = (ahead[:, 2] > heights[:, 0]) & (ahead[:, 2] < heights[:, 1])
    seen: NDArray[np.bool_] = (room_of >= 0) & level & facing
    return seen


def _paint(
    raster: NDArray[np.int64], low: NDArray[np.float64], polygon: NDArray[np.float64], index: int
) -> None:
    """Write an index into the cells whose middles a polygon (K, 2) contains (even-odd rule)."""
    first = np.floor((polygon.min(axis=0) - low) / _CELL).astype(int)
    last = np.ceil((polygon.max(axis=0) - low) / _CELL).astype(int)
    x, y = (low[k] + (np.arange(first[k], last[k]) + 0.5) * _CELL for k in (0, 1))
    inside = np.zeros((len(x), len(y)), dtype=bool)
    for (x0, y0), (x1, y1) in zip(np.roll(polygon, 1, axis=0), polygon, strict=True):
        crossed = (y0 > y) != (y1 > y)
        at = np.full(len(y), -np.inf)
        if y0 != y1:
            at[crossed] = x0 + (y[crossed] - y0) * (x1 - x0) / (y1 - y0)
        inside ^= x[:, None] < at[None, :]
    raster[first[0] : last[0], first[1] : last[1]][inside] = index
