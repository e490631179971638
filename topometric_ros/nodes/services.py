"""What the services of both nodes share: their thread, and the codes of what went wrong."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node

from topometric_ros.errors import TopometricError
from topometric_ros.nodes.running import describe_failure
from topometric_ros.runtime.extractor_session import SessionError

if TYPE_CHECKING:
    from topometric_ros.nodes.extractor import Extractor
    from topometric_ros.nodes.merger import Merger

Answer = Callable[[Any, Any], Any]

_FAILED = 2
"""The code of what nobody thought of, FAILED of those services that have it."""


def offer(node: Node, services: Iterable[tuple[type, str, Answer]]) -> None:
    """Offer services, each a type, a name and what answers it.

    They may wait for a computation, so they are called in a thread of their own, one at a time.
    """
    waiting = MutuallyExclusiveCallbackGroup()
    for kind, name, answer in services:
        node.create_service(kind, name, _answered(node, answer), callback_group=waiting)


def _answered(node: Node, answer: Answer) -> Answer:
    """Return an answer that also comes where answering fails: a caller must not wait for ever."""

    def answered(request: Any, response: Any) -> Any:
        try:
            return answer(request, response)
        except Exception as error:
            response.code, response.message = _FAILED, describe_failure(error)
            node.get_logger().error(f"a service failed: {response.message}")
            return response

    return answered


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
    try:
        target = Path(path).expanduser().absolute()
        if target.exists() and not target.is_file():
            raise TopometricError("a folder, a device or a pipe has that name")
        write(target)
    except (OSError, TopometricError, ValueError, RuntimeError) as error:
        # The last two are of names that no file can have, and of users that are not there.
        response.code, response.message = response.FILE_ERROR, f"{path}: {error}"
        return False
    response.code, response.path = response.SUCCESS, str(target)
    return True
