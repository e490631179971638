"""What the view of a map shows, whatever it came from: points with their labels and a graph."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.io.trajectories import AgentTrajectory
from topometric_ros.topometric_map import NO_ROOM, TopometricMap
from topometric_ros.voxels.palette import agent_colour, room_colours

MOST_POINTS = 120_000
"""Points of a page: what browsers turn smoothly, at some 20 bytes each."""

_UPPER = 1.9
"""Height in metres above its storey's floor from which a point hides what is below."""
_BELOW_FLOOR = 0.3
_MANY = (0x4A, 0x4A, 0x4A)
"""Colour of what several agents saw."""


class ViewError(TopometricError):
    """Nothing there that can be shown."""


@dataclass(frozen=True)
class Match:
    """A pair of agents with what became of it, and the rooms held to be the same in their maps."""

    agents: tuple[str, str]
    status: str
    reason: str
    rooms: tuple[tuple[int, int], ...] = ()


@dataclass(frozen=True)
class View:
    """A map with who observed each voxel.

    `observed_by` (N,) uint32 has a bit for each of `agents`; in a single agent's map all are 1.
    """

    title: str
    map: TopometricMap
    observed_by: NDArray[np.uint32]
    agents: tuple[str, ...]
    matches: tuple[Match, ...] = ()
    rooms_of: Mapping[int, tuple[tuple[str, int], ...]] = field(default_factory=dict)
    """The agents' own rooms, as agent and id, that became each room of a global map."""
    trajectories: tuple[AgentTrajectory, ...] = ()
    """Where agents were, in the map's level frame; of those that are in the map and known."""


@dataclass(frozen=True)
class ViewPoints:
    """The points that are shown, thinned evenly along the Morton order.

    `xyz` (n, 3) float32, m, level frame; `room` (n,) int32 room ids; `storey` (n,) uint8 index into
    the map's storeys; `observers` (n,) uint8 index into `classes`; `upper` (n,) bool: near or at
    the ceiling.
    """

    xyz: NDArray[np.float32]
    room: NDArray[np.int32]
    storey: NDArray[np.uint8]
    observers: NDArray[np.uint8]
    upper: NDArray[np.bool_]
    step: int
    """Every how manieth voxel is shown."""
    classes: tuple[tuple[str, tuple[int, int, int]], ...]
    """Who saw a point, as words, with a colour."""


def single_view(m: TopometricMap, trajectory: AgentTrajectory | None = None) -> View:
    """Return the view of one agent's map; `trajectory` is in the frame of the map's input."""
    agent = m.agent or "map"
    ways = () if trajectory is None else (trajectory.moved(m.T_level_input),)
    return View(agent, m, np.ones(len(m.voxels), np.uint32), (agent,), trajectories=ways)


def view_points(view: View, most: int = MOST_POINTS) -> ViewPoints:
    """Return at most `most` points of a view."""
    m = view.map
    step = max(1, -(-len(m.voxels) // most))
    xyz = m.surface()[::step]
    room, masks = m.room[::step], view.observed_by[::step]
    storey = point_storeys(m, xyz[:, 2], room)
    floors = np.array([s.floor_z for s in m.storeys] or [0.0])
    kinds, observers = np.unique(masks, return_inverse=True)
    classes = tuple(_class(int(mask), view.agents) for mask in kinds)
    return ViewPoints(
        xyz.astype(np.float32),
        room,
        storey,
        observers.astype(np.uint8),
        xyz[:, 2] > floors[storey] + _UPPER,
        step,
        classes,
    )


def point_storeys(
    m: TopometricMap, z: NDArray[np.float64], room: NDArray[np.int32]
) -> NDArray[np.uint8]:
    """Return the index of each point's storey: its room's, else by its height z (m)."""
    if not m.storeys:
        return np.zeros(len(z), np.uint8)
    index = {storey.id: k for k, storey in enumerate(m.storeys)}
    floors = np.array([storey.floor_z for storey in m.storeys])
    order = np.argsort(floors, kind="stable")
    place = np.searchsorted(floors[order] - _BELOW_FLOOR, z, side="right") - 1
    storeys = order[np.clip(place, 0, None)]
    for entry in m.rooms:
        storeys[room == entry.id] = index[entry.storey]
    return storeys.astype(np.uint8)


def room_shares(view: View, room_id: int) -> dict[str, float]:
    """Return what share of a room's voxels each agent saw."""
    masks = view.observed_by[view.map.room == room_id]
    if not len(masks):
        return {}
    shares = {
        agent: float(((masks >> np.uint32(k)) & np.uint32(1)).mean())
        for k, agent in enumerate(view.agents)
    }
    return {agent: share for agent, share in shares.items() if share > 0}


def colours_of(points: ViewPoints, by: str) -> NDArray[np.uint8]:
    """Return each point's colour by "room", "agent" or "storey": (n, 3) uint8."""
    if by == "room":
        return room_colours(points.room)
    if by == "agent":
        return np.array([colour for _, colour in points.classes], np.uint8)[points.observers]
    return room_colours(points.storey.astype(np.int64) + 1)


def room_name(room_id: int) -> str:
    """Return how a room is called."""
    return "no room" if room_id == NO_ROOM else f"room {room_id}"


def _class(mask: int, agents: tuple[str, ...]) -> tuple[str, tuple[int, int, int]]:
    seen = [k for k in range(len(agents)) if mask >> k & 1]
    if not seen:
        return "nobody", _MANY
    return " + ".join(agents[k] for k in seen), agent_colour(seen[0]) if len(seen) == 1 else _MANY
