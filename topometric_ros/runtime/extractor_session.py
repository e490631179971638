"""The extractor's state without ROS: clouds in, versions of one agent's topometric map out.

A session is a stretch of time in which one agent's map only grows or is corrected: its lattice,
its level frame and its rooms' ids stay fixed. No threads and no clock: time is passed in.
"""

from __future__ import annotations

import dataclasses
import logging
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.extraction.assess import parts
from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.extraction.pipeline import Extraction
from topometric_ros.io.trajectories import AgentTrajectory
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.runtime.accumulator import PointAccumulator
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.runtime.room_ids import keep_room_ids
from topometric_ros.runtime.track import Track
from topometric_ros.topometric_map import TopometricMap

logger = logging.getLogger(__name__)

_FINEST_CELL = 0.05
"""Scans are gathered in cells of at most this edge (m), which the storeys' rasters need."""


class SessionError(TopometricError):
    """Something asked of a session that it cannot do in its present state."""


@dataclass
class InputCounts:
    """What came in since the session began."""

    map_clouds: int = 0
    scans: int = 0
    dropped_points: int = 0
    """Points that were not finite."""


class ExtractorSession:
    """One agent's extractor.

    Parameters
    ----------
    agent : short id
    extraction, matching : configurations; the rooms' descriptors are those of `matching`
    new_session : gives the id of each session that begins; ids must differ
    T_up_input : (4, 4) rotation that turns the input's up axis to z; identity by default
    """

    def __init__(
        self,
        agent: str,
        extraction: ExtractionConfig,
        matching: MatchingConfig,
        new_session: Callable[[], str],
        T_up_input: NDArray[np.float64] | None = None,
    ) -> None:
        self.agent = agent
        self.extraction = extraction
        self.matching = matching
        self._new_session = new_session
        self._T_up_input = np.eye(4) if T_up_input is None else T_up_input
        self.reset()

    def reset(self) -> None:
        """Forget everything; the next map begins a new session."""
        self.session = self._new_session()
        self.sequence = 0
        self.frame_id = ""
        self.stamp = 0
        self.counts = InputCounts()
        self.map: TopometricMap | None = None
        """The newest map, None before the first."""
        self._cloud: NDArray[np.float64] | None = None
        cell = min(self.extraction.voxel_size / 2, _FINEST_CELL)
        self._scans: PointAccumulator = PointAccumulator(cell)
        self._track = Track()
        self._T_level_up: NDArray[np.float64] | None = None
        self._next_room = 0

    @property
    def has_input(self) -> bool:
        """True where there is something to extract a map from."""
        return self._cloud is not None or self.counts.scans > 0

    @property
    def trajectory(self) -> AgentTrajectory | None:
        """Where the sensor was in the map's frame; None where no scan told."""
        return self._track.trajectory(self.agent, self.frame_id)

    def add_map_cloud(
        self, points: NDArray[np.float64], frame_id: str, stamp: int, dropped: int = 0
    ) -> None:
        """Take a cloud of the whole map so far; it replaces every earlier one.

        Parameters
        ----------
        points : (N, 3) float64, m, frame `frame_id`, finite
        stamp : ns since the epoch
        dropped : points that were left out since they were not finite
        """
        self._begin(frame_id)
        self.counts.map_clouds += 1
        self.counts.dropped_points += dropped
        if len(points) == 0:
            logger.warning("%s: a map cloud without finite points was skipped", self.agent)
            return
        self._cloud = points
        self.stamp = max(self.stamp, stamp)

    def add_scan(
        self,
        points: NDArray[np.float64],
        frame_id: str,
        stamp: int,
        T_map_sensor: NDArray[np.float64],
        dropped: int = 0,
    ) -> None:
        """Take one scan and add it to the map.

        Parameters
        ----------
        points : (N, 3) float64, m, sensor frame, finite
        frame_id : the map's frame
        stamp : ns since the epoch
        T_map_sensor : (4, 4), where the sensor was in the map's frame
        dropped : as of :meth:`add_map_cloud`
        """
        self._begin(frame_id)
        self.counts.scans += 1
        self.counts.dropped_points += dropped
        self._scans.add(points @ T_map_sensor[:3, :3].T + T_map_sensor[:3, 3])
        self._track.add(stamp, T_map_sensor[:3, 3])
        self.stamp = max(self.stamp, stamp)

    def extract(self) -> Extraction:
        """Return a new version of the map from everything received.

        Raises
        ------
        SessionError
            Nothing was received yet.
        ExtractionError
            No map can be made of it; the session keeps the map that it had.
        """
        points = self._points()
        previous = self.map
        up = self._T_up_input
        result = extract_map(
            points if np.array_equal(up, np.eye(4)) else points @ up[:3, :3].T,
            self.extraction,
            self.matching,
            T_up_input=up,
            warnings=self._input_warnings(),
            agent=self.agent,
            session=self.session,
            sequence=self.sequence + 1,
            frame_id=self.frame_id,
            stamp=self.stamp,
            origin=previous.origin if previous else None,
            T_level_input=self._T_level_up,
        )
        m = result.map
        if previous is None:
            self._T_level_up = m.T_level_input @ up.T
            self._next_room = max((room.id for room in m.rooms), default=-1) + 1
        else:
            m, self._next_room = keep_room_ids(previous, m, self._next_room)
        self.sequence += 1
        self.map = m
        quality = dataclasses.replace(result.quality, parts=parts(m))
        return dataclasses.replace(result, map=m, quality=quality)

    def _begin(self, frame_id: str) -> None:
        """Note the map's frame; another one than before begins a new session."""
        if self.frame_id and frame_id != self.frame_id:
            logger.warning(
                "%s: the map's frame changed from %s to %s; a new session begins",
                *(self.agent, self.frame_id, frame_id),
            )
            self.reset()
        self.frame_id = frame_id

    def _points(self) -> NDArray[np.float64]:
        if not self.has_input:
            raise SessionError(f"{self.agent}: no cloud with finite points was received yet")
        parts = [self._scans.points()] if self.counts.scans else []
        if self._cloud is not None:
            parts.append(self._cloud)
        points = np.concatenate(parts)
        if len(points) == 0:
            raise SessionError(f"{self.agent}: none of the points received is finite")
        return points

    def _input_warnings(self) -> tuple[str, ...]:
        dropped = self.counts.dropped_points
        return (f"{dropped} points were not finite and were dropped",) if dropped else ()
