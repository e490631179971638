"""Where agents can walk in a labelled building, and the shortest ways there.

Every storey is a grid of places on its floor, in rooms or close to a link, that keep clear of what
stands there. Neighbouring places are joined, storeys by their stairs; ways prefer the open middle.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.csgraph import connected_components, dijkstra

from topometric_ros.configuration import parameter
from topometric_ros.errors import TopometricError
from topometric_ros.simulation.labelled import LabelledBuilding, TrueLink, TrueRoom
from topometric_ros.simulation.world import World

_STEP_HEIGHT = 0.3
"""The largest difference of height between neighbouring places, m."""
_LEVELS = (0.5, 1.2)
"""Heights over the floor at which a place must be clear, m."""
_NARROW = 0.3
"""How much longer a way through narrow places counts: 1 + this / clearance in m."""
_AT_LINK = 1.5
"""How far from a link's middle the places that it joins may lie, m; three times that for stairs."""
_NEAR, _NEAR_IN_HEIGHT = 1.0, 1.5
"""How far from a waypoint an agent may walk instead, m; the latter is less than a storey."""


class TrajectoryError(TopometricError):
    """A walk that the building does not allow."""


@dataclass(frozen=True)
class WalkableConfig:
    """How finely places lie, and how far they keep from everything."""

    cell: float = parameter(
        0.15, "Distance between neighbouring places.", unit="m", minimum=0.05, maximum=0.5
    )
    clearance: float = parameter(
        0.25, "Distance that agents keep from surfaces.", unit="m", minimum=0.05, maximum=1.0
    )


class Walkable:
    """The places of one building and the ways between them.

    `places` (N, 3) float64, m, on the floor; `room` (N,) int32, -1 between rooms; `anchors`
    {room id: index of the place that stands for it}, without rooms that nobody can enter.

    Raises
    ------
    TrajectoryError
        No room has floor to stand on.
    """

    def __init__(
        self, building: LabelledBuilding, world: World, config: WalkableConfig | None = None
    ) -> None:
        self.building = building
        self._world = world
        config = config or WalkableConfig()
        self.places, self.room, self._key, self._clear = _places(building, world, config)
        self._graph = self._joined()
        self.component: NDArray[np.int32] = connected_components(self._graph, directed=False)[1]
        self.anchors = self._find_anchors()
        self._trees: dict[int, tuple[NDArray[np.float64], NDArray[np.int32]]] = {}
        if not self.anchors:
            raise TrajectoryError(f"{building.name}: no room has floor to stand on")

    def nearest(self, position: NDArray[np.float64]) -> int:
        """Return the place nearest to a position (3,), m; z NaN: in the plan, the lowest one.

        Raises
        ------
        TrajectoryError
            Nobody can stand near it.
        """
        away = np.nan_to_num(self.places - position)
        best = int(np.argmin(np.linalg.norm(away, axis=1)))
        if np.hypot(*away[best, :2]) > _NEAR or abs(away[best, 2]) > _NEAR_IN_HEIGHT:
            at = ", ".join(f"{v:g}" for v in position if np.isfinite(v))
            raise TrajectoryError(
                f"{self.building.name}: nobody can stand within {_NEAR:g} m of the waypoint "
                f"({at}) m; the nearest place is {self._words(best)}"
            )
        return best

    def lengths_from(self, place: int) -> NDArray[np.float64]:
        """Return how far it is to every place, narrow ways counted longer: (N,), inf: no way."""
        return self._tree(place)[0]

    def way(self, start: int, end: int) -> NDArray[np.int64]:
        """Return the places on the way, both ends included: (K,).

        Raises
        ------
        TrajectoryError
            No way leads there.
        """
        lengths, before = self._tree(start)
        if not np.isfinite(lengths[end]):
            raise TrajectoryError(
                f"{self.building.name}: no way leads from {self._words(start)} "
                f"to {self._words(end)}"
            )
        way = [end]
        while way[-1] != start:
            way.append(int(before[way[-1]]))
        return np.array(way[::-1])

    def anchor(self, room: int) -> int:
        """Return the place that stands for a room; raises TrajectoryError if there is none."""
        if room not in self.anchors:
            known = ", ".join(map(str, sorted(self.anchors)))
            raise TrajectoryError(
                f"{self.building.name}: nobody can stand in room {room}; in these: {known}"
            )
        return self.anchors[room]

    def _words(self, place: int) -> str:
        room = int(self.room[place])
        x, y, z = self.places[place]
        name = f" in {self.building.rooms[room].name}" if room >= 0 else ""
        return f"({x:.1f}, {y:.1f}, {z:.1f}) m{name}"

    def _tree(self, start: int) -> tuple[NDArray[np.float64], NDArray[np.int32]]:
        if start not in self._trees:
            self._trees[start] = dijkstra(
                self._graph, directed=False, indices=start, return_predecessors=True
            )
        return self._trees[start]

    def _joined(self) -> csr_matrix:
        """Weighted graph of places: neighbours on the grid, and both sides of every link."""
        keys, order = np.sort(self._key), np.argsort(self._key)
        first, second = [], []
        for dx, dy in ((1, 0), (0, 1), (1, 1), (1, -1)):
            wanted = self._key + (dx << 20) + dy
            at = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
            found = np.flatnonzero(keys[at] == wanted)
            first.append(found)
            second.append(order[at[found]])
        a, b = np.concatenate(first), np.concatenate(second)
        level = np.abs(self.places[a, 2] - self.places[b, 2]) <= _STEP_HEIGHT
        a, b = a[level], b[level]
        links = np.array(self._link_edges(), dtype=np.int64).reshape(-1, 2)
        a, b = np.concatenate([a, links[:, 0]]), np.concatenate([b, links[:, 1]])
        clear = np.minimum(self._clear[a], self._clear[b])
        weight = np.linalg.norm(self.places[a] - self.places[b], axis=1) * (1 + _NARROW / clear)
        # Both ends of a link may be one place or neighbours already: the shortest edge counts.
        kept = a != b
        low, high = np.minimum(a, b)[kept], np.maximum(a, b)[kept]
        pairs, index = np.unique(low * len(keys) + high, return_index=True)
        graph = coo_matrix(
            (weight[kept][index], (pairs // len(keys), pairs % len(keys))), (len(keys),) * 2
        )
        return graph.tocsr()

    def _link_edges(self) -> list[tuple[int, int]]:
        edges = []
        for link in self.building.links:
            a, b = (self._place_at(link, room) for room in link.rooms)
            if a is not None and b is not None and (link.kind == "stair" or self._sees(a, b)):
                edges.append((a, b))
        return edges

    def _sees(self, a: int, b: int) -> bool:
        """True where no surface is between two places: links of clouds are but proposals."""
        start, end = (self.places[place] + [0.0, 0.0, _LEVELS[-1]] for place in (a, b))
        length = float(np.linalg.norm(end - start))
        ray = (end - start) / max(length, 1e-9)
        return bool(np.isnan(self._world.cast(start[None], ray[None], length)).all())

    def _place_at(self, link: TrueLink, room: int) -> int | None:
        """Return the place of a room nearest to a link in the plan, None where it is far."""
        own = np.flatnonzero(self.room == room)
        if len(own) == 0 and link.kind == "stair":
            # A stairwell's upper end has no floor of its own: the landing beside it has.
            own = np.flatnonzero(self._key >> 40 == self.building.rooms[room].storey)
        if len(own) == 0:
            return None
        away = np.linalg.norm(self.places[own, :2] - link.position[:2], axis=1)
        reach = 3 * _AT_LINK if link.kind == "stair" else _AT_LINK
        return int(own[np.argmin(away)]) if away.min() <= reach else None

    def _find_anchors(self) -> dict[int, int]:
        """For each room an open place near its middle, in the component that joins most rooms."""
        inside = self.room >= 0
        pairs = np.unique(np.stack([self.component[inside], self.room[inside]]), axis=1)
        joined = np.bincount(pairs[0], minlength=int(self.component.max(initial=0)) + 1)
        size = np.bincount(self.component, minlength=len(joined))
        anchors = {}
        for room in np.unique(self.room[inside]):
            own = np.flatnonzero(self.room == room)
            components = np.unique(self.component[own])
            best = max(components, key=lambda c: (joined[c], size[c]))
            own = own[self.component[own] == best]
            centre = self.places[own, :2].mean(axis=0)
            away = np.linalg.norm(self.places[own, :2] - centre, axis=1)
            score = np.minimum(self._clear[own], 0.8) - 0.2 * away
            anchors[int(room)] = int(own[np.argmax(score)])
        return anchors


def _places(
    building: LabelledBuilding, world: World, config: WalkableConfig
) -> tuple[NDArray, NDArray, NDArray, NDArray]:
    """Return places (N, 3), their rooms, their keys on the grid of their storey, clearance (N,)."""
    low = np.min([room.polygon.min(axis=0) for room in building.rooms], axis=0) - 1.0
    found: dict[int, tuple[float, float, float, int]] = {}
    # Links first: rooms, the small ones last, overwrite what of them lies inside.
    for link in building.links:
        room = building.rooms[link.rooms[0]]
        radius = max(link.width, 0.8)
        xy, keys = _cells_round(link.position[:2], radius, low, config.cell)
        height = float(link.position[2])
        _enter(found, xy, keys + (room.storey << 40), height, -1)
    for room in sorted(building.rooms, key=_extent, reverse=True):
        middle = (room.polygon.min(axis=0) + room.polygon.max(axis=0)) / 2
        xy, keys = _cells_round(middle, float(np.ptp(room.polygon, axis=0).max()), low, config.cell)
        own = _inside(xy, room.polygon)
        _enter(found, xy[own], keys[own] + (room.storey << 40), room.z_low, room.id)
    keys = np.array(sorted(found), dtype=np.int64)
    table = np.array([found[key] for key in keys.tolist()]).reshape(-1, 4)
    places, room_ids = table[:, :3].copy(), table[:, 3].astype(np.int32)
    down = np.broadcast_to([0.0, 0.0, -1.0], places.shape)
    floor = world.cast(places + [0.0, 0.0, 1.0], down, 1.0 + _STEP_HEIGHT)[:, 2]
    if building.is_cloud:
        # Scanned floors have gaps, and rooms end where their labels do: no return is no hole.
        floor = np.where(np.isnan(floor), places[:, 2], floor)
    standing = np.flatnonzero(np.abs(floor - places[:, 2]) <= _STEP_HEIGHT)
    places, room_ids, keys = places[standing], room_ids[standing], keys[standing]
    places[:, 2] = floor[standing]
    clear = np.min([world.clearance(places + [0.0, 0.0, h]) for h in _LEVELS], axis=0)
    kept = clear >= config.clearance
    return places[kept], room_ids[kept], keys[kept], clear[kept]


def _extent(room: TrueRoom) -> float:
    return float(np.prod(np.ptp(room.polygon, axis=0)))


def _cells_round(
    middle: NDArray[np.float64], radius: float, low: NDArray[np.float64], cell: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return the grid's positions (K, 2) in a square round a point and their keys (K,)."""
    first = np.maximum(np.floor((middle - radius - low) / cell).astype(np.int64), 0)
    last = np.maximum(np.ceil((middle + radius - low) / cell).astype(np.int64), 0)
    x, y = (np.arange(first[axis], last[axis] + 1) for axis in (0, 1))
    ix, iy = (grid.reshape(-1) for grid in np.meshgrid(x, y, indexing="ij"))
    return low + np.stack([ix, iy], axis=1) * cell, (ix << 20) + iy


def _enter(
    found: dict[int, tuple[float, float, float, int]],
    xy: NDArray[np.float64],
    keys: NDArray[np.int64],
    height: float,
    room: int,
) -> None:
    for (x, y), key in zip(xy.tolist(), keys.tolist(), strict=True):
        found[key] = (x, y, height, room)


def _inside(points: NDArray[np.float64], polygon: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points (N, 2) a polygon (K, 2) contains, by the even-odd rule."""
    inside = np.zeros(len(points), dtype=bool)
    x, y = points.T
    for (x0, y0), (x1, y1) in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if y0 != y1:
            crosses = (y0 > y) != (y1 > y)
            inside ^= crosses & (x < x0 + (y - y0) * (x1 - x0) / (y1 - y0))
    return inside
