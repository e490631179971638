"""The alignments of all pairs of a fleet, and which of them are to be made, the most urgent first.

A new map does not undo what was found with the one before: an accepted alignment is checked against
it, which costs a few milliseconds, and holds until the pair has its turn to be aligned anew. So do
new parameters, but what is then found counts whether or not it is better.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable, Collection, Sequence

from topometric_ros.alignment import TOLD_BASIS, Alignment, AlignmentStatus, Basis
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.runtime.merger_state import Known, Version, version_of
from topometric_ros.runtime.offers import Offers
from topometric_ros.runtime.pair_aligner import PairAligner
from topometric_ros.runtime.pair_parameters import mark
from topometric_ros.runtime.stability import standing, steadier
from topometric_ros.stopwatch import Stopwatch
from topometric_ros.topometric_map import TopometricMap

logger = logging.getLogger(__name__)

Pair = tuple[str, str]
Maps = tuple[TopometricMap, TopometricMap]
Grounds = tuple[tuple[Version, Version], str]
"""What a verdict rests on: versions of both maps and the mark of the parameters."""

_NO_LONGER, _JOINS, _APART, _TOGETHER, _HOLDS = range(5)
"""How urgent a pair is: what was accepted contradicts the maps; one agent is placed and the other
not; neither is; both are, by way of others; what was accepted holds."""


class Pairs:
    """What is known of each pair of agents."""

    def __init__(self) -> None:
        self.known: dict[Pair, Known] = {}
        """What aligning gave, and of which versions of the maps."""
        self.offers = Offers()
        self.aligner = PairAligner()
        self._checked: dict[Pair, tuple[Grounds, Alignment, bool]] = {}
        self._refused: dict[Pair, Grounds] = {}
        self._turns: dict[Pair, int] = {}

    def forget(self, agent: str) -> None:
        """Forget an agent's pairs and what was made of its map."""
        self.void(agent)
        self.aligner.forget(agent)

    def void(self, agent: str) -> None:
        """Forget an agent's pairs: what held of its map no longer does."""
        for held in (self.known, self._checked, self._refused, self._turns):
            for pair in [pair for pair in held if agent in pair]:
                del held[pair]

    def alignment(self, a: TopometricMap, b: TopometricMap, config: MergeConfig) -> Alignment:
        """Return what is held of a pair now; it may be of older maps, which the reason then says.

        An accepted alignment of older maps of the same sessions stands where the present ones have
        nothing against it.
        """
        return self._held(a, b, config)[0]

    def due(
        self, pairs: Sequence[Maps], config: MergeConfig, placed: Collection[str]
    ) -> list[Maps]:
        """Return the pairs to align with their present maps or parameters, most urgent first.

        Equally urgent ones come in the order in which they had their last turns.

        Parameters
        ----------
        pairs : maps of two agents each
        config : MergeConfig
        placed : the agents whose place in the global frame is known
        """
        waiting = []
        for index, (a, b) in enumerate(pairs):
            pair = (a.agent, b.agent)
            alignment, holds = self._held(a, b, config)
            entry = self.known.get(pair)
            if entry is not None and _grounds_of(entry) == _grounds(a, b, config):
                continue
            there = sum(agent in placed for agent in pair)
            urgency = (_APART, _JOINS, _TOGETHER)[there]
            if alignment.accepted and there != 1:
                urgency = _HOLDS
            elif not holds:
                urgency = _NO_LONGER
            waiting.append((urgency, self._turns.get(pair, 0), index))
        return [pairs[index] for _, _, index in sorted(waiting)]

    def align(
        self,
        pairs: Sequence[Maps],
        config: MergeConfig,
        threads: int,
        in_use: Collection[Pair],
        watch: Stopwatch,
        progress: Callable[[str], None] | None = None,
    ) -> None:
        """Align pairs with their present maps; one in use changes only for a better one.

        Where the parameters have changed since, it is theirs that counts: no old one is kept.
        """
        turn = 1 + max(self._turns.values(), default=0)
        found = self.aligner.align(pairs, config, threads, watch, progress)
        for (a, b), new in zip(pairs, found, strict=True):
            pair = (a.agent, b.agent)
            entry = self.known.get(pair)
            alignment, held = new.alignment, new.support
            grounds = _grounds(a, b, config)
            same = entry is not None and entry.parameters == grounds[1]
            if entry is not None and same and pair in in_use and _same_sessions(a, b, entry):
                with watch.stage("stability"):
                    alignment, held = steadier(
                        entry.alignment, entry.support, alignment, new.a, new.b, config
                    )
            self.known[pair] = Known(alignment, grounds[0], held, grounds[1])
            self._turns[pair] = turn

    def try_one(
        self,
        a: TopometricMap,
        b: TopometricMap,
        config: MergeConfig,
        watch: Stopwatch,
        progress: Callable[[str], None] | None = None,
    ) -> bool:
        """Align a pair and keep what was found where it is accepted; return whether it is."""
        (found,) = self.aligner.align([(a, b)], config, 1, watch, progress)
        pair, grounds = (a.agent, b.agent), _grounds(a, b, config)
        if found.alignment.accepted:
            self.known[pair] = Known(found.alignment, grounds[0], found.support, grounds[1])
        else:
            self._refused[pair] = grounds
        return found.alignment.accepted

    def was_refused(self, a: TopometricMap, b: TopometricMap, config: MergeConfig) -> bool:
        """Whether :meth:`try_one` has found no alignment of just these maps."""
        return self._refused.get((a.agent, b.agent)) == _grounds(a, b, config)

    def keep_only(self, agent: str, maps: dict[str, TopometricMap]) -> None:
        """Forget what is known of an agent's pairs unless it is of just these maps."""
        for pair in [pair for pair in self.known if agent in pair]:
            if self.known[pair].versions != _versions(maps[pair[0]], maps[pair[1]]):
                del self.known[pair]
                self._checked.pop(pair, None)

    def _held(
        self, a: TopometricMap, b: TopometricMap, config: MergeConfig
    ) -> tuple[Alignment, bool]:
        """Return what is held of a pair, and False where the present maps speak against it."""
        pair, grounds = (a.agent, b.agent), _grounds(a, b, config)
        if pair not in self.known:
            offer = self.offers.standing(a, b, self.aligner, config)
            if offer is not None:
                self.known[pair] = offer
        entry = self.known.get(pair)
        if entry is None:
            return _waiting(Alignment(pair, AlignmentStatus.NONE, ""), Basis.OLDER_MAPS), True
        if not entry.parameters:
            entry = self.known[pair] = dataclasses.replace(entry, parameters=grounds[1])
        if _grounds_of(entry) == grounds:
            return entry.alignment, True
        older = Basis.OLDER_PARAMETERS if entry.versions == grounds[0] else Basis.OLDER_MAPS
        if not entry.alignment.accepted:
            return _waiting(entry.alignment, older), True
        if not _same_sessions(a, b, entry):
            return _waiting(Alignment(pair, AlignmentStatus.NONE, ""), older), True
        if pair not in self._checked or self._checked[pair][0] != grounds:
            one, two = self.aligner.prepared(a, config), self.aligner.prepared(b, config)
            checked, objection = standing(entry.alignment, one, two, config)
            if objection is not None:
                reason = f"it no longer holds: {objection}"
                checked = _waiting(Alignment(pair, AlignmentStatus.NONE, reason), older)
                logger.warning("%s and %s: %s", *pair, checked.reason)
            self._checked[pair] = (grounds, checked, objection is None)
        return self._checked[pair][1:]


def _waiting(alignment: Alignment, basis: Basis) -> Alignment:
    """Return a verdict as it is told until the pair has its turn."""
    told = [part for part in (alignment.reason, TOLD_BASIS[basis]) if part]
    return dataclasses.replace(alignment, reason="; ".join(told), basis=basis)


def _versions(a: TopometricMap, b: TopometricMap) -> tuple[Version, Version]:
    return version_of(a), version_of(b)


def _grounds(a: TopometricMap, b: TopometricMap, config: MergeConfig) -> Grounds:
    return _versions(a, b), mark(config, a.agent, b.agent)


def _grounds_of(entry: Known) -> Grounds:
    return entry.versions, entry.parameters


def _same_sessions(a: TopometricMap, b: TopometricMap, entry: Known) -> bool:
    return tuple(version[0] for version in entry.versions) == (a.session, b.session)
