"""One global topometric map from the maps of a group of agents (thesis §4.4).

Geometry first: every agent's surface goes into the anchor's voxels. Topology then follows from it:
rooms that cover the same voxels become one room, their passages one passage (`fuse_rooms`), floors
of one height one storey (`fuse_storeys`).
"""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import GlobalMap
from topometric_ros.configuration import parameter
from topometric_ros.extraction.assemble import assemble_rooms
from topometric_ros.extraction.mapped_rooms import MappedRooms
from topometric_ros.fusion.changes import ChangesConfig, Placed, without_outdated
from topometric_ros.fusion.fuse_rooms import (
    Fragment,
    fused_passages,
    room_ids,
    rooms_by_id,
    storeys_of_rooms,
)
from topometric_ros.fusion.fuse_storeys import fused_storeys
from topometric_ros.fusion.nonrigid import NonRigidConfig, bends
from topometric_ros.fusion.poses import Transform, apply, inverse, level_frames
from topometric_ros.topometric_map import NO_ROOM, Passage, TopometricMap
from topometric_ros.voxels.grid import (
    in_morton_order,
    lattice_coordinates,
    surface_offsets,
    voxelise,
)

_QUARTERS = np.array([(-0.25, -0.25), (-0.25, 0.25), (0.25, -0.25), (0.25, 0.25)])

GLOBAL = "global"
"""The agent that a global map names."""


@dataclass(frozen=True)
class FuseConfig:
    """When rooms and passages of different maps are one."""

    room_overlap: float = parameter(
        0.5,
        "Share of the smaller room's cells (two voxels wide) that makes two rooms one.",
        minimum=0.05,
        maximum=1.0,
    )
    passage_distance: float = parameter(
        1.0, "Passages between the same rooms are one up to this distance.", unit="m", minimum=0.0
    )
    floor_distance: float = parameter(
        0.5, "Floors are of one storey up to this difference.", unit="m", minimum=0.0, maximum=1.5
    )
    changes: ChangesConfig = field(default_factory=ChangesConfig)
    nonrigid: NonRigidConfig = field(default_factory=NonRigidConfig)


def fuse(
    maps: Sequence[TopometricMap],
    T_global_agent: Sequence[Transform | None],
    config: FuseConfig,
    frame_id: str | None = None,
) -> GlobalMap:
    """Fuse the maps of the anchor's group.

    Parameters
    ----------
    maps : the agents' maps in the result's order, the anchor first
    T_global_agent : (4, 4) float64 each, from the agent's input frame to the anchor's, or None for
        agents that are not placed there
    config : FuseConfig
    frame_id : name of the global frame; the anchor's where None

    Returns
    -------
    GlobalMap on the anchor's lattice, at the largest voxel size among the maps: a map of the
    anchor's level frame with the anchor's `T_level_input`. Its voxels are those that any agent's
    surface points lie in, their offsets the mean of these points. The rooms' attributes are
    measured anew on them.
    """
    anchor = maps[0]
    placed, changes = without_outdated(_placed(maps, T_global_agent), config.changes)
    size = max(m.voxel_size for _, m, _ in placed)
    origin = np.asarray(anchor.origin, dtype=np.float64)
    clouds = _surfaces(placed, config.nonrigid)
    if sum(map(len, clouds)) == 0:
        return GlobalMap(_empty(anchor, frame_id), np.zeros(0, dtype=np.uint32))
    points = np.concatenate(clouds)
    grid, row_of_point = voxelise(points, size, origin)
    rows = np.split(row_of_point, np.cumsum([len(c) for c in clouds])[:-1])
    agents = np.zeros(len(grid), dtype=np.uint32)
    for (index, _, _), own in zip(placed, rows, strict=True):
        agents[own] |= np.uint32(1 << index)
    storeys, storey_of = fused_storeys([(m, T) for _, m, T in placed], config.floor_distance)
    fragments = [
        Fragment(index, m, T, own, storey_of[position])
        for position, ((index, m, T), own) in enumerate(zip(placed, rows, strict=True))
    ]
    new_id = room_ids(fragments, grid.coords, config.room_overlap)
    room = _labels(fragments, new_id, len(grid))
    known = set(np.unique(room[room != NO_ROOM]).tolist())
    passages = fused_passages(fragments, new_id, known, config.passage_distance)
    mapped = MappedRooms(
        grid,
        surface_offsets(points, grid, row_of_point),
        room,
        _navigable(placed, size, origin),
        storeys_of_rooms(fragments, new_id, known),
        storeys,
    )
    fused = _filled(_empty(anchor, frame_id), placed, mapped, passages)
    return GlobalMap(fused, agents, rooms_by_id(new_id, known), changes)


def _placed(
    maps: Sequence[TopometricMap], T_global_agent: Sequence[Transform | None]
) -> list[Placed]:
    """Return the maps that have a place, with their numbers and transforms of level frames."""
    level = maps[0].T_level_input
    return [
        (index, m, level_frames(T, level, m.T_level_input))
        for index, (m, T) in enumerate(zip(maps, T_global_agent, strict=True))
        if T is not None
    ]


def _surfaces(placed: Sequence[Placed], config: NonRigidConfig) -> list[NDArray[np.float64]]:
    """Return each map's surface (N, 3) in the global level frame, m, rooms moved where asked."""
    asked = config.enabled and len(placed) > 1
    bent = bends([(m, T) for _, m, T in placed], config) if asked else None
    if bent is None:
        return [apply(T, m.surface()) for _, m, T in placed]
    return [own.apply(m.surface()) for own, (_, m, _) in zip(bent, placed, strict=True)]


def _filled(
    empty: TopometricMap,
    placed: Sequence[Placed],
    mapped: MappedRooms,
    passages: tuple[Passage, ...],
) -> TopometricMap:
    """Return the global map of these rooms, their attributes measured anew."""
    session, sequence = _version([m for _, m, _ in placed])
    return replace(
        empty,
        session=session,
        sequence=sequence,
        stamp=max(m.stamp for _, m, _ in placed),
        voxel_size=mapped.grid.voxel_size,
        voxels=mapped.grid.coords,
        offsets=mapped.offsets,
        room=mapped.room,
        navigable=mapped.navigable,
        viewpoints=_viewpoints(placed),
        rooms=assemble_rooms(mapped, passages),
        passages=passages,
        storeys=mapped.storeys,
    )


def _version(maps: Sequence[TopometricMap]) -> tuple[str, int]:
    """Return the session and sequence of a map that these were fused into.

    The session changes with the agents and their sessions, the sequence counts their snapshots: a
    consumer that compares both sees every update, whichever agent it came from.
    """
    if len(maps) == 1:
        return maps[0].session, maps[0].sequence
    sessions = "\n".join(f"{m.agent}={m.session}" for m in maps)
    return hashlib.sha256(sessions.encode()).hexdigest()[:12], sum(m.sequence for m in maps)


def _labels(
    fragments: Sequence[Fragment], new_id: dict[tuple[int, int], int], voxels: int
) -> NDArray[np.int32]:
    """Return the room of every fused voxel; where agents differ, the first agent's."""
    room = np.full(voxels, NO_ROOM, dtype=np.int32)
    for fragment in reversed(fragments):
        for old in fragment.map.rooms:
            own = fragment.rows[fragment.map.room == old.id]
            room[own] = new_id[fragment.agent, old.id]
    return room


def _navigable(
    placed: Sequence[Placed],
    size: float,
    origin: NDArray[np.float64],
) -> NDArray[np.int32]:
    """Return the cells of the global lattice that any agent could stand on: (M, 3) int32.

    Those that the middle of an agent's cell lies in, and those whose own middle lies in one: a
    turned lattice would leave holes.
    """
    coords = []
    for _, m, T in placed:
        middles = np.asarray(m.origin) + m.navigable * m.voxel_size
        coords.append(lattice_coordinates(apply(T, middles), size, origin))
        # The four quarters of a cell reach every cell whose middle it can hold.
        quarters = np.repeat(middles, 4, axis=0)
        quarters[:, :2] += np.tile(_QUARTERS * m.voxel_size, (len(middles), 1))
        reached = lattice_coordinates(apply(T, quarters), size, origin)
        away = apply(inverse(T), origin + reached * size) - np.repeat(middles, 4, axis=0)
        held = (np.abs(away[:, :2]) <= m.voxel_size / 2).all(axis=1)
        coords.append(reached[held])
    return in_morton_order(np.concatenate(coords))


def _viewpoints(
    placed: Sequence[Placed],
) -> NDArray[np.float32]:
    """Return all agents' viewpoints in the global level frame: (K, 3) float32, m."""
    parts = [apply(T, m.viewpoints.astype(np.float64)) for _, m, T in placed]
    return np.concatenate(parts).astype(np.float32)


def _empty(anchor: TopometricMap, frame_id: str | None) -> TopometricMap:
    """Return a global map of nothing, for agents that have seen nothing yet."""
    return TopometricMap(
        agent=GLOBAL,
        session=anchor.session,
        sequence=anchor.sequence,
        frame_id=anchor.frame_id if frame_id is None else frame_id,
        stamp=anchor.stamp,
        voxel_size=anchor.voxel_size,
        origin=anchor.origin,
        voxels=np.zeros((0, 3), dtype=np.int32),
        offsets=np.zeros((0, 3), dtype=np.int8),
        room=np.zeros(0, dtype=np.int32),
        navigable=np.zeros((0, 3), dtype=np.int32),
        viewpoints=np.zeros((0, 3), dtype=np.float32),
        T_level_input=anchor.T_level_input,
    )
