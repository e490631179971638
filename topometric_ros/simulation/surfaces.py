"""What an agent would see of a part of a building, sampled from its surfaces without casting rays.

Stands in for `simulate` where a building is large: a point costs no ray, and no walk need be
planned. There are no shadows, the only noise is across the surface, and all rooms are seen whole,
with the openings of the links between them.
Clouds made so say what a size costs, not how well anything works on real scans.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.simulation.building import BuildingError
from topometric_ros.simulation.labelled import LabelledBuilding, TrueLink
from topometric_ros.simulation.world import World, make_world

_SPACING = 0.05
"""Points of one surface lie about this far apart, m."""
_CELL = 0.05
"""Cell of the raster that says which room is where, m."""
_AHEAD = 0.07
"""A surface belongs to the room or opening that lies this far in front of it, m."""
_BEYOND = 0.01
"""How far a point may lie outside the range of heights of its room or opening, m."""
_HALF_WALL = 0.5
"""How far an opening reaches from its middle to the rooms on both sides, at most, m."""
_LOOK_UP = 1.0
"""Height above the floor from which an opening's upper end is looked for, m."""
_STEPS = np.array([0.7548776662466927, 0.5698402909980532])
"""Multiples of these, modulo 1, fill a square evenly (the R2 sequence, Roberts 2018)."""

_Place = tuple[NDArray[np.float64], float, float]
"""Outline (K, 2), lowest and highest z of a room or an opening, m."""


def sampled_surfaces(
    building: LabelledBuilding,
    stretch: tuple[float, float],
    rng: np.random.Generator,
    noise: float = 0.01,
) -> NDArray[np.float64]:
    """Return points inside the rooms and doorways of a stretch along x: (N, 3) float64, m.

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
    openings = _openings(building)
    for storey in sorted({room.storey for room in building.rooms}):
        rooms = [(r.polygon, r.z_low, r.z_high) for r in building.rooms if r.storey == storey]
        seen |= _seen_from(rooms, openings.get(storey, []), points, normals)
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


def _openings(building: LabelledBuilding) -> dict[int, list[_Place]]:
    """Return what joins the rooms of each storey, up to the lintels; stairs are rooms."""
    links = [link for link in building.links if link.kind != "stair"]
    found: dict[int, list[_Place]] = {}
    if not links:
        return found
    for link, top in zip(links, _tops(links, make_world(building)), strict=True):
        room = building.rooms[link.rooms[0]]
        low, high = float(link.position[2]), room.z_high if np.isnan(top) else float(top)
        found.setdefault(room.storey, []).append((_outline(building, link), low, high))
    return found


def _tops(links: list[TrueLink], world: World) -> NDArray[np.float64]:
    """Return the height of what is above each link: (L,), m, NaN nothing."""
    from_floor = np.array([link.position for link in links]) + [0.0, 0.0, _LOOK_UP]
    up = np.broadcast_to([0.0, 0.0, 1.0], from_floor.shape)
    return world.cast(from_floor, up, 100.0)[:, 2]


def _outline(building: LabelledBuilding, link: TrueLink) -> NDArray[np.float64]:
    """Return the rectangle (4, 2), m, of a link: its width along the wall, from room to room."""
    place, depth = link.position[:2], 0.0
    along = np.zeros(2)
    for room in link.rooms:
        start = building.rooms[room].polygon
        edge = np.roll(start, -1, axis=0) - start
        length = np.maximum(np.linalg.norm(edge, axis=1), 1e-9)
        share = np.clip(np.sum((place - start) * edge, axis=1) / length**2, 0.0, 1.0)
        away = np.linalg.norm(start + share[:, None] * edge - place, axis=1)
        nearest = int(np.argmin(away))
        depth, along = max(depth, float(away[nearest])), edge[nearest] / length[nearest]
    half = along * link.width / 2
    across = np.array([-along[1], along[0]]) * min(depth + _CELL, _HALF_WALL)
    return np.array(
        [place - half - across, place + half - across, place + half + across, place - half + across]
    )


def _seen_from(
    rooms: list[_Place],
    openings: list[_Place],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
) -> NDArray[np.bool_]:
    """Return which points (N, 3) of a storey face a room or an opening, with unit normals (N, 3).

    What lies in a room is not in the opening that reaches into it.
    """
    places = openings + rooms
    corners = np.concatenate([polygon for polygon, *_ in places])
    low = corners.min(axis=0)
    raster = np.full(tuple(np.ceil(np.ptp(corners, axis=0) / _CELL).astype(int) + 1), -1)
    for index, (polygon, *_) in enumerate(places):
        _paint(raster, low, polygon, index)
    ahead = points + _AHEAD * normals
    cells = np.floor((ahead[:, :2] - low) / _CELL).astype(np.int64)
    within = ((cells >= 0) & (cells < raster.shape)).all(axis=1)
    place_of = np.full(len(points), -1)
    place_of[within] = raster[tuple(cells[within].T)]
    heights = np.array([(z_low, z_high) for _, z_low, z_high in places])[place_of]
    z = points[:, 2]
    level = (z >= heights[:, 0] - _BEYOND) & (z <= heights[:, 1] + _BEYOND)
    facing = (ahead[:, 2] > heights[:, 0]) & (ahead[:, 2] < heights[:, 1])
    seen: NDArray[np.bool_] = (place_of >= 0) & level & facing
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
