"""The merger's state without ROS: maps of agents in, one global map and its alignments out.

Only what changed is aligned again, a few pairs at a time where the caller wants to publish in
between (:meth:`MergerSession.align`, then :meth:`MergerSession.fuse`) or all at once
(:meth:`MergerSession.merge`). An accepted alignment changes only for a better one, so that robots
that steer by it are not thrown about. No clock.
"""

from __future__ import annotations

import dataclasses
import itertools
import logging
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import MergeResult, Placed
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.merge import fused, place
from topometric_ros.runtime.by_hand import ByHand, covariance_of, taken_back
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.fleet_maps import FleetMaps, Taken
from topometric_ros.runtime.merger_state import Known, MergerState
from topometric_ros.runtime.moved_maps import MOVED, move_told, still_there
from topometric_ros.runtime.pairs import Pairs
from topometric_ros.stopwatch import Stopwatch
from topometric_ros.topometric_map import TopometricMap

logger = logging.getLogger(__name__)

Progress = Callable[[str], None] | None
Matrix = NDArray[np.float64]


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
        self.covariance_by_hand = covariance_of(0.1, np.radians(1.0))
        """(6, 6), what is told of transforms that are set by hand without a covariance."""
        self._fleet = FleetMaps(agents)
        self.reset()

    def reset(self) -> None:
        """Forget all maps and alignments, and what was said of them by hand."""
        self._fleet = FleetMaps(self._fleet.order)
        self.placed: Placed | None = None
        """Where the agents stand by the newest alignments, None before the first."""
        self.result: MergeResult | None = None
        """The newest fused result, which `placed` may be ahead of; None before the first."""
        self.waiting = 0
        """Pairs that are still to be aligned with the newest maps."""
        self._pairs = Pairs()
        self.by_hand = ByHand()
        """What an operator has said of pairs."""
        self._moved: dict[str, str] = {}
        self._watch = Stopwatch()

    @property
    def maps(self) -> dict[str, TopometricMap]:
        """The map of each agent that takes part in the result."""
        return self._fleet.in_use

    @property
    def sources(self) -> dict[str, str]:
        """Where the maps came from."""
        return self._fleet.sources

    @property
    def stale(self) -> tuple[str, ...]:
        """Agents in the result with an old map, since their newer session is not aligned yet."""
        return tuple(sorted(self._fleet.newer))

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
        held = self.maps.get(m.agent)
        taken = self._fleet.take(m, source)
        if taken is Taken.NEXT and held is not None:
            self._notice_move(held, m)
        if taken is Taken.SESSION:
            self.by_hand.end_session(m.agent)
        return taken is not Taken.OLD

    def newest(self, agent: str) -> TopometricMap:
        """Return the newest map of an agent that has one, taken into the result or not yet."""
        return self._fleet.newest(agent)

    def merge(self, progress: Progress = None) -> MergeResult:
        """Align all that changed and fuse the maps; raises what :meth:`align` raises."""
        self.align(progress=progress)
        return self.fuse(progress)

    def align(self, limit: int | None = None, progress: Progress = None) -> Placed:
        """Bring the alignments up to date with the maps and place the agents.

        Parameters
        ----------
        limit : pairs to align at most, the most urgent ones; the others wait. What was accepted of
            older maps holds meanwhile, where the new ones have nothing against it. None: all
        progress : told in words what is being done

        Raises
        ------
        SessionError
            No map was received yet.
        MergeError
            The maps cannot be merged.
        """
        if not self.maps:
            raise SessionError("no map was received yet")
        left = self._take_over(limit, progress)
        order = self._fleet.present
        pairs = [
            (self.maps[a], self.maps[b])
            for a, b in itertools.combinations(order, 2)
            if not (self.by_hand.fixes(a, b) or self.by_hand.forbids(a, b))
        ]
        due = self._pairs.due(pairs, self.config, {order[0], *self._in_place()})
        chosen = due if left is None else due[:left]
        in_use = {x.agents for x in self.placed.alignments if x.accepted} if self.placed else set()
        self._pairs.align(chosen, self.config, self.threads, in_use, self._watch, progress)
        untried = sum(len(self._untried(agent)) for agent in self._fleet.newer)
        self.waiting = len(due) - len(chosen) + untried
        maps = [self.maps[agent] for agent in order]
        known = {(a.agent, b.agent): self._pairs.alignment(a, b, self.config) for a, b in pairs}
        known |= {(a, b): taken_back(a, b) for a, b in self.by_hand.removed}
        placed = place(maps, self.config, known, sources=self.sources, fixed=self.by_hand.fixed)
        told = (*self._moved.values(), *map(self._fleet.told_stale, self.stale))
        if not self.waiting:
            self._moved = {}
        self.placed = dataclasses.replace(
            placed,
            alignments=self.by_hand.with_covariance(placed.alignments, self.covariance_by_hand),
            warnings=(*placed.warnings, *told),
            timings=dict(self._watch.seconds),
        )
        return self.placed

    def fuse(self, progress: Progress = None) -> MergeResult:
        """Fuse the maps of the agents as the newest alignments have placed them.

        Raises
        ------
        SessionError
            Nothing was aligned yet, or a map has gone since.
        """
        agents = self.placed.agents if self.placed else ()
        if self.placed is None or any(agent.id not in self.maps for agent in agents):
            raise SessionError("nothing was aligned yet")
        if progress is not None:
            progress("fusing the aligned maps")
        self.result = fused([self.maps[agent.id] for agent in agents], self.placed, self.config)
        self._watch = Stopwatch()
        return self.result

    def transforms(self) -> dict[str, Matrix]:
        """Return `T_global_agent` (4, 4) of every agent whose place is known now.

        An agent whose newer session is not aligned yet has none: its old transform says nothing
        about where its frame is now.
        """
        if self.placed is None:
            return {}
        return {
            agent.id: agent.T_global_agent
            for agent in self.placed.agents
            if agent.T_global_agent is not None and agent.id not in self._fleet.newer
        }

    def set_alignment(
        self, a: str, b: str, T_a_b: Matrix, covariance: Matrix | None = None
    ) -> None:
        """Fix the transform between two agents; it stays until removed or a session ends.

        Raises
        ------
        SessionError
            The agents are not two that the merger knows.
        TransformError, CovarianceError
            `T_a_b` is no rigid motion, or `covariance` (6, 6) can be none of it.
        """
        self._require_pair(a, b)
        self.by_hand.set(a, b, T_a_b, covariance)

    def remove_alignment(self, a: str, b: str, allow: bool = False) -> bool:
        """Take back what was set by hand, else what the maps say of two agents, now and later on.

        With `allow` the maps decide again in any case. Return False where nothing is changed.

        Raises
        ------
        SessionError
            The agents are not two that the merger knows.
        """
        self._require_pair(a, b)
        return self.by_hand.allow(a, b) if allow else self.by_hand.remove(a, b)

    def state(self) -> MergerState:
        """Return what is known, to be restored after a restart."""
        return MergerState(
            order=tuple(self._fleet.order),
            maps=dict(self.maps),
            newer=dict(self._fleet.newer),
            sources=dict(self.sources),
            ended=self._fleet.ended,
            known=tuple(self._pairs.known.values()),
            fixed=tuple(self.by_hand.fixed.values()),
            removed=self.by_hand.removed,
        )

    def restore(self, state: MergerState) -> None:
        """Take up a state again: what was known before is forgotten, the agents' order is kept."""
        self.reset()
        self._fleet.restore(state)
        self._pairs.known = {entry.alignment.agents: entry for entry in state.known}
        self.by_hand = ByHand({x.agents: x for x in state.fixed}, state.removed)

    def forget(self, agent: str) -> None:
        """Take an agent out of the result; it may come back with any map."""
        self._fleet.forget(agent)
        self.by_hand.end_session(agent)
        self._pairs.forget(agent)
        if not self.maps:
            self.placed, self.waiting = None, 0

    def offer(self, offers: Sequence[Known]) -> None:
        """Take note of what another merger has found.

        It is used for pairs that were not aligned here yet, where it is of just the maps that are
        held and where an accepted transform passes the gates on them.
        """
        self._pairs.offers.take(offers)

    def _require_pair(self, a: str, b: str) -> None:
        for agent in (a, b):
            if agent not in self._fleet.order:
                known = ", ".join(self._fleet.order) or "none"
                raise SessionError(f"no agent {agent!r}; known: {known}")
        if a == b:
            raise SessionError(f"an alignment needs two agents, got {a!r} twice")

    def _in_place(self) -> list[str]:
        agents = self.placed.agents if self.placed else ()
        return [agent.id for agent in agents if agent.T_global_agent is not None]

    def _take_over(self, limit: int | None, progress: Progress) -> int | None:
        """Let the maps of newer sessions replace the old ones where that loses no alignment.

        An agent in place keeps its old map until its new one aligns with that of another. Return
        how many pairs may still be aligned now.
        """
        for agent in list(self._fleet.newer):
            untried, found = self._untried(agent), False
            for other in untried if limit is None else untried[:limit]:
                a, b = self._fleet.in_order(self._fleet.newer[agent], self.maps[other])
                limit = None if limit is None else limit - 1
                found = self._pairs.try_one(a, b, self.config, self._watch, progress)
                if found:
                    break
            if found or not self._must_align(agent):
                self._fleet.use_newer(agent)
                self._pairs.keep_only(agent, self.maps)
        return limit

    def _must_align(self, agent: str) -> bool:
        """Whether a newer session's map must align with another before it takes its place."""
        # What was set by hand before the new session is gone; what is there means the new one.
        by_hand = any(agent in pair for pair in self.by_hand.fixed)
        return agent in self._in_place() and bool(self._partners(agent)) and not by_hand

    def _partners(self, agent: str) -> list[str]:
        """Return the agents in place that another may be aligned with."""
        placed = [x for x in self._in_place() if x != agent and x in self.maps]
        return [x for x in placed if not self.by_hand.forbids(agent, x)]

    def _untried(self, agent: str) -> list[str]:
        """Return the agents in place that a newer session's map was not aligned with yet."""
        if not self._must_align(agent):
            return []
        newer = self._fleet.newer[agent]
        pairs = {o: self._fleet.in_order(newer, self.maps[o]) for o in self._partners(agent)}
        return [
            other
            for other, (a, b) in pairs.items()
            if not self._pairs.was_refused(a, b, self.config)
        ]

    def _notice_move(self, old: TopometricMap, new: TopometricMap) -> None:
        """Remember that an agent's map has moved as a whole, as when its SLAM closes a loop."""
        share = still_there(old, new)
        if share >= MOVED:
            return
        others = sorted({a for pair in self.by_hand.fixed if new.agent in pair for a in pair})
        told = move_told(new.agent, share, [a for a in others if a != new.agent])
        self._moved[new.agent] = told
        self._pairs.void(new.agent)
        logger.warning("%s", told)
