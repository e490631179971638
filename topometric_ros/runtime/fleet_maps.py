"""The maps of a fleet: which version of each agent's map counts, and which waits for its turn.

A newer map of the same session takes the place of the one before. One of another session may have
another origin: it waits beside the old map until it is aligned, and the old session has ended for
good. No alignments and no clock here.
"""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Sequence
from enum import Enum, auto

from topometric_ros.fusion.merge import MOST_AGENTS
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.merger_state import MOST_ENDED, MergerState
from topometric_ros.topometric_map import TopometricMap

logger = logging.getLogger(__name__)


class Taken(Enum):
    """What a map is to the maps that are held."""

    OLD = auto()
    """No newer than the one that is held."""
    FIRST = auto()
    NEXT = auto()
    """Of the session of the map in use, whose place it takes."""
    WAITS = auto()
    """Of a session that is known and not aligned yet."""
    SESSION = auto()
    """The first one of another session."""


class FleetMaps:
    """The maps of a fleet.

    Parameters
    ----------
    agents : ids in their order; agents that are not named come after these as their maps arrive
    """

    def __init__(self, agents: Sequence[str] = ()) -> None:
        self.order = list(agents)
        self.in_use: dict[str, TopometricMap] = {}
        """The map of each agent that takes part in the result."""
        self.newer: dict[str, TopometricMap] = {}
        """The newest map of each agent whose newer session is not aligned yet."""
        self.sources: dict[str, str] = {}
        """Where the maps came from, for the record."""
        self._ended: dict[str, deque[str]] = {}

    @property
    def present(self) -> list[str]:
        """The agents that have a map, in their order."""
        return [agent for agent in self.order if agent in self.in_use]

    @property
    def ended(self) -> dict[str, tuple[str, ...]]:
        """The sessions that each agent has left behind."""
        return {agent: tuple(sessions) for agent, sessions in self._ended.items()}

    def take(self, m: TopometricMap, source: str) -> Taken:
        """Take an agent's map, and say what it is.

        Raises
        ------
        SessionError
            The map belongs to a session that has ended, or to one agent too many.
        """
        agent = m.agent
        if agent not in self.in_use and len(self.in_use) >= MOST_AGENTS:
            raise SessionError(f"{agent}: at most {MOST_AGENTS} agents can be merged")
        if m.session in self._ended.get(agent, ()):
            raise SessionError(f"{agent}: a map of session {m.session!r}, which has ended")
        self.sources[agent] = source or self.sources.get(agent, agent)
        if agent not in self.order:
            self.order.append(agent)
        if agent not in self.in_use:
            self.in_use[agent] = m
            return Taken.FIRST
        newest = self.newest(agent)
        if newest.session != m.session:
            logger.info("%s: session %s follows %s", agent, m.session, newest.session)
            self._ended.setdefault(agent, deque(maxlen=MOST_ENDED)).append(newest.session)
            self.newer[agent] = m
            return Taken.SESSION
        if m.sequence <= newest.sequence:
            return Taken.OLD
        if agent in self.newer:
            self.newer[agent] = m
            return Taken.WAITS
        self.in_use[agent] = m
        return Taken.NEXT

    def newest(self, agent: str) -> TopometricMap:
        """Return the newest map of an agent that has one, taken into the result or not yet."""
        return self.newer.get(agent) or self.in_use[agent]

    def use_newer(self, agent: str) -> None:
        """Let the map of a newer session take the place of the old one."""
        self.in_use[agent] = self.newer.pop(agent)

    def forget(self, agent: str) -> None:
        """Forget an agent's maps and sessions; it keeps its place in the order."""
        for held in (self.in_use, self.newer, self.sources, self._ended):
            held.pop(agent, None)

    def restore(self, state: MergerState) -> None:
        """Take up the maps of a state; agents that were named before come first."""
        self.order += [agent for agent in state.order if agent not in self.order]
        self.in_use, self.newer = dict(state.maps), dict(state.newer)
        self.sources = dict(state.sources)
        self._ended = {agent: deque(known, MOST_ENDED) for agent, known in state.ended.items()}

    def in_order(self, x: TopometricMap, y: TopometricMap) -> tuple[TopometricMap, TopometricMap]:
        """Return two agents' maps in the agents' order."""
        return (x, y) if self.order.index(x.agent) < self.order.index(y.agent) else (y, x)

    def told_stale(self, agent: str) -> str:
        """Return in words that an agent's newer session is not aligned yet."""
        old, new = self.in_use[agent].session, self.newer[agent].session
        return f"{agent}: session {new} is not aligned yet; its map of session {old} is kept"
