"""Walks of agents: by waypoints, by rooms to visit, or sampled so that two agents share a part.

What a walk will see is foretold from a coarse look round at the places it passes, so that many
pairs of walks can be compared before one is scanned.
"""

from __future__ import annotations

import itertools
import logging
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.simulation.agents import WalkConfig, rotation, translation
from topometric_ros.simulation.degrade import cell_codes
from topometric_ros.simulation.walkable import TrajectoryError, Walkable
from topometric_ros.simulation.world import World

logger = logging.getLogger(__name__)

OVERLAP_VOXEL = 0.2
"""Edge of the voxels whose shared part is the overlap of two agents, m."""

_LOOK_EVERY = 1.0
"""Places within a square of this edge see the same in the forecast, m."""
_LOOKS = 10000
"""Rays of one coarse look."""
_LEADERS, _FOLLOWERS = 6, 10
"""Walks drawn, and walks drawn near each of them."""
_NEAR_ENOUGH = 0.02
"""Pairs whose foretold overlap is no farther from the wanted one are equal in that; a tenth of
the wanted overlap where it is small."""
_LONG = 0.08
"""What a pair gains over another by seeing as much as the longest walk: so much overlap amiss."""


@dataclass(frozen=True)
class Walk:
    """What an agent is told: rooms to visit in turn or, where given, waypoints (W, 3), m.

    A waypoint whose z is NaN lies on the lowest floor there.
    """

    rooms: tuple[int, ...] = ()
    waypoints: NDArray[np.float64] | None = None


def way_of(walk: Walk, walkable: Walkable) -> NDArray[np.int64]:
    """Return the places on a walk, in turn: (K,).

    Raises
    ------
    TrajectoryError
        The walk names nowhere to go, a waypoint far from all places, or a way that does not exist.
    """
    if walk.waypoints is not None and len(walk.waypoints):
        stops = [walkable.nearest(position) for position in walk.waypoints]
    else:
        stops = [walkable.anchor(room) for room in walk.rooms]
    if not stops:
        raise TrajectoryError("a walk needs rooms to visit or waypoints")
    legs = [walkable.way(a, b)[1:] for a, b in itertools.pairwise(stops)]
    return np.concatenate([np.array(stops[:1]), *legs])


def rooms_on(way: NDArray[np.int64], walkable: Walkable) -> tuple[int, ...]:
    """Return the rooms that a walk passes through, in the order of their first visit."""
    return tuple(dict.fromkeys(room for room in walkable.room[way].tolist() if room >= 0))


def poses_along(
    path: NDArray[np.float64], height: float, config: WalkConfig, rng: np.random.Generator
) -> list[NDArray[np.float64]]:
    """Return T_building_sensor (4, 4) at equal distances along a path (K, 3), m, on the floor.

    x looks ahead; roll and pitch sway. A path of one place has one pose.
    """
    lengths = np.linalg.norm(np.diff(path, axis=0), axis=1)
    marks = np.concatenate([[0.0], np.cumsum(lengths)])
    count = max(1, round(float(marks[-1]) / config.spacing) + 1)
    poses = []
    for distance in np.linspace(0.0, marks[-1], count):
        # Looking ahead over half a step smooths the corners of the grid's way.
        at, behind, ahead = (
            np.array([np.interp(distance + d, marks, axis) for axis in path.T])
            for d in (0.0, -config.spacing / 2, config.spacing / 2)
        )
        roll, pitch = rng.normal(0.0, config.sway, 2)
        yaw = float(np.arctan2(*(ahead - behind)[1::-1]))
        lifted = at + [0.0, 0.0, height]
        poses.append(translation(*lifted) @ rotation(roll, pitch, yaw))
    return poses


class Forecast:
    """What walks through a building are going to see, roughly."""

    def __init__(self, world: World, walkable: Walkable, height: float, reach: float) -> None:
        self._world, self._walkable = world, walkable
        self._height, self._reach = height, reach
        self._seen: dict[int, NDArray[np.int64]] = {}
        self._directions = _sphere(_LOOKS)
        squares = cell_codes(walkable.places, _LOOK_EVERY)
        _, first, self._square = np.unique(squares, return_index=True, return_inverse=True)
        self._look_at = first[self._square.reshape(-1)]

    def seen(self, way: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the codes of the voxels that a walk sees, sorted: (V,)."""
        looks = np.unique(self._look_at[way])
        return np.unique(np.concatenate([self._look(int(place)) for place in looks]))

    def _look(self, place: int) -> NDArray[np.int64]:
        if place not in self._seen:
            origin = self._walkable.places[place] + [0.0, 0.0, self._height]
            origins = np.broadcast_to(origin, self._directions.shape)
            hits = self._world.cast(origins, self._directions, self._reach)
            hits = hits[np.isfinite(hits[:, 0])]
            self._seen[place] = np.unique(cell_codes(hits, OVERLAP_VOXEL))
        return self._seen[place]


def sampled_walks(
    walkable: Walkable,
    forecast: Forecast,
    wanted: float,
    agents: int,
    visits: int,
    rng: np.random.Generator,
) -> list[Walk]:
    """Return walks whose overlap, from each agent to the next, is foretold near the wanted one.

    Parameters
    ----------
    wanted : shared part of the smaller walk's voxels, 0 to 1
    visits : rooms that each agent visits, 0: any number up to 14
    rng : draws the candidates

    Raises
    ------
    TrajectoryError
        Fewer than two rooms can be entered.
    """
    walks = _candidates(walkable, wanted, visits, rng)
    seen = [forecast.seen(way_of(walk, walkable)) for walk in walks]
    overlap = overlap_matrix(seen)
    size = np.array([len(codes) for codes in seen]) / max(len(codes) for codes in seen)
    amiss = np.maximum(np.abs(overlap - wanted) - min(_NEAR_ENOUGH, wanted / 10), 0.0)
    cost = amiss - _LONG * np.minimum(size[:, None], size)
    if wanted < _NEAR_ENOUGH:
        cost += amiss  # Where nothing is to be shared, length must not buy any.
    np.fill_diagonal(cost, np.inf)
    best = int(np.argmin(cost))
    chosen = [best // len(walks), best % len(walks)] if agents > 1 else [0]
    while len(chosen) < agents:
        following = cost[chosen[-1]].copy()
        following[chosen] = np.inf
        chosen.append(int(np.argmin(following)))
    for a, b in itertools.pairwise(chosen):
        logger.info("foretold overlap %.2f of %.2f wanted", overlap[a, b], wanted)
    return [walks[i] for i in chosen]


def overlap_matrix(seen: Sequence[NDArray[np.int64]]) -> NDArray[np.float64]:
    """Return the shared part of the smaller of every two sets of codes: (K, K), 0 to 1."""
    every = np.unique(np.concatenate([np.zeros(0, np.int64), *seen]))
    member = np.zeros((len(seen), len(every)), dtype=np.float32)
    for row, codes in zip(member, seen, strict=True):
        row[np.searchsorted(every, codes)] = 1.0
    shared = (member @ member.T).astype(np.float64)
    size = np.diag(shared)
    return shared / np.maximum(np.minimum(size[:, None], size), 1.0)


def _candidates(
    walkable: Walkable, wanted: float, visits: int, rng: np.random.Generator
) -> list[Walk]:
    """Draw walks, and to each some that begin near it, the nearer the more is to be shared."""
    rooms = sorted(walkable.anchors)
    if len(rooms) < 2:
        raise TrajectoryError(f"{walkable.building.name}: a walk needs two rooms to enter")
    walks = []
    for _ in range(_LEADERS):
        leader = _random_walk(walkable, int(rng.choice(rooms)), visits, rng)
        walks.append(leader)
        for _ in range(_FOLLOWERS):
            near = rng.random() < wanted
            start = int(rng.choice(leader.rooms if near else rooms))
            walks.append(_random_walk(walkable, start, visits, rng))
    return walks


def _random_walk(walkable: Walkable, start: int, visits: int, rng: np.random.Generator) -> Walk:
    """Draw a walk that mostly goes on to rooms nearby."""
    component = walkable.component[walkable.anchors[start]]
    left = {
        room: place
        for room, place in sorted(walkable.anchors.items())
        if room != start and walkable.component[place] == component
    }
    # As many short walks as long ones: little overlap needs them, and much of it does not mind.
    longest = min(3 if rng.random() < 0.5 else 13, max(len(left), 1))
    count = visits - 1 if visits else int(rng.integers(1, longest + 1))
    rooms = [start]
    for _ in range(min(count, len(left))):
        lengths = walkable.lengths_from(walkable.anchors[rooms[-1]])
        away = np.array([lengths[place] for place in left.values()])
        weight = np.exp(-(away - away.min()) / 4.0)
        chosen = int(rng.choice(list(left), p=weight / weight.sum()))
        rooms.append(chosen)
        del left[chosen]
    return Walk(tuple(rooms))


def _sphere(count: int) -> NDArray[np.float64]:
    """Return directions spread evenly over a sphere (a Fibonacci lattice): (count, 3)."""
    k = np.arange(count) + 0.5
    z = 1.0 - 2.0 * k / count
    angle = np.pi * (1.0 + np.sqrt(5.0)) * k
    across = np.sqrt(1.0 - z**2)
    return np.stack([across * np.cos(angle), across * np.sin(angle), z], axis=1)
