"""When the merger publishes what: what a reader has not seen yet, as soon as it is time for it.

Alignments are told often, since robots steer by them; the global map is fused less often, since it
takes longer. Both leave most of the time to aligning.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence

from topometric_ros.nodes.config import MergerNodeConfig
from topometric_ros.nodes.merger_output import MergerOutput, Shown
from topometric_ros.nodes.worker import Pace
from topometric_ros.runtime.merger_session import MergerSession

_TELLING_SHARE = 0.5
_FUSING_SHARE = 0.3
"""Of the time, at most, that publishing alignments and fusing maps take."""


class Showing:
    """What of a session is published already, and what is to be.

    Parameters
    ----------
    output : the publishers
    own : gives the merger's parameters as they are now
    told : called when alignments were published, to write them down too
    """

    def __init__(
        self, output: MergerOutput, own: Callable[[], MergerNodeConfig], told: Callable[[], None]
    ) -> None:
        self.output = output
        self._own = own
        self._on_told = told
        self._telling, self._fusing = Pace(_TELLING_SHARE), Pace(_FUSING_SHARE)
        self.stale: tuple[str, ...] = ()
        """Agents with a map whose extractors are gone."""
        self.forget()

    def forget(self) -> None:
        """Count nothing as seen, as for a session that begins."""
        self.changes: tuple[str, ...] = ()
        """What has changed between the agents' visits, in words, by the map that was fused last."""
        self._told: Hashable = None
        self._fused = Shown()
        self._storey = self._own().grid_storey

    def other_storey(self, session: MergerSession) -> bool:
        """Whether the grid that is published is not of the storey that is wanted now."""
        return session.result is not None and self._storey != self._own().grid_storey

    def publish_due(self, session: MergerSession) -> bool:
        """Publish what has changed and what it is time for; return whether something is left."""
        shown = self._shown(session)
        told = shown.alignments == self._told
        if not told and self._telling.due():
            with self._telling.step(self._own().max_rate):
                self.tell(session)
            told = True
        # A map of places that are known better waits until no pair does; one of new maps does not.
        settled = shown.places == self._fused.places or session.waiting > 0
        fused = shown.maps == self._fused.maps and settled
        if not fused and self._fusing.due():
            with self._fusing.step(self._own().max_rate):
                self.fuse(session)
            fused = True
        elif session.result is not None and self.other_storey(session):
            self._storey = self._own().grid_storey
            self.output.publish_grid(session.result, self._storey)
        return not (told and fused and self._told)

    def tell(self, session: MergerSession) -> None:
        """Publish the alignments."""
        self._told = self._shown(session).alignments
        if session.placed is not None:
            stale = self._stale(session)
            self.output.publish_alignments(session.placed, session.maps, stale, self.changes)
        self._on_told()

    def fuse(self, session: MergerSession) -> None:
        """Fuse the maps and publish the global one."""
        self._fused = self._shown(session)
        self._storey = self._own().grid_storey
        changes = self.output.publish_map(session.fuse(), self._storey)
        if changes != self.changes:
            self.changes, self._told = changes, None

    def _shown(self, session: MergerSession) -> Shown:
        return Shown.of(session, self._stale(session))

    def _stale(self, session: MergerSession) -> Sequence[str]:
        return sorted({*session.stale, *self.stale})
