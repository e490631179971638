"""The extractor's services: each answers with a code and a sentence, and never ends the node."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from topometric_msgs.srv import ExtractNow, Reset, SaveMap

from topometric_ros.errors import TopometricError
from topometric_ros.io.map_files import save_map
from topometric_ros.nodes.extractor_report import ExtractorReport
from topometric_ros.runtime.extractor_session import SessionError

if TYPE_CHECKING:
    from topometric_ros.nodes.extractor import Extractor


def serve(node: Extractor) -> None:
    """Offer the services of an extractor; they may wait for an extraction, in their own thread."""
    services = _ExtractorServices(node)
    waiting = MutuallyExclusiveCallbackGroup()
    for kind, name, answer in (
        (ExtractNow, "~/extract_now", services.extract_now),
        (Reset, "~/reset", services.reset),
        (SaveMap, "~/save_map", services.save_map),
    ):
        node.create_service(kind, name, answer, callback_group=waiting)


class _ExtractorServices:
    def __init__(self, node: Extractor) -> None:
        self._node = node

    def extract_now(self, _request: Any, response: Any) -> Any:
        with self._node.working:
            try:
                self._node.take_in(at_once=True)
                self._node.extract()
            except SessionError as error:
                response.code, response.message = response.NO_INPUT, str(error)
                return response
            except Exception as error:
                self._node.failed(error)
                response.code, response.message = response.FAILED, self._node.report.failure
                return response
            m = self._node.input.session.map
            if m is None:
                response.code, response.message = response.NO_INPUT, "no cloud has arrived yet"
                return response
            response.code, response.message = response.SUCCESS, f"{len(m.rooms)} rooms"
            response.sequence, response.rooms = m.sequence, len(m.rooms)
        return response

    def reset(self, _request: Any, response: Any) -> Any:
        with self._node.working:
            self._node.clouds.take_all()
            self._node.input.session.reset()
            self._node.report = ExtractorReport()
            response.session = self._node.input.session.session
        response.code, response.message = response.SUCCESS, f"session {response.session} begins"
        self._node.get_logger().info(response.message)
        return response

    def save_map(self, request: Any, response: Any) -> Any:
        m = self._node.input.session.map
        if m is None:
            response.code, response.message = response.NO_INPUT, "there is no map yet"
            return response
        path = Path(request.path).expanduser().absolute()
        try:
            save_map(path, m)
        except (OSError, TopometricError) as error:
            response.code, response.message = response.FILE_ERROR, f"{path}: {error}"
            return response
        response.code, response.path = response.SUCCESS, str(path)
        response.message = f"map {m.sequence} written to {path}"
        return response
