"""The graph of agents that accepted alignments and priors make, and its links in the pose graph.

Nodes are agents, and the outer frames in which two agents or more have a prior. An edge holds
`of`, the nodes (a, b), and `T`, the transform T_a_b; `weight`, what it counts among confidences;
the `index` of its alignment or the `prior`; and `first`, by which it comes into the first tree.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import Alignment
from topometric_ros.fusion.pose_graph import Link
from topometric_ros.fusion.poses import Transform, inverse
from topometric_ros.fusion.priors import Prior

BY_HAND = 2.0
"""What an alignment that was set by hand counts among confidences."""

BY_PRIOR = 1.0
"""What a prior counts among them."""


@dataclass(frozen=True)
class KnownAgents:
    """What is known of the agents: the middle of each map and which way is up in its frame."""

    middles: Mapping[str, NDArray[np.float64]]
    levels: Mapping[str, Transform]
    by_hand: frozenset[tuple[str, str]]
    priors: Sequence[Prior]

    def level(self, agent: str) -> Transform:
        """Return the agent's T_level_input."""
        return self.levels.get(agent, np.eye(4))


def alignment_graph(
    agents: Sequence[str], alignments: Sequence[Alignment], known: KnownAgents
) -> nx.Graph:
    """Return the graph of accepted alignments; of two for one pair the more confident."""
    graph = nx.Graph()
    graph.add_nodes_from(agents)
    for index, alignment in enumerate(alignments):
        a, b = alignment.agents
        if not alignment.accepted or alignment.T_a_b is None or a not in graph or b not in graph:
            continue
        weight = BY_HAND if alignment.agents in known.by_hand else alignment.confidence
        if not graph.has_edge(a, b) or graph[a][b]["weight"] < weight:
            told = {"of": (a, b), "T": alignment.T_a_b, "first": weight}
            graph.add_edge(a, b, weight=weight, index=index, **told)
    return graph


def add_priors(graph: nx.Graph, priors: Sequence[Prior]) -> list[Prior]:
    """Add priors between a component's agents to its graph; return those beside an alignment.

    An outer frame becomes a node where two agents or more have a prior in it.
    """
    agents = set(graph)
    own = [p for p in priors if p.source in agents]
    frames = [target for target, _ in dict.fromkeys((p.target, p.source) for p in own)]
    beside = []
    for prior in own:
        if prior.target not in agents and frames.count(prior.target) < 2:
            continue
        if graph.has_edge(prior.target, prior.source):
            beside.append(prior)
            continue
        told = {"of": (prior.target, prior.source), "T": prior.T, "first": -1.0}
        graph.add_edge(prior.target, prior.source, weight=BY_PRIOR, prior=prior, **told)
    return beside


def link_of(
    nodes: Sequence[str],
    entry: Mapping[str, Any],
    alignments: Sequence[Alignment],
    known: KnownAgents,
) -> Link:
    """Return an edge of the graph as a link of the pose graph."""
    if "prior" in entry:
        return link_of_prior(nodes, entry["prior"])
    a, b = entry["of"]
    fixed = (a, b) in known.by_hand
    covariance = alignments[entry["index"]].covariance
    return Link(nodes.index(a), nodes.index(b), entry["T"], covariance, fixed)


def link_of_prior(nodes: Sequence[str], prior: Prior) -> Link:
    """Return a prior as a link of the pose graph."""
    ends = nodes.index(prior.target), nodes.index(prior.source)
    return Link(*ends, prior.T, prior.covariance, prior=True)


def chained(nodes: Sequence[str], tree: nx.Graph, known: KnownAgents) -> list[Transform]:
    """Return each node's pose in the level frame of the first, along the tree."""
    start = known.level(nodes[0])
    paths = nx.single_source_shortest_path(tree, nodes[0])
    poses = []
    for node in nodes:
        T = start
        for a, b in pairwise(paths[node]):
            entry = tree[a][b]
            T = T @ (entry["T"] if entry["of"] == (a, b) else inverse(entry["T"]))
        poses.append(T)
    return poses
