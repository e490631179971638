"""From alignments of pairs to groups of agents in one frame each.

Accepted alignments are the links of a graph, and every cycle of it is a check that costs nothing.
Where the links of a cycle disagree, a robust pose graph finds the ones that the others speak
against; they are withdrawn. Where too few others speak, nobody can tell which link is wrong: then
every one that is hardly more confident than the one withdrawn goes too. What is left is averaged.

Priors join nobody, but between agents that alignments join they are edges like any other: they
close cycles, and weigh by their covariance. One that the alignments outvote is left out.
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
from topometric_ros.fusion.agent_graph import (
    BY_HAND,
    BY_PRIOR,
    KnownAgents,
    add_priors,
    alignment_graph,
    chained,
    link_of,
    link_of_prior,
)
from topometric_ros.fusion.pose_graph import (
    Link,
    Misfit,
    agrees,
    misfit,
    optimised,
    switched_on,
)
from topometric_ros.fusion.poses import Transform, inverse
from topometric_ros.fusion.priors import Prior


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


def group_agents(
    agents: Sequence[str],
    alignments: Sequence[Alignment],
    config: GroupsConfig,
    fixed: frozenset[tuple[str, str]] = frozenset(),
    centres: Mapping[str, NDArray[np.float64]] | None = None,
    levels: Mapping[str, Transform] | None = None,
    priors: Sequence[Prior] = (),
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
    priors : of pairs of agents, and of agents in outer frames
    """
    known = KnownAgents(centres or {}, levels or {}, fixed, priors)
    alignments = list(alignments)
    order = {agent: k for k, agent in enumerate(agents)}
    group: dict[str, int] = {}
    placed: dict[str, Transform] = {}
    # Withdrawing may cut a group in two, each of which is then looked at by itself.
    waiting = [sorted(c, key=order.__getitem__) for c in _components(agents, alignments, known)]
    while waiting:
        members = waiting.pop()
        graph = alignment_graph(members, alignments, known)
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
    agents: Sequence[str], alignments: Sequence[Alignment], known: KnownAgents
) -> list[set[str]]:
    return list(nx.connected_components(alignment_graph(agents, alignments, known)))


def _solved(
    members: Sequence[str],
    graph: nx.Graph,
    alignments: Sequence[Alignment],
    config: GroupsConfig,
    known: KnownAgents,
) -> tuple[dict[str, Transform], dict[int, str]]:
    """Place the agents of one component; also the alignments to withdraw, with the reasons."""
    edges = sorted(graph.edges, key=lambda edge: graph.edges[edge]["index"])
    beside = add_priors(graph, known.priors)
    edges += [graph.edges[e]["of"] for e in graph.edges if "prior" in graph.edges[e]]
    nodes = [*members, *(node for node in graph if node not in members)]
    poses = chained(nodes, nx.maximum_spanning_tree(graph, weight="first"), known)
    withdrawn: dict[int, str] = {}
    links = [link_of(nodes, graph.edges[edge], alignments, known) for edge in edges]
    links += [link_of_prior(nodes, prior) for prior in beside]
    if len(links) >= len(nodes):
        middles = np.array([known.middles.get(node, np.zeros(3)) for node in nodes])
        limits = (config.cycle_distance, float(np.radians(config.cycle_angle)))
        # Many outvote one that is surer; between equals the surer one stays.
        weights = [graph.edges[edge]["weight"] for edge in edges] + [BY_PRIOR] * len(beside)
        trust = 0.5 + np.minimum(weights, 1.0)
        belief = switched_on(poses, links, middles, limits, trust)[: len(edges)]
        _believe(graph, dict(zip(edges, belief.tolist(), strict=True)))
        # The vote errs in lone cycles, the confidences where a wrong link is sure of itself: what
        # keeps more of the links is believed.
        trees = [nx.maximum_spanning_tree(graph, weight=key) for key in ("belief", "weight")]
        starts = [poses, *(chained(nodes, tree, known) for tree in trees)]
        answers = [_averaged(start, links, middles, limits) for start in starts]
        kept = [trust[[m is None for m in misfits]].sum() for _, misfits in answers]
        poses, misfits = answers[int(np.argmax(kept))]
        wrong = {e: m for e, m in zip(edges, misfits[: len(edges)], strict=True) if m is not None}
        withdrawn = _withdrawn(graph, wrong, config)
    to_input = inverse(known.level(members[0]))
    placed = zip(members, poses[: len(members)], strict=True)
    return {agent: to_input @ P for agent, P in placed}, withdrawn


def _believe(graph: nx.Graph, weights: Mapping[tuple[str, str], float]) -> None:
    """Say of each edge how willingly it is followed: alignments before priors, if switched on."""
    for edge, weight in weights.items():
        entry = graph.edges[edge]
        on = entry["weight"] >= BY_HAND or weight >= 0.5
        if "prior" in entry:
            entry["belief"] = 1.5 if on else 0.0
        else:
            entry["belief"] = entry["weight"] + (4.0 if on else 0.0)


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
        near = [k for k, link in enumerate(links) if agrees(link, poses, middles, limits)]
        near = sorted({*near, *(k for k, link in enumerate(links) if link.fixed)})
        if near == agreed or set(near) < set(agreed):
            break
        agreed = near
        poses = optimised(poses, [links[k] for k in agreed], middles)
    return poses, [None if k in agreed else m for k, m in enumerate(found)]


def _withdrawn(
    graph: nx.Graph,
    wrong: Mapping[tuple[str, str], Misfit],
    config: GroupsConfig,
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
        entries = [graph.edges[edge] for edge in pairwise([*path, a])]
        names = dict.fromkeys(x["prior"].name for x in entries if "prior" in x)
        if names:
            cycle += f" with the {' and the '.join(names)}"
        if "prior" not in entry:
            result[entry["index"]] = (
                f"contradicts the cycle {cycle}: it is {off.gap:.2f} m and "
                f"{np.degrees(off.turn):.1f}° off what the others say, {config.cycle_distance:g} m "
                f"and {config.cycle_angle:g}° are allowed (confidence {entry['weight']:.2f})"
            )
        for edge in pairwise(path):
            other = graph.edges[edge]
            close = other["weight"] - entry["weight"] < config.cycle_margin
            if "prior" in other or other["weight"] >= BY_HAND:
                continue
            if frozenset(edge) in unsupported and close:
                result.setdefault(
                    other["index"],
                    f"the cycle {cycle} does not close and nothing else tells which of its "
                    f"alignments is wrong; this one is hardly more confident "
                    f"({other['weight']:.2f}) than the least ({entry['weight']:.2f})",
                )
    return result
