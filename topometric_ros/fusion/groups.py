"""From alignments of pairs to groups of agents in one frame each.

Accepted alignments are the edges of a graph. A spanning tree of the most confident ones carries the
transforms; every other edge closes a cycle and must agree with the chain round it. Where one does
not, something in the cycle is wrong, and its least confident edge is withdrawn.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.configuration import parameter
from topometric_ros.fusion.poses import Transform, angle, apply, inverse


@dataclass(frozen=True)
class GroupsConfig:
    """How well the alignments round a cycle must agree."""

    cycle_distance: float = parameter(
        0.3,
        "Largest gap at the end of a cycle of three; each further edge allows a third of it more.",
        unit="m",
        minimum=0.0,
    )
    cycle_angle: float = parameter(
        3.0, "Largest turn left at the end of a cycle.", unit="degree", minimum=0.0, maximum=180.0
    )


@dataclass(frozen=True)
class Groups:
    """Which agents share a frame.

    `group` holds a number for each agent, counted by each group's first agent; `T_group_agent` the
    transform of each agent into the input frame of the first agent of its group. `alignments` are
    those given, some withdrawn.
    """

    group: tuple[int, ...]
    T_group_agent: tuple[Transform, ...]
    alignments: tuple[Alignment, ...]


def group_agents(
    agents: Sequence[str],
    alignments: Sequence[Alignment],
    config: GroupsConfig,
    fixed: frozenset[tuple[str, str]] = frozenset(),
    centres: Mapping[str, NDArray[np.float64]] | None = None,
) -> Groups:
    """Group agents by their accepted alignments.

    Parameters
    ----------
    agents : ids in order; the first of each group gives its frame
    alignments : of pairs of them; only accepted ones join
    config : GroupsConfig
    fixed : pairs set by hand, which are never withdrawn
    centres : middle of each agent's map (3,), m, its own input frame, where the gap at the end of a
        cycle is read; at the origin of the frame a turn would count by its distance from the map
    """
    alignments = list(alignments)
    while True:
        graph = _graph(agents, alignments, fixed)
        tree = nx.maximum_spanning_tree(graph, weight="weight")
        withdrawn = _contradiction(graph, tree, alignments, config, fixed, centres or {})
        if withdrawn is None:
            return _placed(agents, tree, alignments)
        index, reason = withdrawn
        alignments[index] = dataclasses.replace(
            alignments[index], status=AlignmentStatus.WITHDRAWN, reason=reason
        )


def _graph(
    agents: Sequence[str], alignments: Sequence[Alignment], fixed: frozenset[tuple[str, str]]
) -> nx.Graph:
    """Return the graph of accepted alignments; of two for one pair the more confident."""
    graph = nx.Graph()
    graph.add_nodes_from(agents)
    for index, alignment in enumerate(alignments):
        if not alignment.accepted or alignment.T_a_b is None:
            continue
        weight = 2.0 if alignment.agents in fixed else alignment.confidence
        a, b = alignment.agents
        if not graph.has_edge(a, b) or graph[a][b]["weight"] < weight:
            graph.add_edge(a, b, weight=weight, index=index)
    return graph


def _chain(tree: nx.Graph, alignments: Sequence[Alignment], path: Sequence[str]) -> Transform:
    """Return the transform from the last agent of a path to the first."""
    T = np.eye(4)
    for a, b in pairwise(path):
        alignment = alignments[tree[a][b]["index"]]
        assert alignment.T_a_b is not None
        T = T @ (alignment.T_a_b if alignment.agents == (a, b) else inverse(alignment.T_a_b))
    return T


def _contradiction(
    graph: nx.Graph,
    tree: nx.Graph,
    alignments: Sequence[Alignment],
    config: GroupsConfig,
    fixed: frozenset[tuple[str, str]],
    centres: Mapping[str, NDArray[np.float64]],
) -> tuple[int, str] | None:
    """Return the edge to withdraw and why, or None where every cycle closes."""
    for a, b in sorted(graph.edges):
        if tree.has_edge(a, b):
            continue
        path = nx.shortest_path(tree, a, b)
        direct = _chain(graph, alignments, [a, b])
        left = inverse(_chain(tree, alignments, path)) @ direct
        centre = centres.get(b, np.zeros(3))
        gap = float(np.linalg.norm(apply(left, centre) - centre))
        turn = float(np.degrees(angle(left)))
        allowed = config.cycle_distance * max(3, len(path)) / 3
        if gap <= allowed and turn <= config.cycle_angle:
            continue
        ring = [*pairwise(path), (a, b)]
        loose = [
            edge for edge in ring if alignments[graph.edges[edge]["index"]].agents not in fixed
        ]
        if not loose:
            continue
        weakest = min(loose, key=lambda edge: (graph.edges[edge]["weight"], -ring.index(edge)))
        reason = (
            f"contradicts the cycle {' - '.join([*path, a])}: it ends {gap:.2f} m and {turn:.1f}° "
            f"off, {allowed:.2f} m and {config.cycle_angle:g}° are allowed, and this is its least "
            f"confident alignment ({alignment_confidence(alignments, graph, weakest):.2f})"
        )
        return graph.edges[weakest]["index"], reason
    return None


def alignment_confidence(
    alignments: Sequence[Alignment], graph: nx.Graph, edge: tuple[str, str]
) -> float:
    """Return the confidence of the alignment that an edge of the graph stands for."""
    return alignments[graph.edges[edge]["index"]].confidence


def _placed(agents: Sequence[str], tree: nx.Graph, alignments: Sequence[Alignment]) -> Groups:
    """Number the groups by their first agents and chain the transforms to those."""
    group: dict[str, int] = {}
    placed: dict[str, Transform] = {}
    number = 0
    for first in agents:
        if first in group:
            continue
        for agent, path in nx.single_source_shortest_path(tree, first).items():
            group[agent] = number
            placed[agent] = _chain(tree, alignments, path)
        number += 1
    return Groups(
        tuple(group[agent] for agent in agents),
        tuple(placed[agent] for agent in agents),
        tuple(alignments),
    )
