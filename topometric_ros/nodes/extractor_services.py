"""The extractor's services: each answers with a code and a sentence, and never ends the node."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from topometric_msgs.srv import ExtractNow, Reset, SaveMap

from topometric_ros.io.map_files import save_map
from topometric_ros.io.trajectories import write_trajectories
from topometric_ros.nodes.extractor_report import ExtractorReport
from topometric_ros.nodes.services import computed, offer, written

if TYPE_CHECKING:
    from topometric_ros.nodes.extractor import Extractor


def serve(node: Extractor) -> None:
    """Offer the services of an extractor."""
    services = _ExtractorServices(node)
    offer(
        node,
        (
            (ExtractNow, "~/extract_now", services.extract_now),
            (Reset, "~/reset", services.reset),
            (SaveMap, "~/save_map", services.save_map),
        ),
    )


class _ExtractorServices:
    def __init__(self, node: Extractor) -> None:
        self._node = node

    def extract_now(self, _request: Any, response: Any) -> Any:
        def extract() -> None:
            self._node.take_in(at_once=True)
            self._node.extract()

        with self._node.working:
            if not computed(self._node, extract, response):
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
            self._node.input.reset()
            self._node.report = ExtractorReport()
            self._node.remember(at_once=True)
            response.session = self._node.input.session.session
        response.code, response.message = response.SUCCESS, f"session {response.session} begins"
        self._node.get_logger().info(response.message)
        return response

    def save_map(self, request: Any, response: Any) -> Any:
        m = self._node.input.session.map
        if m is None:
            response.code, response.message = response.NO_INPUT, "there is no map yet"
            return response
        way = self._node.input.session.trajectory

        def save(path: Path) -> None:
            save_map(path, m)
            write_trajectories(path, [way] if way else [])

        if written(request.path, save, response):
            response.message = f"map {m.sequence} written to {response.path}"
        return response
