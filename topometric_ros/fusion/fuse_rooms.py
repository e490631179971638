"""Rooms and passages of several maps as one topological graph (thesis §4.4, second paragraph).

The draft merges one room with its one match. Where segmentations differ a room of one map covers
several of the other, so every chain of rooms that cover each other by enough becomes one room.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from topometric_ros.fusion.poses import Transform, apply
from topometric_ros.topometric_map import Passage, TopometricMap, triple
from topometric_ros.voxels.morton import morton_encode

_STRIDE = 10_000
"""Rooms of the i-th agent that the anchor does not know get the ids from i times this on."""

RoomKey = tuple[int, int]
"""Index of an agent and a room's id in its map."""


@dataclass(frozen=True)
class Fragment:
    """One agent's part of the global map.

    `agent` is its index in the result, `T` (4, 4) its level frame's transform to the global level
    frame, `rows` (N,) the fused voxel of each of its voxels, `storey_of` the fused id of a storey.
    """

    agent: int
    map: TopometricMap
    T: Transform
    rows: NDArray[np.int64]
    storey_of: dict[int, int]


def room_ids(
    fragments: Sequence[Fragment], coords: NDArray[np.int32], room_overlap: float
) -> dict[RoomKey, int]:
    """Return the id in the global map of every agent's every room.

    A room that the anchor knows keeps the anchor's id; any other gets its first agent's id plus a
    multiple of 10,000 by agent. So ids last as long as the agents' own do, whatever else grows.

    Parameters
    ----------
    coords : (n, 3) int32, the fused voxels that the fragments' rows name
    room_overlap : share of the smaller room's cells, two voxels wide, that makes two rooms one.
        Cells of one voxel would miss each other by rounding.
    """
    codes = morton_encode(np.floor_divide(coords, 2))
    covers = [_cells(fragment, codes) for fragment in fragments]
    graph = nx.Graph()
    for fragment in fragments:
        graph.add_nodes_from((fragment.agent, room.id) for room in fragment.map.rooms)
    for j, later in enumerate(fragments):
        for i, earlier in enumerate(fragments[:j]):
            for room_i, room_j in _covering(covers[i], covers[j], room_overlap):
                graph.add_edge((earlier.agent, room_i), (later.agent, room_j))
    largest = max((room.id for f in fragments for room in f.map.rooms), default=0)
    stride = _STRIDE
    while stride <= largest:
        stride *= 10
    ids: dict[RoomKey, int] = {}
    for members in nx.connected_components(graph):
        agent, room = min(members)
        ids.update((member, agent * stride + room) for member in members)
    return ids


def rooms_by_id(ids: dict[RoomKey, int], known: set[int]) -> dict[int, tuple[RoomKey, ...]]:
    """Return which agents' rooms became each room that has voxels: `room_ids` the other way."""
    return {
        number: tuple(sorted(key for key, new in ids.items() if new == number))
        for number in sorted(known)
    }


def _cells(
    fragment: Fragment, codes: NDArray[np.uint64]
) -> tuple[NDArray[np.uint64], NDArray[np.int32]]:
    """Return the distinct coarse cells that an agent gave a room, and that room of each."""
    known = np.flatnonzero(fragment.map.room >= 0)
    cells, first = np.unique(codes[fragment.rows[known]], return_index=True)
    return cells, fragment.map.room[known[first]]


def _covering(
    one: tuple[NDArray[np.uint64], NDArray[np.int32]],
    other: tuple[NDArray[np.uint64], NDArray[np.int32]],
    room_overlap: float,
) -> list[tuple[int, int]]:
    """Return the pairs of rooms of two agents that share enough of the smaller's cells."""
    _, in_one, in_other = np.intersect1d(one[0], other[0], assume_unique=True, return_indices=True)
    if len(in_one) == 0:
        return []
    pairs = np.stack([one[1][in_one], other[1][in_other]], axis=1)
    distinct, counts = np.unique(pairs, axis=0, return_counts=True)
    size_one = dict(zip(*(x.tolist() for x in np.unique(one[1], return_counts=True)), strict=True))
    size_other = dict(
        zip(*(x.tolist() for x in np.unique(other[1], return_counts=True)), strict=True)
    )
    return [
        (int(a), int(b))
        for (a, b), count in zip(distinct.tolist(), counts.tolist(), strict=True)
        if count >= room_overlap * min(size_one[a], size_other[b])
    ]


def fused_passages(
    fragments: Sequence[Fragment],
    ids: dict[RoomKey, int],
    known: set[int],
    distance: float,
) -> tuple[Passage, ...]:
    """Return the passages between different rooms that have voxels; near ones of a pair are one.

    A merged passage lies at the mean position and is as wide as the widest; its kind and height
    are those of the surest one whose kind was told, its confidence is the highest.
    """
    clusters: dict[tuple[int, int], list[list[Passage]]] = {}
    for fragment in fragments:
        for passage in fragment.map.passages:
            first, second = sorted(ids[fragment.agent, room] for room in passage.rooms)
            if first == second or not {first, second} <= known:
                continue
            position = apply(fragment.T, np.array([passage.position]))[0]
            moved = replace(passage, rooms=(first, second), position=triple(position))
            same_pair = clusters.setdefault((first, second), [])
            for cluster in same_pair:
                if np.linalg.norm(position - cluster[0].position) <= distance:
                    cluster.append(moved)
                    break
            else:
                same_pair.append([moved])
    return tuple(_merged(cluster) for pair in sorted(clusters) for cluster in clusters[pair])


def _merged(cluster: Sequence[Passage]) -> Passage:
    """Return several agents' passage as one."""
    surest = max(cluster, key=lambda passage: (passage.kind != "unknown", passage.confidence))
    return replace(
        surest,
        position=triple(np.mean([passage.position for passage in cluster], axis=0)),
        width=max(passage.width for passage in cluster),
        confidence=max(passage.confidence for passage in cluster),
    )


def storeys_of_rooms(
    fragments: Sequence[Fragment], ids: dict[RoomKey, int], known: set[int]
) -> dict[int, int]:
    """Return the fused storey of each room that has voxels: that of its first agent."""
    storey_of: dict[int, int] = {}
    for fragment in fragments:
        for old in fragment.map.rooms:
            number = ids[fragment.agent, old.id]
            if number in known:
                storey_of.setdefault(number, fragment.storey_of[old.storey])
    return storey_of
