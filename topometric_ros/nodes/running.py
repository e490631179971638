"""The life of a node's process: start, spin, a clean end on SIGINT and SIGTERM, exit statuses."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable, Sequence

import rclpy
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.impl.rcutils_logger import RcutilsLogger
from rclpy.node import Node

from topometric_ros.errors import TopometricError

BAD_INPUT = 2


class TopometricNode(Node):
    """A node that works on a thread of its own and can end it."""

    def close(self) -> bool:
        """Stop working; return False where the work could not be ended in time."""
        raise NotImplementedError


def run(make_node: Callable[[], TopometricNode], arguments: Sequence[str] | None) -> int:
    """Spin a node until it is told to end; return the process's exit status.

    Zero after SIGINT and SIGTERM, two with one line in the log where it refuses its parameters.
    """
    rclpy.init(args=list(sys.argv if arguments is None else arguments))
    node: TopometricNode | None = None
    # Services may wait for a computation, so they have a thread beside the subscriptions' own.
    executor = MultiThreadedExecutor(num_threads=2)
    status = 0
    try:
        node = make_node()
        executor.add_node(node)
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    except TopometricError as error:
        rclpy.logging.get_logger("topometric_ros").fatal(str(error))
        status = BAD_INPUT
    except Exception:
        # A signal while the node is being made shows as whatever call it interrupted.
        if rclpy.ok():
            raise
    _end(node, executor, status)
    return status


def _end(node: TopometricNode | None, executor: MultiThreadedExecutor, status: int) -> None:
    ended = node.close() if node is not None else True
    executor.shutdown(timeout_sec=1.0)
    if node is not None and ended:
        node.destroy_node()
    rclpy.try_shutdown()
    if not ended:
        # A computation that is still running would be torn down inside compiled code.
        sys.stdout.flush()
        os._exit(status)


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
    library.setLevel(logging.INFO)
