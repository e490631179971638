"""The life of a node's process: start, spin, a clean end on SIGINT and SIGTERM, exit statuses."""

from __future__ import annotations

import logging
import os
import signal
import sys
import threading
from collections.abc import Callable, Sequence
from typing import Any

import rclpy
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.executors import Executor, MultiThreadedExecutor
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.logging import LoggingSeverity
from rclpy.node import Node
from rclpy.parameter import Parameter
from rclpy.service import Service
from rclpy.signals import SignalHandlerOptions
from rclpy.timer import Timer

from topometric_ros.errors import TopometricError
from topometric_ros.nodes.answers import Answer, patient
from topometric_ros.nodes.parameter_files import passed_over

logger = logging.getLogger(__name__)

BAD_INPUT = 2

END_S = 3.0
"""How long a process that is told to end waits for what is being computed."""

SILENT_S = 10.0
"""How long after the start it is no wonder that no time, no cloud and no map has come."""
_LOOK_S = 0.5
_CALLBACKS_S = 2.0


class TopometricNode(Node):
    """A node that works on a thread of its own, can end that, and can begin again.

    Made, it has its parameters only. :meth:`configure` makes its state and its publishers;
    :meth:`activate` begins to listen, to work and to answer. Plain nodes do both at the start,
    managed ones when they are told to (:mod:`topometric_ros.nodes.managed`).
    """

    _publishers_before: frozenset[Any] = frozenset()
    _listening_before: frozenset[Any] = frozenset()
    _active = False
    _asked: MutuallyExclusiveCallbackGroup | None = None

    def declare_parameters(
        self, namespace: str, parameters: Sequence[Any], ignore_override: bool = False
    ) -> list[Parameter]:
        """Declare parameters, but for those that a file gives no value.

        An empty list in a parameter file, as a dump of this node has them, reaches rclpy without a
        type or a value, and rclpy refuses to declare such an override.
        """
        given = [entry for entry in parameters if len(entry) < 2 or entry[1] is not None]
        declared: list[Parameter] = super().declare_parameters(namespace, given, ignore_override)
        return declared

    def create_service(
        self, srv_type: Any, srv_name: str, callback: Answer, **options: Any
    ) -> Service:
        """Offer a service, those of parameters too, whose answers wait until they are heard.

        Without a callback group it shares one with the parameters' services: what waits for a
        caller must not hold up timers and subscriptions, `/tf` among them.
        """
        if options.get("callback_group") is None:
            self._asked = self._asked or MutuallyExclusiveCallbackGroup()
            options["callback_group"] = self._asked
        answer = patient(self, self.resolve_service_name(srv_name), callback)
        return super().create_service(srv_type, srv_name, answer, **options)

    def _set_up(self) -> None:
        """Make the state and the publishers."""
        raise NotImplementedError

    def _begin(self) -> None:
        """Make the worker, the subscriptions, services and timers."""
        raise NotImplementedError

    def _stop_work(self, limit_s: float) -> bool:
        """Stop working; return False where the work could not be ended in time."""
        raise NotImplementedError

    def configure(self) -> None:
        """Make the state and the publishers; what they latch is there from the first message on."""
        self._publishers_before = frozenset(self.publishers)
        self._set_up()

    def activate(self) -> None:
        """Begin to listen, to work and to answer; subscribing brings what others have latched."""
        self._listening_before = frozenset(self._listening())
        self._begin()
        self._clock_look = self.every(SILENT_S, self._look_at_clock)
        self._active = True

    def deactivate(self, limit_s: float = END_S) -> bool:
        """Stop that again; return False where the work could not be ended in time."""
        if not self._active:
            return True
        self._active = False
        destroy = (self.destroy_subscription, self.destroy_timer, self.destroy_service)
        for entity in [e for e in self._listening() if e not in self._listening_before]:
            any(kind(entity) for kind in destroy)
        return self._stop_work(limit_s)

    def cleanup(self) -> None:
        """Take the publishers away, and what they had latched with them; parameters stay."""
        for publisher in [p for p in self.publishers if p not in self._publishers_before]:
            self.destroy_publisher(publisher)

    def _listening(self) -> list[Any]:
        return [*self.subscriptions, *self.timers, *self.services]

    def clock_silence(self) -> str:
        """Return in words that the time stands still for want of a `/clock`; empty: it does not."""
        simulated = bool(self.get_parameter("use_sim_time").value)
        if not simulated or self.get_clock().now().nanoseconds > 0:
            return ""
        return "use_sim_time is set, but nothing comes on /clock: the time stands still"

    def _look_at_clock(self) -> None:
        self._clock_look.cancel()
        if silence := self.clock_silence():
            self.get_logger().warning(silence)

    def every(self, seconds: float, callback: Callable[[], None]) -> Timer:
        """Call something at a fixed pace of true time.

        A simulated clock stands still before its bag starts and when it has ended, with the last
        messages still to be worked on.
        """
        return self.create_timer(seconds, callback, clock=Clock(clock_type=ClockType.STEADY_TIME))


def run(
    make_node: Callable[[], TopometricNode],
    arguments: Sequence[str] | None,
    *,
    managed: bool = False,
) -> int:
    """Spin a node until SIGINT or SIGTERM; return the process's exit status.

    A managed one waits to be configured and activated; any other one begins at once.

    Zero after a signal, two with one line in the log where the node or ROS refuses its parameters.

    The signals only set a flag: rclpy's own handlers shut the middleware down at once, under
    whatever thread is publishing at that moment.
    """
    given = list(sys.argv if arguments is None else arguments)
    try:
        rclpy.init(args=given, signal_handler_options=SignalHandlerOptions.NO)
    except RuntimeError as error:  # Such as for a parameter file that is not there, or no YAML.
        rclpy.logging.get_logger("topometric_ros").fatal(str(error).partition(", at /")[0])
        return BAD_INPUT
    told_to_end = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: told_to_end.set())
    # Our services may wait for a computation, those of parameters for their caller, so each have
    # a thread beside the one of timers and subscriptions.
    executor = MultiThreadedExecutor(num_threads=3)
    try:
        node = make_node()
        for line in passed_over(given, node.get_fully_qualified_name()):
            node.get_logger().warning(line)
        if not managed:
            node.configure()
            node.activate()
    except TopometricError as error:
        rclpy.logging.get_logger("topometric_ros").fatal(str(error))
        return BAD_INPUT
    executor.add_node(node)
    spin(executor, told_to_end)
    _end(node, executor)
    return 0


def spin(executor: Executor, told_to_end: threading.Event) -> None:
    """Spin until told to end; what a callback raises is logged and ends that call only."""
    while not told_to_end.is_set() and executor.context.ok():
        try:
            executor.spin_once(timeout_sec=_LOOK_S)
        except Exception as error:
            logger.error("a callback failed: %s", describe_failure(error))


def _end(node: TopometricNode, executor: MultiThreadedExecutor) -> None:
    """Take the node down from the top: the worker, the callbacks, then the middleware."""
    ended = node.deactivate() and _join(executor)
    executor.shutdown()
    if not ended:
        # A computation that is still running would be torn down inside compiled code.
        sys.stdout.flush()
        os._exit(0)
    node.destroy_node()
    rclpy.try_shutdown()


def _join(executor: MultiThreadedExecutor) -> bool:
    """Wait for running callbacks, which Jazzy's own `shutdown` leaves behind."""
    waiting = threading.Thread(target=executor._executor.shutdown, daemon=True)
    waiting.start()
    waiting.join(_CALLBACKS_S)
    return not waiting.is_alive()


def describe_failure(error: Exception) -> str:
    """Return an error in one line; where it is none of ours, log where it came from as well."""
    if isinstance(error, TopometricError):
        return str(error)
    logger.error("a fault of this program", exc_info=error)
    return f"unexpected: {error!r}"


class _ToRos(logging.Handler):
    """Passes the library's log records on to the node's logger."""

    def __init__(self, logger: RcutilsLogger) -> None:
        super().__init__()
        self._logger = logger

    def emit(self, record: logging.LogRecord) -> None:
        text = self.format(record)
        # rclpy remembers the severity of every calling line, so each needs a line of its own.
        if record.levelno >= logging.ERROR:
            self._logger.error(text)
        elif record.levelno >= logging.WARNING:
            self._logger.warning(text)
        elif record.levelno >= logging.INFO:
            self._logger.info(text)
        else:
            self._logger.debug(text)


def log_to(node: Node) -> None:
    """Send the library's log records to the node's log."""
    library = logging.getLogger("topometric_ros")
    library.addHandler(_ToRos(node.get_logger()))
    debugging = node.get_logger().is_enabled_for(LoggingSeverity.DEBUG)
    library.setLevel(logging.DEBUG if debugging else logging.INFO)
