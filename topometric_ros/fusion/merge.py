"""Merging the maps of any number of agents: all pairs aligned, groups formed, one map fused."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Mapping, Sequence

import numpy as np

from topometric_ros.alignment import (
    AgentPlacement,
    AgentStatus,
    Alignment,
    AlignmentStatus,
    Alternative,
    MergeResult,
    Placed,
    RoomMatch,
)
from topometric_ros.configuration import validate
from topometric_ros.errors import TopometricError
from topometric_ros.fusion.align import align
from topometric_ros.fusion.changes import told
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.fuse import fuse
from topometric_ros.fusion.groups import Groups, group_agents
from topometric_ros.fusion.poses import Transform, apply, carried, inverse
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.fusion.priors import Prior, contradicted, parse_priors, pointless
from topometric_ros.stopwatch import Stopwatch
from topometric_ros.topometric_map import TopometricMap

MOST_AGENTS = 32
"""A voxel remembers who saw it in a mask of 32 bits."""

Pair = tuple[str, str]


class MergeError(TopometricError):
    """Maps that cannot be merged together, whatever they show."""


def merge(
    maps: Sequence[TopometricMap],
    config: MergeConfig,
    *,
    sources: Mapping[str, str] | None = None,
    known: Mapping[Pair, Alignment] | None = None,
    fixed: Mapping[Pair, Alignment] | None = None,
    progress: Callable[[str], None] | None = None,
) -> MergeResult:
    """Merge agents' maps into one global map in the frame of the first.

    Parameters
    ----------
    maps : one map an agent; the first is the anchor, its input frame the global frame
    config : MergeConfig
    sources : where each agent's map came from, for the record; the agent's id where missing
    known : alignments from an earlier run that still hold, by pair in either order; not redone
    fixed : alignments set by hand, by pair in either order: taken as they are, never withdrawn
    progress : told in words what is being done

    Raises
    ------
    MergeError
        No map, more than 32, or two of one agent.
    ConfigurationError
        A value that is wrong or makes no sense.
    """
    _check(maps)
    validate(config)
    watch = Stopwatch()
    prepared = [Prepared(m, config.search.scoring, config.matching) for m in maps]
    given = dict(known or {})
    for a, b in itertools.combinations(prepared, 2):
        pair = (a.map.agent, b.map.agent)
        if _given(fixed or {}, pair) is None and _given(given, pair) is None:
            if progress is not None:
                progress(f"aligning {a.map.agent} and {b.map.agent}")
            given[pair] = align(a, b, config, watch)
    placed = place(maps, config, given, sources=sources, fixed=fixed)
    if progress is not None:
        progress("fusing the aligned maps")
    return fused(maps, dataclasses.replace(placed, timings=watch.seconds), config)


def place(
    maps: Sequence[TopometricMap],
    config: MergeConfig,
    known: Mapping[Pair, Alignment],
    *,
    sources: Mapping[str, str] | None = None,
    fixed: Mapping[Pair, Alignment] | None = None,
) -> Placed:
    """Group agents by their alignments and say where each one stands, without fusing anything.

    Parameters
    ----------
    maps, config, sources, fixed : as for :func:`merge`
    known : the alignment of every pair that is not in `fixed`, by pair in either order

    Raises
    ------
    MergeError
        No map, more than 32, or two of one agent.
    ConfigurationError
        A prior makes no sense.
    """
    _check(maps)
    priors = parse_priors(config.priors)
    agents = [m.agent for m in maps]
    alignments = [
        _given(fixed or {}, pair) or _given(known, pair)
        for pair in itertools.combinations(agents, 2)
    ]
    strange = (told for _, told in pointless(priors, agents))
    by_hand = frozenset(pair for x, y in (fixed or {}) for pair in ((x, y), (y, x)))
    levels = {m.agent: m.T_level_input for m in maps}
    groups = group_agents(
        agents, [x for x in alignments if x], config.groups, by_hand, _centres(maps), levels, priors
    )
    places = _placements(maps, groups, sources or {})
    return Placed(
        global_frame=config.global_frame,
        agents=places,
        alignments=groups.alignments,
        warnings=(*_warnings(maps), *strange, *_contradicted(places, priors)),
    )


def fused(maps: Sequence[TopometricMap], placed: Placed, config: MergeConfig) -> MergeResult:
    """Fuse the maps of agents that :func:`place` has placed, in the same order."""
    watch = Stopwatch()
    watch.seconds |= placed.timings
    with watch.stage("fusion"):
        transforms = [agent.T_global_agent for agent in placed.agents]
        global_map = fuse(maps, transforms, config.fuse, placed.global_frame)
    changes = told(global_map.changes, [m.agent for m in maps])
    return MergeResult(
        global_frame=placed.global_frame,
        agents=placed.agents,
        alignments=placed.alignments,
        global_map=global_map,
        warnings=(*placed.warnings, *changes),
        timings=watch.seconds,
    )


def reversed_alignment(alignment: Alignment) -> Alignment:
    """Return the alignment of the same two agents in the other order.

    The covariance turns with the transform: it is of the inverse's translation and turns.
    """
    T = alignment.T_a_b
    return dataclasses.replace(
        alignment,
        agents=(alignment.agents[1], alignment.agents[0]),
        T_a_b=None if T is None else inverse(T),
        alternatives=tuple(Alternative(inverse(x.T_a_b), x.score) for x in alignment.alternatives),
        matches=tuple(RoomMatch(m.room_b, m.room_a, m.distance) for m in alignment.matches),
        covariance=None if T is None else _reversed_covariance(alignment),
    )


def _reversed_covariance(
    alignment: Alignment,
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]] | None:
    """Return the covariance of the inverse transform: t' = -Rᵀ t moves by -Rᵀ (δt + t × ω)."""
    if alignment.T_a_b is None or alignment.covariance is None:
        return None
    T = alignment.T_a_b
    return carried(alignment.covariance, -T[:3, :3].T, -T[:3, 3])


def _check(maps: Sequence[TopometricMap]) -> None:
    """Refuse what no merge can be made of."""
    if not maps:
        raise MergeError("no maps to merge")
    if len(maps) > MOST_AGENTS:
        raise MergeError(f"{len(maps)} agents; at most {MOST_AGENTS} can be merged")
    agents = [m.agent for m in maps]
    twice = sorted({agent for agent in agents if agents.count(agent) > 1})
    if twice:
        raise MergeError(f"agent {twice[0]!r} appears {agents.count(twice[0])} times")


def _given(given: Mapping[Pair, Alignment], pair: Pair) -> Alignment | None:
    """Return a known alignment of a pair, turned round where it is of the other order."""
    for key in (pair, (pair[1], pair[0])):
        if key in given:
            alignment = given[key]
            return alignment if alignment.agents == pair else reversed_alignment(alignment)
    return None


def _centres(
    maps: Sequence[TopometricMap],
) -> dict[str, np.ndarray[tuple[int, ...], np.dtype[np.float64]]]:
    """Return the middle of each agent's map in its input frame: (3,), m."""
    return {
        m.agent: apply(inverse(m.T_level_input), m.centres().mean(axis=0)[None])[0]
        for m in maps
        if len(m.voxels)
    }


def _placements(
    maps: Sequence[TopometricMap], groups: Groups, sources: Mapping[str, str]
) -> tuple[AgentPlacement, ...]:
    """Say of every agent where it stands and why."""
    places = []
    for index, m in enumerate(maps):
        number = groups.group[index]
        status = AgentStatus.UNALIGNED
        if index == 0:
            status = AgentStatus.ANCHOR
        elif number == 0:
            status = AgentStatus.ALIGNED
        T = groups.T_group_agent[index]
        places.append(
            AgentPlacement(
                id=m.agent,
                source=sources.get(m.agent, m.agent),
                status=status,
                reason=_reason(m.agent, status, maps[0].agent, groups.alignments),
                group=number,
                T_group_agent=T,
                T_global_agent=T if number == 0 else None,
            )
        )
    return tuple(places)


def _reason(agent: str, status: AgentStatus, anchor: str, alignments: Sequence[Alignment]) -> str:
    """Return in words why an agent is where it is."""
    if status is AgentStatus.ANCHOR:
        return "its frame is the global frame"
    own = [x for x in alignments if agent in x.agents]
    others = sorted(({*x.agents} - {agent}).pop() for x in own if x.accepted)
    if status is AgentStatus.ALIGNED:
        return f"aligned with {', '.join(others)}"
    if others:
        return f"aligned with {', '.join(others)}, but none of them with {anchor}"
    order = list(AlignmentStatus)
    nearest = min(own, key=lambda x: (order.index(x.status), -x.score))
    other = ({*nearest.agents} - {agent}).pop()
    return f"with {other} {nearest.status.value}: {nearest.reason}"


def _contradicted(places: Sequence[AgentPlacement], priors: Sequence[Prior]) -> list[str]:
    """Say which priors the agents' places contradict, those of pairs that share nothing too."""
    groups: dict[int, dict[str, Transform]] = {}
    for place in places:
        groups.setdefault(place.group, {})[place.id] = place.T_group_agent
    return [
        f"contradicts a prior: {told}" for g in groups.values() for told in contradicted(priors, g)
    ]


def _warnings(maps: Sequence[TopometricMap]) -> tuple[str, ...]:
    """Say what a reader of the result should know."""
    sizes = {m.voxel_size for m in maps}
    warnings = []
    if len(sizes) > 1:
        named = ", ".join(f"{m.agent} {m.voxel_size:g} m" for m in maps)
        warnings.append(
            f"voxel sizes differ ({named}): of two maps the finer is brought to the coarser's to "
            f"align them, and the global map has {max(sizes):g} m"
        )
    warnings += [f"the map of {m.agent} has no rooms" for m in maps if not m.rooms]
    return tuple(warnings)
