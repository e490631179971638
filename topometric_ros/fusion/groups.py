"""From alignments of pairs to groups of agents in one frame each.

Accepted alignments are the links of a graph, and every cycle of it is a check that costs nothing.
Where the links of a cycle disagree, a robust pose graph finds the ones that the others speak
against; they are withdrawn. Where too few others speak, nobody can tell which link is wrong: then
every one that is hardly more confident than the one withdrawn goes too. What is left is averaged.
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
from topometric_ros.fusion.pose_graph import Link, Misfit, misfit, optimised, switched_on
from topometric_ros.fusion.poses import Transform, inverse


@dataclass(frozen=True)
class GroupsConfig:
    """How well the alignments round a cycle must agree."""

    cycle_distance: float = parameter(
        0.3,
        "Largest gap between an alignment and what the others make of it, read at the middle of "
        "the map.",
        unit="m",
        minimum=0.001,
    )
    cycle_angle: float = parameter(
        3.0,
        "Largest turn between an alignment and what the others make of it.",
        unit="deg",
        minimum=0.001,
        maximum=180.0,
    )
    cycle_margin: float = parameter(
        0.1,
        "Confidence by which an alignment that no other supports must exceed the one withdrawn "
        "from its cycle, or it is withdrawn too.",
        minimum=0.0,
        maximum=1.0,
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


@dataclass(frozen=True)
class _Agents:
    """What is known of the agents: the middle of each map and which way is up in its frame."""

    middles: Mapping[str, NDArray[np.float64]]
    levels: Mapping[str, Transform]
    by_hand: frozenset[tuple[str, str]]

    def level(self, agent: str) -> Transform:
        """Return the agent's T_level_input."""
        return self.levels.get(agent, np.eye(4))


def group_agents(
    agents: Sequence[str],
    alignments: Sequence[Alignment],
    config: GroupsConfig,
    fixed: frozenset[tuple[str, str]] = frozenset(),
    centres: Mapping[str, NDArray[np.float64]] | None = None,
    levels: Mapping[str, Transform] | None = None,
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
    levels : T_level_input of each agent; identity where missing
    """
    known = _Agents(centres or {}, levels or {}, fixed)
    alignments = list(alignments)
    order = {agent: k for k, agent in enumerate(agents)}
    group: dict[str, int] = {}
    placed: dict[str, Transform] = {}
    # Withdrawing may cut a group in two, each of which is then looked at by itself.
    waiting = [sorted(c, key=order.__getitem__) for c in _components(agents, alignments, known)]
    while waiting:
        members = waiting.pop()
        graph = _graph(members, alignments, known)
        poses, withdrawn = _solved(members, graph, alignments, config, known)
        for index, reason in withdrawn.items():
            alignments[index] = dataclasses.replace(
                alignments[index], status=AlignmentStatus.WITHDRAWN, reason=reason
            )
        parts = list(_components(members, alignments, known))
        if len(parts) > 1:
            waiting += [sorted(part, key=order.__getitem__) for part in parts]
            continue
        placed |= poses
        group |= dict.fromkeys(members, order[members[0]])
    numbers = {first: k for k, first in enumerate(sorted(set(group.values())))}
    return Groups(
        tuple(numbers[group[agent]] for agent in agents),
        tuple(placed[agent] for agent in agents),
        tuple(alignments),
    )


def _components(
    agents: Sequence[str], alignments: Sequence[Alignment], known: _Agents
) -> list[set[str]]:
    return list(nx.connected_components(_graph(agents, alignments, known)))


def _graph(agents: Sequence[str], alignments: Sequence[Alignment], known: _Agents) -> nx.Graph:
    """Return the graph of accepted alignments; of two for one pair the more confident."""
    graph = nx.Graph()
    graph.add_nodes_from(agents)
    for index, alignment in enumerate(alignments):
        a, b = alignment.agents
        if not alignment.accepted or alignment.T_a_b is None or a not in graph or b not in graph:
            continue
        weight = 2.0 if alignment.agents in known.by_hand else alignment.confidence
        if not graph.has_edge(a, b) or graph[a][b]["weight"] < weight:
            graph.add_edge(a, b, weight=weight, index=index)
    return graph


def _solved(
    members: Sequence[str],
    graph: nx.Graph,
    alignments: Sequence[Alignment],
    config: GroupsConfig,
    known: _Agents,
) -> tuple[dict[str, Transform], dict[int, str]]:
    """Place the agents of one component; also the alignments to withdraw, with the reasons."""
    edges = sorted(graph.edges, key=lambda edge: graph.edges[edge]["index"])
    tree = nx.maximum_spanning_tree(graph, weight="weight")
    poses = _chained(members, tree, alignments, known)
    withdrawn: dict[int, str] = {}
    if len(edges) >= len(members):
        links = [_link(members, alignments[graph.edges[e]["index"]], known) for e in edges]
        middles = np.array([known.middles.get(agent, np.zeros(3)) for agent in members])
        limits = (config.cycle_distance, np.radians(config.cycle_angle))
        # Many outvote one that is surer; between equals the surer one stays.
        trust = np.array([0.5 + min(graph.edges[e]["weight"], 1.0) for e in edges])
        belief = switched_on(poses, links, middles, limits, trust)
        for edge, weight in zip(edges, belief, strict=True):
            on = graph.edges[edge]["weight"] >= 2.0 or weight >= 0.5
            graph.edges[edge]["belief"] = graph.edges[edge]["weight"] + (4.0 if on else 0.0)
        voted = _chained(
            members, nx.maximum_spanning_tree(graph, weight="belief"), alignments, known
        )
        # The vote errs in lone cycles, the confidences where a wrong link is sure of itself: what
        # keeps more of the links is believed.
        answers = [_averaged(start, links, middles, limits) for start in (poses, voted)]
        kept = [trust[[m is None for m in misfits]].sum() for _, misfits in answers]
        poses, misfits = answers[int(np.argmax(kept))]
        wrong = {e: m for e, m in zip(edges, misfits, strict=True) if m is not None}
        withdrawn = _withdrawn(graph, wrong, alignments, config, known)
    to_input = inverse(known.level(members[0]))
    return {agent: to_input @ P for agent, P in zip(members, poses, strict=True)}, withdrawn


def _link(members: Sequence[str], alignment: Alignment, known: _Agents) -> Link:
    a, b = alignment.agents
    assert alignment.T_a_b is not None
    fixed = alignment.agents in known.by_hand
    numbers = members.index(a), members.index(b)
    return Link(*numbers, alignment.T_a_b, alignment.covariance, fixed)


def _chained(
    members: Sequence[str], tree: nx.Graph, alignments: Sequence[Alignment], known: _Agents
) -> list[Transform]:
    """Return each agent's pose in the level frame of the first, along the tree."""
    start = known.level(members[0])
    paths = nx.single_source_shortest_path(tree, members[0])
    poses = []
    for agent in members:
        T = start
        for a, b in pairwise(paths[agent]):
            alignment = alignments[tree[a][b]["index"]]
            assert alignment.T_a_b is not None
            T = T @ (alignment.T_a_b if alignment.agents == (a, b) else inverse(alignment.T_a_b))
        poses.append(T)
    return poses


def _averaged(
    poses: list[Transform],
    links: Sequence[Link],
    middles: NDArray[np.float64],
    limits: tuple[float, float],
) -> tuple[list[Transform], list[Misfit | None]]:
    """Average the links that agree with the poses; return the misfit of each that does not."""
    agreed: list[int] = []
    while True:
        found = [misfit(link, poses, middles) for link in links]
        near = [k for k, m in enumerate(found) if m.gap <= limits[0] and m.turn <= limits[1]]
        near = sorted({*near, *(k for k, link in enumerate(links) if link.fixed)})
        if near == agreed or set(near) < set(agreed):
            break
        agreed = near
        poses = optimised(poses, [links[k] for k in agreed], middles)
    return poses, [None if k in agreed else m for k, m in enumerate(found)]


def _withdrawn(
    graph: nx.Graph,
    wrong: Mapping[tuple[str, str], Misfit],
    alignments: Sequence[Alignment],
    config: GroupsConfig,
    known: _Agents,
) -> dict[int, str]:
    """Return the alignments to withdraw by index, with the reasons."""
    agreed = graph.copy()
    agreed.remove_edges_from(wrong)
    unsupported = {frozenset(edge) for edge in nx.bridges(agreed)}
    result: dict[int, str] = {}
    for (a, b), off in wrong.items():
        entry = graph.edges[a, b]
        path = nx.shortest_path(agreed, a, b) if nx.has_path(agreed, a, b) else [a, b]
        cycle = " - ".join([*path, a])
        result[entry["index"]] = (
            f"contradicts the cycle {cycle}: it is {off.gap:.2f} m and "
            f"{np.degrees(off.turn):.1f}° off what the others say, {config.cycle_distance:g} m and "
            f"{config.cycle_angle:g}° are allowed (confidence {entry['weight']:.2f})"
        )
        for edge in pairwise(path):
            other = graph.edges[edge]
            close = other["weight"] - entry["weight"] < config.cycle_margin
            if frozenset(edge) in unsupported and close and other["weight"] < 2.0:
                result.setdefault(
                    other["index"],
                    f"the cycle {cycle} does not close and nothing else tells which of its "
                    f"alignments is wrong; this one is hardly more confident "
                    f"({other['weight']:.2f}) than the least ({entry['weight']:.2f})",
                )
    return result
