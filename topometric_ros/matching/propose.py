"""From two maps' rooms to candidate poses: describe, embed, assign, grow, choose (thesis §4.3)."""

from __future__ import annotations

import dataclasses
import logging

import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import RoomMatch
from topometric_ros.matching.assignment import cost_matrix
from topometric_ros.matching.candidate import Candidate
from topometric_ros.matching.choice import choose, displacement
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.matching.context import embed_pair
from topometric_ros.matching.hypotheses import Hypothesis, grow_all, register_positions
from topometric_ros.matching.room_graph import RoomGraph, room_graph
from topometric_ros.topometric_map import NO_ROOM, TopometricMap

logger = logging.getLogger(__name__)


def propose_from_rooms(
    a: TopometricMap, b: TopometricMap, config: MatchingConfig
) -> list[Candidate]:
    """Propose poses of map b in map a from matched rooms, best first.

    The score is the number of matches, and for ties 1 / (2 + mean distance).

    Returns
    -------
    list of Candidate, level frame of b to level frame of a; empty where a map has no rooms
    """
    a, b = with_large_rooms(a, config.smallest_room), with_large_rooms(b, config.smallest_room)
    if not (a.rooms and b.rooms):
        return []
    graph_a, graph_b = room_graph(a), room_graph(b)
    cost = cost_matrix(*embed_pair(a, b, config))
    hypotheses = grow_all(cost, graph_a, graph_b, config.growing, config.alone)
    candidates: list[Candidate] = []
    for hypothesis in choose(hypotheses, graph_a, graph_b, config.growing, config.choice):
        for T_a_b in _poses(hypothesis, graph_a, graph_b, config):
            if len(candidates) == config.choice.candidates:
                return candidates
            if all(
                displacement(T_a_b, c.T_a_b, graph_b.centroids) > config.choice.distance
                for c in candidates
            ):
                candidates.append(_candidate(hypothesis, T_a_b, graph_a, graph_b))
    logger.debug("%d rooms and %d: %d candidates", len(graph_a), len(graph_b), len(candidates))
    return candidates


def with_large_rooms(topometric_map: TopometricMap, smallest: float) -> TopometricMap:
    """Return the map without the rooms that cover less than `smallest` m² (shreds match shreds)."""
    keep = [row for row, room in enumerate(topometric_map.rooms) if room.area >= smallest]
    if len(keep) == len(topometric_map.rooms):
        return topometric_map
    ids = {topometric_map.rooms[row].id for row in keep}
    known = np.isin(topometric_map.room, sorted(ids))
    return dataclasses.replace(
        topometric_map,
        rooms=tuple(topometric_map.rooms[row] for row in keep),
        room=np.where(known, topometric_map.room, NO_ROOM).astype(np.int32),
        passages=tuple(p for p in topometric_map.passages if set(p.rooms) <= ids),
        descriptors=tuple(
            dataclasses.replace(d, values=d.values[keep]) for d in topometric_map.descriptors
        ),
    )


def room_distances(
    a: TopometricMap, b: TopometricMap, config: MatchingConfig
) -> NDArray[np.float64]:
    """Return the distance in feature space of every pair of rooms: (R_a, R_b) float64."""
    if not (a.rooms and b.rooms):
        return np.zeros((len(a.rooms), len(b.rooms)))
    return cost_matrix(*embed_pair(a, b, config))


def _candidate(
    hypothesis: Hypothesis, T_a_b: NDArray[np.float64], graph_a: RoomGraph, graph_b: RoomGraph
) -> Candidate:
    matches = tuple(RoomMatch(graph_a.ids[i], graph_b.ids[j], d) for i, j, d in hypothesis.matches)
    return Candidate(T_a_b, "rooms", len(matches) + 1 / (2 + hypothesis.mean_distance), matches)


def _poses(
    hypothesis: Hypothesis, graph_a: RoomGraph, graph_b: RoomGraph, config: MatchingConfig
) -> list[NDArray[np.float64]]:
    """Return the pose of a hypothesis; of a single match one pose for each way doors can meet.

    One pair of centroids leaves the yaw open. The directions from the centroid to the room's
    passages close it: each pair of passages, one in each map, gives a pose. The rule `thesis` keeps
    the draft's registration of centroids, which then turns nothing.
    """
    if hypothesis.yaw_known or config.choice.rule == "thesis":
        return [hypothesis.T_a_b]
    i, j, _ = hypothesis.matches[0]
    ways: list[tuple[float, int, NDArray[np.float64]]] = []
    for door_a in graph_a.passages_of(i):
        for door_b in graph_b.passages_of(j):
            target = np.stack([graph_a.centroids[i], door_a])
            source = np.stack([graph_b.centroids[j], door_b])
            target[:, 2], source[:, 2] = graph_a.floors[i], graph_b.floors[j]
            T_a_b, error = register_positions(target, source)
            ways.append((error, len(ways), T_a_b))
    return [T_a_b for _, _, T_a_b in sorted(ways, key=lambda way: way[:2])]
