"""Managed variants of both nodes, for a lifecycle manager to configure, activate and stop.

Unconfigured they have their parameters and nothing else. Configured (inactive) they have a state
and their publishers; what was published before stays latched. Only active ones listen, work and
offer their services. `cleanup` forgets the state: an extractor begins a new session when it is
configured again, a merger takes up its `state_file`, if it has one.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence

from rclpy.lifecycle import LifecycleNodeMixin, LifecycleState, TransitionCallbackReturn

from topometric_ros.errors import TopometricError
from topometric_ros.nodes.answers import patient
from topometric_ros.nodes.extractor import Extractor
from topometric_ros.nodes.merger import Merger
from topometric_ros.nodes.running import TopometricNode, describe_failure, run

_WORK_S = 120.0
"""A transition waits this long for what is being computed."""


class _Managed(LifecycleNodeMixin, TopometricNode):
    """The transitions of a node of ours; a failing one leaves the node in the state it had."""

    def _be_managed(self) -> None:
        """Offer the transitions' services; rclpy makes them past :meth:`create_service`."""
        own = set(self.services)
        LifecycleNodeMixin.__init__(self)
        for service in set(self.services) - own:
            service.callback = patient(self, service.srv_name, service.callback)

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._try(self.configure)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._try(self.activate)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        # What still computes would publish into the inactive state, so it is waited for.
        ended = self.deactivate(_WORK_S)
        return TransitionCallbackReturn.SUCCESS if ended else TransitionCallbackReturn.ERROR

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._try(self.cleanup)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        ended = self.deactivate(_WORK_S)
        self.cleanup()
        return TransitionCallbackReturn.SUCCESS if ended else TransitionCallbackReturn.ERROR

    def _try(self, action: Callable[[], None]) -> TransitionCallbackReturn:
        try:
            action()
        except TopometricError as error:
            self.get_logger().error(describe_failure(error))
            return TransitionCallbackReturn.FAILURE
        return TransitionCallbackReturn.SUCCESS


class ManagedExtractor(_Managed, Extractor):
    """The extractor with a managed life."""

    def __init__(self) -> None:
        Extractor.__init__(self)
        self._be_managed()


class ManagedMerger(_Managed, Merger):
    """The merger with a managed life."""

    def __init__(self) -> None:
        Merger.__init__(self)
        self._be_managed()


def extractor(arguments: Sequence[str] | None = None) -> None:
    """Run a managed extractor until SIGINT or SIGTERM."""
    sys.exit(run(ManagedExtractor, arguments, managed=True))


def merger(arguments: Sequence[str] | None = None) -> None:
    """Run a managed merger until SIGINT or SIGTERM."""
    sys.exit(run(ManagedMerger, arguments, managed=True))


if __name__ == "__main__":
    {"extractor": extractor, "merger": merger}[sys.argv.pop(1)]()
