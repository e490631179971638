"""A building with the truth about it: what is solid, which rooms it has and how they are joined.

Every building that agents are simulated in, made or loaded, is a `LabelledBuilding`. It is either
a triangle mesh (`vertices`, `faces`) or a cloud whose points carry their room (`points`, `labels`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.simulation.building import BuildingError

STRUCTURE = 0
"""The face tag of what never moves: walls, floors, ceilings, stairs."""

_STEP = 0.05
"""How far a point moves towards the scanner at a time until a room contains it, m."""
_REACH = 0.4
"""How far it moves in all: a thick wall's depth. Also how far a room's polygon reaches without
a direction, and its floor and ceiling reach up and down, m."""
LINK_KINDS = ("door", "opening", "virtual", "stair")


@dataclass(frozen=True)
class TrueRoom:
    """A room as it was built. `storey` counts from 0, the lowest; heights in m, building frame."""

    id: int
    name: str
    kind: str
    storey: int
    polygon: NDArray[np.float64]
    """(K, 2), m; the last point joins the first. Holes and further parts are joined to the first
    ring by edges that run there and back (`join_rings`), so the even-odd rule sees them."""
    z_low: float
    z_high: float


@dataclass(frozen=True)
class TrueLink:
    """A way between two rooms: "door", "opening" (no leaf), "virtual" (no wall) or "stair"."""

    rooms: tuple[int, int]
    kind: str
    position: NDArray[np.float64]
    """(3,), m: the middle of the opening, on the floor."""
    width: float


@dataclass(frozen=True)
class Trajectory:
    """A walk by hand from a sidecar file: rooms to visit or, where given, waypoints.

    `waypoints` are (W, 3) float64, m, building frame, on the floor, z NaN: on the lowest floor
    there; empty where `rooms` count.
    """

    agent: str
    rooms: tuple[int, ...]
    waypoints: NDArray[np.float64]


@dataclass(frozen=True)
class LabelledBuilding:
    """A building, its rooms and the ways between them; metres, z up, every room's id its index."""

    name: str
    vertices: NDArray[np.float64]
    """(V, 3); empty where the building is a cloud."""
    faces: NDArray[np.int32]
    """(F, 3); empty where the building is a cloud."""
    rooms: tuple[TrueRoom, ...]
    links: tuple[TrueLink, ...]
    face_tag: NDArray[np.int32] | None = None
    """(F,): `STRUCTURE`, or k >= 1 for the k-th thing that could be moved (furniture)."""
    points: NDArray[np.float64] | None = None
    """(P, 3): the cloud, where the building is one."""
    labels: NDArray[np.int32] | None = None
    """(P,): the room of each point of the cloud, -1 none."""
    trajectories: tuple[Trajectory, ...] = ()

    def __post_init__(self) -> None:
        if any(room.id != i for i, room in enumerate(self.rooms)):
            raise BuildingError(f"{self.name}: the rooms' ids are not 0 to {len(self.rooms) - 1}")
        for link in self.links:
            if link.kind not in LINK_KINDS or not all(0 <= r < len(self.rooms) for r in link.rooms):
                raise BuildingError(f"{self.name}: no such link: {link.kind} of {link.rooms}")
        if (self.points is None) != (self.labels is None):
            raise BuildingError(f"{self.name}: points and labels come together")

    @property
    def is_cloud(self) -> bool:
        """True where the building is a labelled cloud and has no faces."""
        return self.points is not None

    def room_of(
        self, points: NDArray[np.float64], towards: NDArray[np.float64] | None = None
    ) -> NDArray[np.int32]:
        """Return the room that each point belongs to: (N,) int32, -1 none.

        A surface between two rooms belongs to the one it was seen from: the point moves towards
        the scanner until a room contains it, 0.4 m at most. So a slab's upper face belongs to the
        room above and its lower face to the room below, or to none where that room is modelled as
        ending farther below it (a suspended ceiling that the model leaves out).

        Parameters
        ----------
        points : (N, 3), m, building frame
        towards : (N, 3) unit vectors to the scanner, or None: the nearest room within 0.4 m
        """
        points = np.ascontiguousarray(points, dtype=np.float64)
        if self.points is not None:
            return self._room_of_nearest(points)
        if towards is None:
            return self._room_around(points)
        rooms = np.full(len(points), -1, dtype=np.int32)
        for distance in np.arange(_STEP, _REACH + _STEP / 2, _STEP):
            open_points = np.flatnonzero(rooms < 0)
            moved = points[open_points] + distance * towards[open_points]
            rooms[open_points] = self._rooms_at(moved, np.sign(towards[open_points, 2]))
        return rooms

    def _room_around(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """Room of each point or, outside all of them, of the nearest place of eight around it."""
        rooms = self._rooms_at(points)
        angles = np.arange(8) * np.pi / 4
        for distance in np.arange(_STEP, _REACH + _STEP / 2, _STEP):
            for x, y in zip(np.cos(angles), np.sin(angles), strict=True):
                open_points = np.flatnonzero(rooms < 0)
                moved = points[open_points] + distance * np.array([x, y, 0.0])
                rooms[open_points] = self._rooms_at(moved)
        return rooms

    def _rooms_at(
        self, points: NDArray[np.float64], upwards: NDArray[np.float64] | None = None
    ) -> NDArray[np.int32]:
        """Room whose outline contains each point, -1 none; `upwards` as in the loop below."""
        ids, heights, ends, corners = self._outlines
        sides = np.zeros(len(points)) if upwards is None else upwards
        rooms: NDArray[np.int32] = _rooms_at(points, sides, ids, heights, ends, corners, _REACH)
        return rooms

    def _room_of_nearest(self, points: NDArray[np.float64]) -> NDArray[np.int32]:
        """Room of the nearest point of the cloud, where one is within reach."""
        distance, nearest = self._tree.query(points, distance_upper_bound=_REACH)
        rooms = np.full(len(points), -1, dtype=np.int32)
        found = np.isfinite(distance)
        assert self.labels is not None
        rooms[found] = self.labels[nearest[found]]
        return rooms

    @cached_property
    def _tree(self):  # type: ignore[no-untyped-def]  # scipy has no types
        from scipy.spatial import cKDTree

        return cKDTree(self.points)

    @cached_property
    def _outlines(self) -> tuple[NDArray, NDArray, NDArray, NDArray]:
        """Arguments of `_rooms_at`: the smaller room first, so that one inside another wins."""
        order = sorted(self.rooms, key=lambda room: abs(signed_area(room.polygon)))
        ends = np.cumsum([0, *(len(room.polygon) for room in order)])
        corners = np.concatenate([np.zeros((0, 2)), *(room.polygon for room in order)])
        return (
            np.array([room.id for room in order], dtype=np.int32),
            np.array([(room.z_low, room.z_high) for room in order]).reshape(-1, 2),
            ends.astype(np.int64),
            np.ascontiguousarray(corners, dtype=np.float64),
        )


def signed_area(polygon: NDArray[np.float64]) -> float:
    """Return the area of a polygon (K, 2), m²: positive where it runs counter-clockwise.

    >>> signed_area(np.array([[0.0, 0.0], [2.0, 0.0], [2.0, 1.0], [0.0, 1.0]]))
    2.0
    """
    x, y = polygon.T
    return float(0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def join_rings(rings: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return one polygon for an outline, its holes and its further parts.

    The edges between the rings run there and back, so that they cancel under the even-odd rule.

    Parameters
    ----------
    rings : (K, 2) each, without their first point repeated at the end
    """
    first = rings[0]
    parts = [first]
    for ring in rings[1:]:
        parts += [first[:1], ring, ring[:1]]
    return np.concatenate([*parts, first[:1]] if len(rings) > 1 else parts)


@njit(cache=True, nogil=True)
def _rooms_at(points, upwards, ids, heights, ends, corners, reach):  # type: ignore[no-untyped-def]
    """Room of each point: inside the polygon, and nearest to the room's range of heights.

    A point seen from above (`upwards` 1) is in no room below it, one from below (-1) in none above.
    """
    rooms = np.full(len(points), -1, dtype=np.int32)
    for i in range(len(points)):
        x, y, z = points[i]
        nearest = reach
        for k in range(len(ids)):
            gap = max(heights[k, 0] - z, z - heights[k, 1], 0.0)
            if (upwards[i] > 0.0 and z > heights[k, 1]) or (upwards[i] < 0.0 and z < heights[k, 0]):
                continue
            if gap > nearest or (gap == nearest and rooms[i] >= 0):
                continue
            inside = False
            before = ends[k + 1] - 1
            for j in range(ends[k], ends[k + 1]):
                y0, y1 = corners[before, 1], corners[j, 1]
                if (y0 > y) != (y1 > y):
                    x0, x1 = corners[before, 0], corners[j, 0]
                    if x < x0 + (y - y0) * (x1 - x0) / (y1 - y0):
                        inside = not inside
                before = j
            if inside:
                nearest = gap
                rooms[i] = ids[k]
    return rooms
