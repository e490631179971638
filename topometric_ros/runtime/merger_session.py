"""The merger's state without ROS: maps of agents in, one global map and its alignments out.

Only what changed is aligned again. An accepted alignment changes only for a better one, so that
robots that steer by it are not thrown about. No threads and no clock.
"""

from __future__ import annotations

import dataclasses
import itertools
import logging
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import BY_HAND, Alignment, AlignmentStatus, MergeResult
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.merge import MOST_AGENTS, merge
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.merger_state import Known, MergerState, Version, version_of
from topometric_ros.runtime.moved_maps import MOVED, still_there
from topometric_ros.runtime.offers import Offers
from topometric_ros.runtime.pair_aligner import PairAligner
from topometric_ros.runtime.stability import steadier
from topometric_ros.runtime.transforms import check_rigid
from topometric_ros.stopwatch import Stopwatch
from topometric_ros.topometric_map import TopometricMap

logger = logging.getLogger(__name__)

Pair = tuple[str, str]


class MergerSession:
    """The merger of a fleet.

    Parameters
    ----------
    config : MergeConfig
    agents : ids in the order of the result, the first with a map is the anchor; agents that are not
        named come after these in the order in which their maps arrive
    threads : pairs that are aligned at the same time; the result does not depend on it
    """

    def __init__(self, config: MergeConfig, agents: Sequence[str] = (), threads: int = 1) -> None:
        self.config = config
        self.threads = threads
        self._order = list(agents)
        self.reset()

    def reset(self) -> None:
        """Forget all maps and alignments, those set by hand included."""
        self.maps: dict[str, TopometricMap] = {}
        """The map of each agent that takes part in the result."""
        self.sources: dict[str, str] = {}
        self.result: MergeResult | None = None
        """The newest result, None before the first."""
        self._newer_session: dict[str, TopometricMap] = {}
        self._ended: dict[str, set[str]] = {}
        self._known: dict[Pair, Known] = {}
        self._fixed: dict[Pair, Alignment] = {}
        self._aligner = PairAligner()
        self._offers = Offers()
        self._refused: dict[Pair, tuple[Version, Version]] = {}
        self._moved: dict[str, str] = {}

    @property
    def stale(self) -> tuple[str, ...]:
        """Agents in the result with an old map, since their newer session is not aligned yet."""
        return tuple(sorted(self._newer_session))

    def add_map(self, m: TopometricMap, source: str = "") -> bool:
        """Take an agent's map; False where it is no newer than the one that is held.

        Parameters
        ----------
        m : the map
        source : where it came from, for the record

        Raises
        ------
        SessionError
            The map belongs to a session that has ended, or to one agent too many.
        """
        if m.agent not in self.maps and len(self.maps) >= MOST_AGENTS:
            raise SessionError(f"{m.agent}: at most {MOST_AGENTS} agents can be merged")
        if m.session in self._ended.get(m.agent, ()):
            raise SessionError(f"{m.agent}: a map of session {m.session!r}, which has ended")
        self.sources[m.agent] = source or self.sources.get(m.agent, m.agent)
        if m.agent not in self._order:
            self._order.append(m.agent)
        newest = self._newer_session.get(m.agent) or self.maps.get(m.agent)
        if newest is not None and newest.session == m.session:
            if m.sequence <= newest.sequence:
                return False
            into = self._newer_session if m.agent in self._newer_session else self.maps
            self._notice_move(into[m.agent], m)
            into[m.agent] = m
            return True
        if newest is None:
            self.maps[m.agent] = m
            return True
        logger.info("%s: session %s follows %s", m.agent, m.session, newest.session)
        self._ended.setdefault(m.agent, set()).add(newest.session)
        self._newer_session[m.agent] = m
        self._fixed = {p: x for p, x in self._fixed.items() if m.agent not in p}
        return True

    def merge(self, progress: Callable[[str], None] | None = None) -> MergeResult:
        """Align what changed and fuse the maps.

        Raises
        ------
        SessionError
            No map was received yet.
        MergeError
            The maps cannot be merged.
        """
        if not self.maps:
            raise SessionError("no map was received yet")
        watch = Stopwatch()
        self._take_over(watch, progress)
        order = [agent for agent in self._order if agent in self.maps]
        pairs = [(self.maps[a], self.maps[b]) for a, b in itertools.combinations(order, 2)]
        self._align_again([pair for pair in pairs if self._is_due(*pair)], watch, progress)
        known = {pair: entry.alignment for pair, entry in self._known.items()}
        result = merge(
            [self.maps[agent] for agent in order],
            self.config,
            sources=self.sources,
            known=known,
            fixed=self._fixed,
            progress=progress,
        )
        timings = {**watch.seconds}
        for stage, seconds in result.timings.items():
            timings[stage] = timings.get(stage, 0.0) + seconds
        told = (*self._moved.values(), *map(self._stale_warning, self.stale))
        self._moved = {}
        warnings = (*result.warnings, *told)
        self.result = dataclasses.replace(result, timings=timings, warnings=warnings)
        return self.result

    def transforms(self) -> dict[str, NDArray[np.float64]]:
        """Return `T_global_agent` (4, 4) of every agent whose place is known now.

        An agent whose newer session is not aligned yet has none: its old transform says nothing
        about where its frame is now.
        """
        if self.result is None:
            return {}
        return {
            agent.id: agent.T_global_agent
            for agent in self.result.agents
            if agent.T_global_agent is not None and agent.id not in self._newer_session
        }

    def set_alignment(self, a: str, b: str, T_a_b: NDArray[np.float64]) -> None:
        """Fix the transform between two agents; it stays until removed or a session ends.

        Raises
        ------
        SessionError
            The agents are not two that the merger knows.
        TransformError
            `T_a_b` is no rigid motion.
        """
        self._require_pair(a, b)
        T_a_b = np.asarray(T_a_b, np.float64)
        check_rigid(T_a_b, f"alignment of {a} and {b}")
        self._fixed.pop((b, a), None)
        self._fixed[a, b] = Alignment(
            agents=(a, b),
            status=AlignmentStatus.ACCEPTED,
            reason=BY_HAND,
            T_a_b=T_a_b,
            confidence=1.0,
        )

    def remove_alignment(self, a: str, b: str) -> bool:
        """Let the maps decide again about two agents; False where nothing was set by hand.

        Raises
        ------
        SessionError
            The agents are not two that the merger knows.
        """
        self._require_pair(a, b)
        return any(self._fixed.pop(pair, None) for pair in ((a, b), (b, a)))

    def fixed(self) -> dict[Pair, Alignment]:
        """Return the alignments that were set by hand."""
        return dict(self._fixed)

    def state(self) -> MergerState:
        """Return what is known, to be restored after a restart."""
        return MergerState(
            order=tuple(self._order),
            maps=dict(self.maps),
            newer=dict(self._newer_session),
            sources=dict(self.sources),
            ended={agent: tuple(sorted(sessions)) for agent, sessions in self._ended.items()},
            known=tuple(self._known.values()),
            fixed=tuple(self._fixed.values()),
        )

    def restore(self, state: MergerState) -> None:
        """Take up a state again: what was known before is forgotten, the agents' order is kept."""
        named = list(self._order)
        self.reset()
        self._order = [*named, *(agent for agent in state.order if agent not in named)]
        self.maps, self._newer_session = dict(state.maps), dict(state.newer)
        self.sources = dict(state.sources)
        self._ended = {agent: set(sessions) for agent, sessions in state.ended.items()}
        self._known = {entry.alignment.agents: entry for entry in state.known}
        self._fixed = {alignment.agents: alignment for alignment in state.fixed}

    def forget(self, agent: str) -> None:
        """Take an agent out of the result; it may come back with any map."""
        for held in (self.maps, self._newer_session, self.sources, self._ended):
            held.pop(agent, None)
        self._known = {p: entry for p, entry in self._known.items() if agent not in p}
        self._fixed = {p: x for p, x in self._fixed.items() if agent not in p}
        self._refused = {p: v for p, v in self._refused.items() if agent not in p}
        self._aligner.forget(agent)

    def offer(self, offers: Sequence[Known]) -> None:
        """Take note of what another merger has found.

        It is used for pairs that were not aligned here yet, where it is of just the maps that are
        held and where an accepted transform passes the gates on them.
        """
        self._offers.take(offers)

    def _require_pair(self, a: str, b: str) -> None:
        for agent in (a, b):
            if agent not in self._order:
                known = ", ".join(self._order) or "none"
                raise SessionError(f"no agent {agent!r}; known: {known}")
        if a == b:
            raise SessionError(f"an alignment needs two agents, got {a!r} twice")

    def _take_over(self, watch: Stopwatch, progress: Callable[[str], None] | None) -> None:
        """Let the maps of newer sessions replace the old ones where that loses no alignment."""
        for agent in list(self._newer_session):
            if self._replaceable(agent, watch, progress):
                self.maps[agent] = self._newer_session.pop(agent)
                self._known = {
                    pair: entry
                    for pair, entry in self._known.items()
                    if agent not in pair or self._current(pair, entry)
                }

    def _replaceable(
        self, agent: str, watch: Stopwatch, progress: Callable[[str], None] | None
    ) -> bool:
        """Whether a newer session's map aligns with an agent in place, or the old one never did."""
        agents = self.result.agents if self.result else ()
        placed = [place.id for place in agents if place.T_global_agent is not None]
        # What was set by hand before the new session is gone; what is there means the new one.
        by_hand = any(agent in pair for pair in self._fixed)
        if agent not in placed or len(placed) < 2 or by_hand:
            return True
        new = self._newer_session[agent]
        for other in placed:
            if other == agent:
                continue
            a, b = self._in_order(new, self.maps[other])
            pair, versions = (a.agent, b.agent), (version_of(a), version_of(b))
            if self._refused.get(pair) == versions:
                continue
            (found,) = self._aligner.align([(a, b)], self.config, 1, watch, progress)
            if found.alignment.accepted:
                self._known[pair] = Known(found.alignment, versions, found.support)
                return True
            self._refused[pair] = versions
        return False

    def _is_due(self, a: TopometricMap, b: TopometricMap) -> bool:
        """Whether the alignment of a pair is to be made of its present maps."""
        pair, versions = (a.agent, b.agent), (version_of(a), version_of(b))
        if self._fixed_for(pair) is not None:
            return False
        entry = self._known.get(pair)
        if entry is None:
            entry = self._offers.standing(a, b, self._aligner, self.config)
            if entry is not None:
                self._known[pair] = entry
        return entry is None or entry.versions != versions

    def _align_again(
        self,
        pairs: Sequence[tuple[TopometricMap, TopometricMap]],
        watch: Stopwatch,
        progress: Callable[[str], None] | None,
    ) -> None:
        """Bring the alignments of pairs up to date with their maps."""
        found = self._aligner.align(pairs, self.config, self.threads, watch, progress)
        for (a, b), new in zip(pairs, found, strict=True):
            pair = (a.agent, b.agent)
            entry = self._known.get(pair)
            alignment, held = new.alignment, new.support
            in_use = entry is not None and self._in_use(pair, entry)
            # Where a map has moved as a whole, what held before says nothing.
            still = not self._moved.keys() & set(pair)
            if entry is not None and in_use and still and self._same_sessions(a, b, entry):
                with watch.stage("stability"):
                    alignment, held = steadier(
                        entry.alignment, entry.support, alignment, new.a, new.b, self.config
                    )
            self._known[pair] = Known(alignment, (version_of(a), version_of(b)), held)

    def _in_order(self, x: TopometricMap, y: TopometricMap) -> tuple[TopometricMap, TopometricMap]:
        return (x, y) if self._order.index(x.agent) < self._order.index(y.agent) else (y, x)

    def _in_use(self, pair: Pair, entry: Known) -> bool:
        """Whether robots steer by the alignment of a pair: one that was withdrawn may change."""
        alignments = self.result.alignments if self.result else ()
        stands = any(x.accepted and x.agents == pair for x in alignments)
        return stands and entry.alignment.accepted

    def _current(self, pair: Pair, entry: Known) -> bool:
        return entry.versions == (version_of(self.maps[pair[0]]), version_of(self.maps[pair[1]]))

    def _same_sessions(self, a: TopometricMap, b: TopometricMap, entry: Known) -> bool:
        return tuple(version[0] for version in entry.versions) == (a.session, b.session)

    def _fixed_for(self, pair: Pair) -> Alignment | None:
        return self._fixed.get(pair) or self._fixed.get((pair[1], pair[0]))

    def _notice_move(self, old: TopometricMap, new: TopometricMap) -> None:
        """Remember that an agent's map has moved as a whole, as when its SLAM closes a loop."""
        share = still_there(old, new)
        if share >= MOVED:
            return
        told = f"{new.agent}: its whole map has moved, {share:.0%} is where it was: aligned anew"
        by_hand = sorted({a for pair in self._fixed for a in pair if new.agent in pair})
        if by_hand:
            others = ", ".join(a for a in by_hand if a != new.agent)
            told += f"; what was set by hand with {others} is kept and may no longer hold"
        self._moved[new.agent] = told
        logger.warning("%s", told)

    def _stale_warning(self, agent: str) -> str:
        old, new = self.maps[agent].session, self._newer_session[agent].session
        return f"{agent}: session {new} is not aligned yet; its map of session {old} is kept"
