"""Two agents' maps, their alignment and their matches against the truth: the columns of a pair."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.alignment import Alignment
from topometric_ros.evaluation.case import PairTruth
from topometric_ros.evaluation.metrics_fusion import (
    NO_OVERLAP,
    RIGHT,
    STRICTLY_RIGHT,
    transform_error,
)
from topometric_ros.evaluation.metrics_matching import (
    match_counts,
    one_to_one,
    right_by_counterpart,
    right_by_overlap,
)
from topometric_ros.evaluation.metrics_rooms import RoomOverlap, room_overlap
from topometric_ros.fusion.poses import apply, inverse
from topometric_ros.matching.assignment import assign
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.matching.propose import propose_from_rooms, room_distances, with_large_rooms
from topometric_ros.simulation.case import SimulatedAgent
from topometric_ros.topometric_map import TopometricMap

EVERY = 97
"""Displacements are measured on every so many of b's points, as `check/score.py` does."""

TRUE_REACH = 2.0
"""A voxel has the true room of a labelled point within this many voxel edges."""

Pair = tuple[int, int]


@dataclass(frozen=True)
class ScoredAgent:
    """An agent's map with the truth.

    `tree` is of the agent's points, `true_room` (N,) int32 of the map's voxels, `overlap` of the
    map's rooms with the true ones.
    """

    agent: SimulatedAgent
    map: TopometricMap
    tree: cKDTree
    true_room: NDArray[np.int32]
    overlap: RoomOverlap


def scored_agent(agent: SimulatedAgent, m: TopometricMap) -> ScoredAgent:
    """Give every voxel of an agent's map the true room of the nearest point of its cloud."""
    tree = cKDTree(agent.points)
    centres = apply(inverse(m.T_level_input), m.centres())
    reach = TRUE_REACH * m.voxel_size
    distance, nearest = tree.query(centres, distance_upper_bound=reach)
    near = np.isfinite(distance)
    true = np.full(len(centres), -1, dtype=np.int32)
    true[near] = agent.room[nearest[near]]
    return ScoredAgent(agent, m, tree, true, room_overlap(true, m.room))


def score_pair(
    a: ScoredAgent,
    b: ScoredAgent,
    truth: PairTruth,
    alignment: Alignment,
    matching: MatchingConfig,
    rooms: bool,
) -> dict[str, float]:
    """Return the columns of `CaseResult` that a pair of agents has; matches only with `rooms`."""
    columns = _fusion(b, truth, alignment)
    return columns | (_matching(a, b, alignment, matching) if rooms else {})


def matches_by_stage(
    a: TopometricMap, b: TopometricMap, alignment: Alignment, config: MatchingConfig
) -> dict[str, list[Pair]]:
    """Return the matches that each stage made, as pairs of room ids.

    `assigned`: by the descriptors alone (thesis eq. 52). `grown`: the best hypothesis, believed or
    not (§4.3.6). `final`: of the accepted alignment.
    """
    large_a, large_b = (with_large_rooms(m, config.smallest_room) for m in (a, b))
    cost = room_distances(large_a, large_b, config)
    candidates = propose_from_rooms(a, b, config)
    grown = candidates[0].matches if candidates else ()
    final = alignment.matches if alignment.accepted else ()
    return {
        "assigned": [
            (large_a.rooms[i].id, large_b.rooms[j].id) for i, j, _ in assign(cost, config.alone)
        ],
        "grown": [(match.room_a, match.room_b) for match in grown],
        "final": [(match.room_a, match.room_b) for match in final],
    }


def _fusion(b: ScoredAgent, truth: PairTruth, alignment: Alignment) -> dict[str, float]:
    """Return the columns of the transform."""
    nan = float("nan")
    columns = {
        "overlap": truth.overlap,
        "accepted": float(alignment.accepted),
        "confidence": float(alignment.confidence),
        **dict.fromkeys(("displacement", "angle", "nearest"), nan),
        **dict.fromkeys(("right", "strict"), 0.0),
    }
    if not alignment.accepted or alignment.T_a_b is None or truth.T_a_b is None:
        return columns
    error = transform_error(alignment.T_a_b, truth.T_a_b, b.agent.points[::EVERY], b.tree)
    allowed = truth.overlap >= NO_OVERLAP
    return columns | {
        "displacement": error.displacement,
        "angle": error.angle,
        "nearest": error.nearest,
        "right": float(allowed and error.within(RIGHT)),
        "strict": float(allowed and error.within(STRICTLY_RIGHT)),
    }


def _matching(
    a: ScoredAgent, b: ScoredAgent, alignment: Alignment, config: MatchingConfig
) -> dict[str, float]:
    """Return the columns of the matches at each stage, in both forms."""
    strict = right_by_counterpart(a.overlap, b.overlap)
    loose = right_by_overlap(a.overlap, b.overlap)
    rooms = len(a.overlap.found_ids), len(b.overlap.found_ids)
    columns = {
        "room_pairs": float(rooms[0] * rooms[1]),
        "possible": float(len(strict)),
        "possible_overlap": float(len(loose)),
    }
    for stage, matches in matches_by_stage(a.map, b.map, alignment, config).items():
        # §5.3 knows of one room to one only; further pieces of a room count by overlap.
        counts = match_counts(one_to_one(matches), strict, *rooms)
        overlapping = match_counts(matches, loose, *rooms)
        columns[stage] = float(counts.made)
        columns[f"{stage}_overlap"] = float(overlapping.made)
        columns[f"{stage}_right"] = float(counts.right)
        columns[f"{stage}_right_overlap"] = float(overlapping.right)
    return columns
