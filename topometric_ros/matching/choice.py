"""Choosing among hypotheses: compatible, similar, clustered, largest (thesis §4.3.6).

Two hypotheses are compatible unless they match one room to two, and similar where their transforms
are near (Huang & Beevers 2005).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.matching.config import ChoiceConfig, GrowingConfig
from topometric_ros.matching.hypotheses import Hypothesis, register_matches
from topometric_ros.matching.room_graph import RoomGraph

_INFINITE = 1e9
"""Metres between incompatible hypotheses: beyond every building, yet a number that OPTICS takes."""


def compatible(one: Hypothesis, other: Hypothesis) -> bool:
    """Return whether no room of either map is matched to two different rooms."""
    forward = {i: j for i, j, _ in one.matches}
    backward = {j: i for i, j, _ in one.matches}
    return all(forward.get(i, j) == j and backward.get(j, i) == i for i, j, _ in other.matches)


def displacement(
    one: NDArray[np.float64], other: NDArray[np.float64], positions: NDArray[np.float64]
) -> float:
    """Return how far apart two transforms put positions (n, 3), on average, in metres."""
    difference = one - other
    moved = positions @ difference[:3, :3].T + difference[:3, 3]
    return float(np.linalg.norm(moved, axis=1).mean())


def order(hypothesis: Hypothesis) -> tuple[float, ...]:
    """Sort key: most matches first, ties by the lowest mean distance in feature space."""
    first = hypothesis.matches[0]
    return (-len(hypothesis.matches), hypothesis.mean_distance, first[0], first[1])


def choose(
    hypotheses: list[Hypothesis],
    graph_a: RoomGraph,
    graph_b: RoomGraph,
    growing: GrowingConfig,
    config: ChoiceConfig,
) -> list[Hypothesis]:
    """Return the hypotheses to check, best first.

    Under the rule `thesis` at most one: the hypotheses that OPTICS puts into one cluster become one
    and the largest of all is chosen. Under `many` the best distinct ones.
    """
    if config.rule == "thesis":
        merged = _merge_clusters(hypotheses, graph_a, graph_b, growing, config)
        return sorted(merged, key=order)[:1]
    return sorted(hypotheses, key=order)


def _merge_clusters(
    hypotheses: list[Hypothesis],
    graph_a: RoomGraph,
    graph_b: RoomGraph,
    growing: GrowingConfig,
    config: ChoiceConfig,
) -> list[Hypothesis]:
    """Return one hypothesis for each cluster and every one that belongs to none."""
    if len(hypotheses) < 2:
        return hypotheses
    from sklearn.cluster import OPTICS

    n = len(hypotheses)
    distances = np.zeros((n, n))
    for i in range(n):
        for j in range(i):
            near = compatible(hypotheses[i], hypotheses[j])
            apart = displacement(hypotheses[i].T_a_b, hypotheses[j].T_a_b, graph_b.centroids)
            distances[i, j] = distances[j, i] = apart if near else _INFINITE
    np.fill_diagonal(distances, _INFINITE)
    if distances.min() > config.distance:
        return hypotheses  # nothing is similar, which OPTICS would warn of
    np.fill_diagonal(distances, 0.0)
    clustering = OPTICS(
        min_samples=2,
        metric="precomputed",
        max_eps=config.distance,
        cluster_method="dbscan",
        eps=config.distance,
    )
    with np.errstate(divide="ignore", invalid="ignore"):
        labels = clustering.fit(distances).labels_
    merged = [h for h, label in zip(hypotheses, labels, strict=True) if label < 0]
    for label in range(labels.max() + 1):
        members = [h for h, own in zip(hypotheses, labels, strict=True) if own == label]
        merged.append(_union(members, graph_a, graph_b, growing))
    return merged


def _union(
    members: list[Hypothesis], graph_a: RoomGraph, graph_b: RoomGraph, config: GrowingConfig
) -> Hypothesis:
    """Return the hypothesis of all members' matches; where two contradict, the nearer one's."""
    candidates = {(i, j): d for h in members for i, j, d in h.matches}
    used_a: set[int] = set()
    used_b: set[int] = set()
    matches = []
    for (i, j), distance in sorted(candidates.items(), key=lambda item: (item[1], item[0])):
        if i not in used_a and j not in used_b:
            matches.append((i, j, distance))
            used_a.add(i)
            used_b.add(j)
    return register_matches(tuple(matches), graph_a, graph_b, config)
