"""Passages: where the navigable parts of two rooms meet (thesis §4.2.9, Algorithm 7)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.extraction.contacts import Contact, find_contacts, one_a_door, steps
from topometric_ros.extraction.doorways import Surroundings, kind_of_rise
from topometric_ros.extraction.mapped_rooms import MappedRooms
from topometric_ros.extraction.stairs import StairsConfig, find_stairs
from topometric_ros.topometric_map import NO_ROOM, Passage, Storey
from topometric_ros.voxels.components import connected_components
from topometric_ros.voxels.grid import VoxelGrid
from topometric_ros.voxels.kernels import kernel_of

_FLOOR = 0.25
"""Voxels this near to their storey's floor, m, are of it."""
_HIGHEST_STEPS = 1.2
"""Height over a storey's floor, m, up to which steps and ramps join rooms of that storey."""

_AROUND = 1.0
"""How far round a passage the floor is looked at for steps and slopes, m."""


@dataclass(frozen=True)
class PassageConfig:
    """When two rooms count as connected; the defaults are the thesis' values."""

    connectivity: str = parameter(
        "6", "Neighbourhood in which navigable voxels of two rooms meet.", choices=("6", "26")
    )
    step: float = parameter(
        0.2,
        "Difference of height that an agent steps over; the dilation of the navigable volume.",
        unit="m",
        minimum=0.0,
        maximum=1.0,
    )
    smallest_contact: int = parameter(
        1, "Fewest adjacent pairs of voxels that make a passage.", unit="pairs", minimum=1
    )
    clearance: float = parameter(
        0.3,
        "Width of the agent: navigable voxels keep half of it from walls on either side.",
        unit="m",
        minimum=0.0,
        maximum=2.0,
    )
    storeys: bool = parameter(
        False,
        "Join rooms of one storey by what can be reached from its floor, and storeys by stairs "
        "only; measure doors. Without, whatever is navigable joins rooms (the thesis).",
    )
    door: float = parameter(
        1.6,
        "Contacts of a room with two others that meet span at most this where they are one door.",
        unit="m",
        minimum=0.0,
        maximum=3.0,
    )
    stairs: StairsConfig = field(default_factory=StairsConfig)


def passages_of(rooms: MappedRooms, config: PassageConfig) -> tuple[Passage, ...]:
    """Return the passages between rooms as the configuration's preset finds them."""
    if config.storeys:
        return find_links(rooms, config)
    return find_passages(rooms.grid, rooms.room, rooms.navigable, config)


def find_passages(
    grid: VoxelGrid,
    room: NDArray[np.int32],
    navigable: NDArray[np.int32],
    config: PassageConfig,
) -> tuple[Passage, ...]:
    """Return one passage for every place where two rooms' navigable voxels are adjacent.

    Two rooms may share several passages: adjacent pairs of voxels form one passage as long as they
    hang together (26-neighbourhood, and `step` in height). Its position is the centroid of the
    middles of those pairs; its width is their horizontal extent along its main direction and the
    agent's width (at least a voxel), because navigable voxels keep away from door jambs.

    Parameters
    ----------
    grid : the occupied voxels
    room : (N,) int32, the room of each voxel, NO_ROOM for none
    navigable : (M, 3) int32, cells of the grid
    config : adjacency and the smallest contact

    Returns
    -------
    passages ordered by their rooms' ids, then the largest contact first; positions in m, level
    frame
    """
    rows = grid.index.rows(navigable)
    label = np.where(rows >= 0, room[rows], NO_ROOM).astype(np.int32)
    return tuple(
        _plain_passage(contact, grid.voxel_size, config)
        for contact in _contacts(grid, navigable, label, config)
    )


def find_links(rooms: MappedRooms, config: PassageConfig) -> tuple[Passage, ...]:
    """Return the passages of preset `default`: with height, kind and confidence.

    Rooms of one storey are joined by what can be walked to from its floor only, because ceilings,
    tables and slabs have room to stand above them too, and a door counts once (`one_a_door`).
    Rooms of two storeys are joined by stairs only (`stairs.py`).

    Returns
    -------
    passages ordered by their rooms' ids; positions at their middle, widths from jamb to jamb
    """
    grid, navigable = rooms.grid, rooms.navigable
    label = rooms.room_of_standing
    storey = rooms.storey_of(label)
    surroundings = Surroundings(grid, rooms.columns, rooms.surface)
    found: list[Passage] = []
    for one in rooms.storeys:
        own = storey == one.id
        own[own] = _walkable(navigable[own], grid, one, config)
        contacts = one_a_door(_contacts(grid, navigable[own], label[own], config), config.door)
        floor = _Floor(rooms.standing[own])
        found += [_measured(c, surroundings, floor, one, grid.voxel_size, config) for c in contacts]
    found += find_stairs(rooms, config.stairs)
    return tuple(sorted(found, key=lambda p: p.rooms))


def _contacts(
    grid: VoxelGrid,
    navigable: NDArray[np.int32],
    label: NDArray[np.int32],
    config: PassageConfig,
) -> list[Contact]:
    return find_contacts(
        grid, navigable, label, config.connectivity, config.step, config.smallest_contact
    )


def _walkable(
    navigable: NDArray[np.int32], grid: VoxelGrid, storey: Storey, config: PassageConfig
) -> NDArray[np.bool_]:
    """Return which voxels of a storey can be reached from its floor by steps: (M,) bool."""
    height = grid.origin[2] + navigable[:, 2] * grid.voxel_size - storey.floor_z
    low = np.flatnonzero(height <= _HIGHEST_STEPS)
    rise = math.floor(2 * config.step / grid.voxel_size + 0.5)
    component = connected_components(navigable[low], kernel_of(steps("26", rise)))
    on_floor = np.abs(height[low]) <= _FLOOR
    floors = np.bincount(component[on_floor], minlength=int(component.max(initial=0)) + 1)
    walkable = np.zeros(len(navigable), bool)
    walkable[low] = floors[component] > 0
    return walkable


def _plain_passage(contact: Contact, voxel_size: float, config: PassageConfig) -> Passage:
    """Return the passage of a contact as the thesis describes it."""
    x, y, z = contact.points.mean(0).tolist()
    width = contact.extent() + max(config.clearance, voxel_size)
    return Passage(rooms=contact.rooms, position=(x, y, z), width=width)


def _measured(
    contact: Contact,
    surroundings: Surroundings,
    floor: _Floor,
    storey: Storey,
    voxel_size: float,
    config: PassageConfig,
) -> Passage:
    """Return the passage of a contact with what stands round it; `floor` is walkable."""
    passage = _plain_passage(contact, voxel_size, config)
    x, y, z = passage.position
    doorway = surroundings.doorway(contact.points[:, :2], contact.extent(), z, storey.ceiling_z)
    kind = "opening"
    if doorway is not None:
        (x, y), kind = doorway.middle, doorway.kind
        passage = replace(passage, width=doorway.width, height=doorway.height)
    rise = kind_of_rise(floor.around((x, y)) - (x, y, z))
    kind = rise or kind
    confidence = _confidence(kind, passage.width)
    return replace(passage, position=(x, y, z), kind=kind, confidence=confidence)


class _Floor:
    """Places on a floor (n, 3), m, found by where they lie along x."""

    def __init__(self, places: NDArray[np.float64]) -> None:
        self._places = places[np.argsort(places[:, 0], kind="stable")]

    def around(self, middle: tuple[float, float]) -> NDArray[np.float64]:
        """Return the places near a place (x, y): (k, 3)."""
        x = self._places[:, 0]
        strip = slice(*np.searchsorted(x, (middle[0] - _AROUND, middle[0] + _AROUND)))
        part = self._places[strip]
        near: NDArray[np.float64] = part[np.hypot(*(part[:, :2] - middle).T) <= _AROUND]
        return near


def _confidence(kind: str, width: float) -> float:
    """Return the share of passages of such a kind and width (m) that are right.

    Counted by `scripts/measure_passages.py`; the wrong ones join two pieces of one room.
    """
    if width < 0.6:
        return 0.2
    if width <= 1.1:
        return 0.95
    if kind == "door":
        return 0.65
    return 0.6 if width <= 1.5 else 0.4
