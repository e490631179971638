"""What the services of both nodes share: their thread, and the codes of what went wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from topometric_ros.errors import TopometricError
from topometric_ros.runtime.extractor_session import SessionError

if TYPE_CHECKING:
    from topometric_ros.nodes.extractor import Extractor
    from topometric_ros.nodes.merger import Merger

Answer = Callable[[Any, Any], Any]


def offer(node: Node, services: Iterable[tuple[type, str, Answer]]) -> None:
    """Offer services, each a type, a name and what answers it.

    They may wait for a computation, so they are called in a thread of their own, one at a time.
    """
    waiting = MutuallyExclusiveCallbackGroup()
    for kind, name, answer in services:
        node.create_service(kind, name, answer, callback_group=waiting)


def computed(node: Extractor | Merger, compute: Callable[[], None], response: Any) -> bool:
    """Return whether a computation succeeded; else the response says why it did not."""
    try:
        compute()
    except SessionError as error:
        response.code, response.message = response.NO_INPUT, str(error)
        return False
    except Exception as error:
        node.failed(error)
        response.code, response.message = response.FAILED, node.report.failure
        return False
    return True


def written(path: str, write: Callable[[Path], None], response: Any) -> bool:
    """Return whether a file was written, and fill in the response's code and path."""
    target = Path(path).expanduser().absolute()
    try:
        write(target)
    except (OSError, TopometricError) as error:
        response.code, response.message = response.FILE_ERROR, f"{target}: {error}"
        return False
    response.code, response.path = response.SUCCESS, str(target)
    return True
