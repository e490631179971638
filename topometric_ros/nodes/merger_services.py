"""The merger's services: each answers with a code and a sentence, and never ends the node."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from topometric_msgs.srv import LoadMap, MergeNow, RemoveAlignment, Reset, SaveMap, SetAlignment

from topometric_ros.errors import TopometricError
from topometric_ros.io.map_files import load_map, save_map
from topometric_ros.nodes.services import computed, offer, written
from topometric_ros.runtime.by_hand import CovarianceError
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.transforms import TransformError

if TYPE_CHECKING:
    from topometric_ros.nodes.merger import Merger


def serve(node: Merger) -> None:
    """Offer the services of a merger."""
    services = _MergerServices(node)
    offer(
        node,
        (
            (MergeNow, "~/merge_now", services.merge_now),
            (Reset, "~/reset", services.reset),
            (SaveMap, "~/save_map", services.save_map),
            (LoadMap, "~/load_map", services.load_map),
            (SetAlignment, "~/set_alignment", services.set_alignment),
            (RemoveAlignment, "~/remove_alignment", services.remove_alignment),
        ),
    )


class _MergerServices:
    def __init__(self, node: Merger) -> None:
        self._node = node

    def merge_now(self, _request: Any, response: Any) -> Any:
        def merge() -> None:
            self._node.take_in()
            self._node.merge()

        with self._node.working:
            if not computed(self._node, merge, response):
                return response
            agents = self._node.session.placed.agents if self._node.session.placed else ()
            placed = [agent.id for agent in agents if agent.T_global_agent is not None]
            response.agents, response.aligned = len(agents), len(placed)
        response.code = response.SUCCESS
        response.message = f"{len(placed)} of {len(agents)} agents in the global frame"
        return response

    def reset(self, _request: Any, response: Any) -> Any:
        with self._node.working:
            self._node.start_over()
        response.code, response.message = response.SUCCESS, "all maps and alignments forgotten"
        self._node.get_logger().info(response.message)
        return response

    def save_map(self, request: Any, response: Any) -> Any:
        result = self._node.session.result
        if result is None:
            response.code, response.message = response.NO_INPUT, "there is no global map yet"
            return response
        fused, observers = result.global_map, tuple(agent.id for agent in result.agents)
        if written(
            request.path, lambda path: save_map(path, fused.map, fused.agents, observers), response
        ):
            response.message = f"global map written to {response.path}"
        return response

    def load_map(self, request: Any, response: Any) -> Any:
        try:
            m = load_map(Path(request.path).expanduser())
        except (ValueError, RuntimeError) as error:  # A name that no file can have.
            response.code, response.message = response.FILE_ERROR, f"{request.path}: {error}"
            return response
        except TopometricError as error:
            unreadable = isinstance(error.__cause__, OSError)
            response.code = response.FILE_ERROR if unreadable else response.FAILED
            response.message = str(error)
            return response
        m = dataclasses.replace(m, agent=request.agent or m.agent)
        roster = self._node.roster
        if not roster.admits(m.agent):
            response.code = response.UNKNOWN_AGENT
            response.message = f"no agent {m.agent!r}; known: {', '.join(roster.reports)}"
            return response
        with self._node.working:
            try:
                self._node.fresh |= self._node.session.add_map(m, request.path)
            except TopometricError as error:
                response.code, response.message = response.FAILED, str(error)
                return response
            entry = roster.report_of(m.agent, request.path)
            entry.newest, entry.arrived = m, self._node.get_clock().now().nanoseconds
            entry.file = request.path
        response.code, response.agent = response.SUCCESS, m.agent
        response.message = f"map {m.sequence} of {m.agent}: {len(m.rooms)} rooms"
        return response

    def set_alignment(self, request: Any, response: Any) -> Any:
        a, b = request.agent_a, request.agent_b
        T_a_b = np.array(request.t_a_b).reshape(4, 4)
        told = np.array(request.covariance).reshape(6, 6)
        covariance = told if told.any() else None
        with self._node.working:
            try:
                self._node.session.set_alignment(a, b, T_a_b, covariance)
            except SessionError as error:
                response.code, response.message = response.UNKNOWN_AGENT, str(error)
                return response
            except CovarianceError as error:
                response.code, response.message = response.INVALID_COVARIANCE, str(error)
                return response
            except TransformError as error:
                response.code, response.message = response.INVALID_TRANSFORM, str(error)
                return response
            self._node.fresh = bool(self._node.session.maps)
            self._node.remember()
        response.code, response.message = response.SUCCESS, f"alignment of {a} and {b} set by hand"
        self._node.get_logger().info(response.message)
        return response

    def remove_alignment(self, request: Any, response: Any) -> Any:
        a, b = request.agent_a, request.agent_b
        session = self._node.session
        with self._node.working:
            try:
                done = session.remove_alignment(a, b, request.allow)
            except SessionError as error:
                response.code, response.message = response.UNKNOWN_AGENT, str(error)
                return response
            forbidden = session.by_hand.forbids(a, b)
            self._node.fresh = bool(session.maps)
            self._node.remember()
        if not done:
            response.code = response.NO_ALIGNMENT
            text = "removed by hand before" if forbidden else "nothing was set or removed by hand"
            response.message = f"{a} and {b}: {text}"
            return response
        text = "removed by hand, until it is allowed" if forbidden else "the maps decide again"
        response.code, response.message = response.SUCCESS, f"{a} and {b}: {text}"
        self._node.get_logger().info(response.message)
        return response
