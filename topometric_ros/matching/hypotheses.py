"""Hypotheses grown from single matches along the topological graphs (thesis §4.3.6, eq. 53).

Starting at one match, the neighbours of both rooms are assigned to each other by their distance in
feature space, and so on from every match that joins. A match joins when its cost is at most c_max
and the mean error of the coarse registration does not rise by Δe_max or more.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.matching.assignment import assign
from topometric_ros.matching.config import GrowingConfig
from topometric_ros.matching.room_graph import RoomGraph

Match = tuple[int, int, float]
"""Row in map a, row in map b, distance in feature space."""


@dataclass(frozen=True)
class Hypothesis:
    """A consistent set of matches with one transform from b's level frame to a's.

    `error` (m) is the mean distance that the registered positions keep. The yaw of a hypothesis of
    one match is undetermined unless `yaw_known`; `T_a_b` then holds no turn.
    """

    matches: tuple[Match, ...]
    T_a_b: NDArray[np.float64]
    error: float
    yaw_known: bool

    @property
    def mean_distance(self) -> float:
        """Mean distance in feature space of the matched rooms."""
        return float(np.mean([distance for _, _, distance in self.matches]))


def register_positions(
    target: NDArray[np.float64],
    source: NDArray[np.float64],
    weights: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.float64], float]:
    """Return the least-squares turn about z and translation, and the mean distance left.

    Parameters
    ----------
    target, source : (n, 3) float64, m, n ≥ 1, corresponding positions
    weights : (n,), not negative and not all 0; None: all weigh alike

    Returns
    -------
    T_target_source : (4, 4) float64; no turn where all positions of one side coincide
    error : mean distance of the moved positions to their counterparts, m
    """
    middle_target = np.average(target, axis=0, weights=weights)
    middle_source = np.average(source, axis=0, weights=weights)
    p, q = target - middle_target, source - middle_source
    share = 1.0 if weights is None else weights
    # The yaw that maximises Σ pᵀ R q over rotations about z: Horn 1987 in the plane.
    cosine = float(np.sum(share * (p[:, 0] * q[:, 0] + p[:, 1] * q[:, 1])))
    sine = float(np.sum(share * (p[:, 1] * q[:, 0] - p[:, 0] * q[:, 1])))
    T = np.eye(4)
    length = np.hypot(cosine, sine)
    if length > 1e-12:
        T[:2, :2] = np.array([[cosine, -sine], [sine, cosine]]) / length
    T[:3, 3] = middle_target - T[:3, :3] @ middle_source
    moved = source @ T[:3, :3].T + T[:3, 3]
    return T, float(np.linalg.norm(moved - target, axis=1).mean())


def register_matches(
    matches: tuple[Match, ...], graph_a: RoomGraph, graph_b: RoomGraph, config: GrowingConfig
) -> Hypothesis:
    """Register the centroids of matched rooms and, if configured, what lies between them.

    A partial map shows half of a corridor, so centroids of rightly matched rooms may differ by
    metres, while a passage between two matched rooms is the same door in both maps. Where both maps
    know exactly one passage between two matched rooms it is registered too, and the heights of
    floors replace those of centroids.
    """
    rows_a, rows_b = [m[0] for m in matches], [m[1] for m in matches]
    target, source = graph_a.centroids[rows_a], graph_b.centroids[rows_b]
    if not config.passages:
        T, error = register_positions(target, source)
        return Hypothesis(matches, T, error, len(matches) > 1)
    target, source = target.copy(), source.copy()
    target[:, 2], source[:, 2] = graph_a.floors[rows_a], graph_b.floors[rows_b]
    doors_a, doors_b = _common_passages(matches, graph_a, graph_b)
    if len(doors_a):
        # Heights of passages are of the floor too, known only roughly on stairs: left to the rooms.
        level = target[:, 2].mean(), source[:, 2].mean()
        doors_a[:, 2], doors_b[:, 2] = level
        target, source = np.concatenate([target, doors_a]), np.concatenate([source, doors_b])
    T, error = register_positions(target, source)
    return Hypothesis(matches, T, error, len(matches) > 1)


def _common_passages(
    matches: tuple[Match, ...], graph_a: RoomGraph, graph_b: RoomGraph
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the passages between matched rooms that are single in both maps: (p, 3) each."""
    counterpart = {i: j for i, j, _ in matches}
    pairs_a, pairs_b = [], []
    for (i, k), positions in sorted(graph_a.passages.items()):
        if i in counterpart and k in counterpart and len(positions) == 1:
            j, m = sorted((counterpart[i], counterpart[k]))
            others = graph_b.passages.get((j, m))
            if others is not None and len(others) == 1:
                pairs_a.append(positions[0])
                pairs_b.append(others[0])
    return np.array(pairs_a).reshape(-1, 3), np.array(pairs_b).reshape(-1, 3)


def grow(
    seed: Match,
    cost: NDArray[np.float64],
    graph_a: RoomGraph,
    graph_b: RoomGraph,
    config: GrowingConfig,
) -> Hypothesis:
    """Grow one match into a hypothesis, breadth first, cheapest neighbours first.

    Parameters
    ----------
    seed : the first match; it stands whatever its cost
    cost : (R_a, R_b) float64, distances in feature space
    """
    hypothesis = register_matches((seed,), graph_a, graph_b, config)
    used_a, used_b = {seed[0]}, {seed[1]}
    front = deque([seed])
    while front:
        row_a, row_b, _ = front.popleft()
        near_a = [i for i in graph_a.neighbours[row_a] if i not in used_a]
        near_b = [j for j in graph_b.neighbours[row_b] if j not in used_b]
        for i, j, distance in assign(cost[np.ix_(near_a, near_b)]):
            match = (near_a[i], near_b[j], distance)
            if distance > config.cost_max:
                continue
            larger = register_matches((*hypothesis.matches, match), graph_a, graph_b, config)
            if larger.error - hypothesis.error >= config.error_increase_max:
                continue
            hypothesis = larger
            used_a.add(match[0])
            used_b.add(match[1])
            front.append(match)
    return hypothesis


def grow_all(
    cost: NDArray[np.float64],
    graph_a: RoomGraph,
    graph_b: RoomGraph,
    config: GrowingConfig,
    alone: float = np.inf,
) -> list[Hypothesis]:
    """Grow every initial match afresh: the assignment's and each room's nearest, if configured.

    `alone` is the distance from which on the assignment leaves rooms without a partner.
    """
    seeds = assign(cost, alone)
    if config.seeds_per_room:
        known = {(i, j) for i, j, _ in seeds}
        for i in range(len(graph_a)):
            for j in np.argsort(cost[i], kind="stable")[: config.seeds_per_room]:
                known.add((i, int(j)))
        seeds = sorted(
            ((i, j, float(cost[i, j])) for i, j in known), key=lambda s: (s[2], s[0], s[1])
        )
        seeds = [seed for seed in seeds if seed[2] <= config.cost_max]
    return [grow(seed, cost, graph_a, graph_b, config) for seed in seeds]
