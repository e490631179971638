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
from topometric_ros.extraction.extent import anchor
from topometric_ros.extraction.pipeline import Extraction
from topometric_ros.io.trajectories import AgentTrajectory
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.runtime.room_ids import keep_room_ids
from topometric_ros.runtime.scan_state import Doubt, ScanState
from topometric_ros.runtime.track import Track
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.grid import lattice_coordinates
from topometric_ros.voxels.scan_grid import ScanGrid

logger = logging.getLogger(__name__)

_FINEST_CELL = 0.05
"""Scans are gathered in cells of at most this edge (m), which the storeys' rasters need."""


_LOW_BITS = np.int64((1 << 21) - 1)
"""Voxels are told apart by so much of each coordinate: 200 km of 0.1 m."""


class SessionError(TopometricError):
    """Something asked of a session that it cannot do in its present state."""


@dataclass
class InputCounts:
    """What came in since the session began."""

    map_clouds: int = 0
    scans: int = 0
    dropped_points: int = 0
    """Points that were not finite, or lie too far from the map."""


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
        self._extracted: NDArray[np.float64] | None = None
        self._cells = np.empty(0, np.int64)
        self._scans: ScanGrid | None = None
        self._doubt: Doubt | None = None
        self._failed = False
        self._track = Track()
        self._T_level_up: NDArray[np.float64] | None = None
        self._next_room = 0

    @property
    def has_input(self) -> bool:
        """True where there is something to extract a map from."""
        return self._cloud is not None or self._scans is not None

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
        T_map_cloud: NDArray[np.float64],
        dropped: int = 0,
        sensor: NDArray[np.float64] | None = None,
    ) -> None:
        """Take one scan and add it to the map.

        Parameters
        ----------
        points : (N, 3) float64, m, in the cloud's own frame, finite
        frame_id : the map's frame
        stamp : ns since the epoch
        T_map_cloud : (4, 4), where that frame was in the map's
        dropped : as of :meth:`add_map_cloud`
        sensor : (3,) float64, m, map frame, where the sensor was; None where that is not known:
            then the scan clears nothing
        """
        self._begin(frame_id)
        self.counts.scans += 1
        self.counts.dropped_points += dropped
        placed = points @ T_map_cloud[:3, :3].T + T_map_cloud[:3, 3]
        self._gather(placed, sensor)
        self._track.add(stamp, T_map_cloud[:3, 3] if sensor is None else sensor)
        self.stamp = max(self.stamp, stamp)

    def scan_state(self) -> ScanState | None:
        """Return what the scans came to, None where there are none or others are doubted."""
        if self._scans is None or self._doubt is not None:
            return None
        counts = self.counts.scans, self.counts.dropped_points
        return ScanState(
            self.agent, self.frame_id, self.stamp, *counts, self._scans, self.trajectory
        )

    def take_up(self, state: ScanState) -> None:
        """Go on from what the scans of an earlier session came to; nothing was received yet.

        The first scans are held against it: where they do not fit, it is forgotten again and a new
        session begins.

        Raises
        ------
        SessionError
            The state is of another agent or of other cells.
        """
        if state.agent != self.agent:
            raise SessionError(f"scans of agent {state.agent!r}, expected {self.agent!r}")
        if state.grid.cell != self._cell:
            raise SessionError(f"scans in cells of {state.grid.cell:g} m, expected {self._cell:g}")
        self.frame_id, self.stamp, self._scans = state.frame_id, state.stamp, state.grid
        self.counts = InputCounts(scans=state.scans, dropped_points=state.dropped_points)
        if state.way is not None:
            for at, position in zip(state.way.stamps.tolist(), state.way.positions, strict=True):
                self._track.add(at, position)
        self._doubt = Doubt(state.grid)

    def change(self) -> float:
        """Return how much came or went since the newest map, as a share of the voxels: 0 to 1.

        It is 1 before the first map and after an extraction that failed. Of scans it is the cells
        in which they are gathered that count, of map clouds the map's voxels.
        """
        if self.map is None or self._failed or self.map.frame_id != self.frame_id:
            return 1.0
        share = 0.0 if self._scans is None else self._scans.change()
        if self._cloud is None or self._cloud is self._extracted:
            return share
        if self._extracted is None:
            return 1.0
        if len(self._cells) == 0:
            self._cells = self._cells_of(self._extracted)
        cells = self._cells_of(self._cloud)
        different = len(np.setxor1d(cells, self._cells, assume_unique=True))
        return max(share, min(1.0, different / max(len(cells), len(self._cells), 1)))

    def extract(self, reuse: bool = True) -> Extraction:
        """Return a new version of the map from everything received.

        Where `reuse`, what the newest map holds is not computed again if it must come out the same:
        the level frame's tilt and the descriptors of rooms whose voxels are the same. The result is
        equal either way.

        Raises
        ------
        SessionError
            Nothing was received yet.
        ExtractionError
            No map can be made of it; the session keeps the map that it had.
        """
        points = self._points()
        previous = self.map
        self._failed = True
        if self._cloud is not self._extracted:
            self._extracted, self._cells = self._cloud, np.empty(0, np.int64)
        up, way = self._T_up_input, self.trajectory
        result = extract_map(
            points if np.array_equal(up, np.eye(4)) else points @ up[:3, :3].T,
            self.extraction,
            self.matching,
            T_up_input=up,
            warnings=self._input_warnings(),
            previous=previous if reuse else None,
            agent=self.agent,
            session=self.session,
            sequence=self.sequence + 1,
            frame_id=self.frame_id,
            stamp=self.stamp,
            origin=previous.origin if previous else None,
            T_level_input=self._T_level_up,
            way=None if way is None else way.positions @ up[:3, :3].T,
            thinned=self._cloud is None,
        )
        m = result.map
        if previous is None:
            self._T_level_up = m.T_level_input @ up.T
            self._next_room = max((room.id for room in m.rooms), default=-1) + 1
        else:
            m, self._next_room = keep_room_ids(previous, m, self._next_room)
        self.sequence += 1
        self.map = m
        self._failed = False
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

    @property
    def _cell(self) -> float:
        return min(self.extraction.voxel_size / 2, _FINEST_CELL)

    def _gather(self, placed: NDArray[np.float64], sensor: NDArray[np.float64] | None) -> None:
        """Put a scan in the map's frame into its cells, unless it is held for a while."""
        scans = [(placed, sensor)]
        if self._doubt is not None:
            held = self._doubt.hear(placed, sensor)
            if held is None:
                return
            doubt, self._doubt, scans = self._doubt, None, held
            if not doubt.fits:
                logger.warning(
                    "%s: scans do not fit those of before the restart: %s; was %s set up anew? "
                    "A new session begins",
                    *(self.agent, doubt.told(), self.frame_id),
                )
                frame = self.frame_id
                self.reset()
                self.frame_id, self.counts.scans = frame, len(held)
        for points, origin in scans:
            if self._scans is None:
                if len(points) == 0:
                    continue
                self._scans = ScanGrid(self._cell, anchor(points), self.extraction.scans)
            self.counts.dropped_points += self._scans.add(points, origin)

    def _points(self) -> NDArray[np.float64]:
        if not self.has_input:
            raise SessionError(f"{self.agent}: no cloud with finite points was received yet")
        parts = [self._scans.points()] if self._scans is not None else []
        if self._cloud is not None:
            parts.append(self._cloud)
        points = np.concatenate(parts)
        if len(points) == 0:
            raise SessionError(f"{self.agent}: none of the points received is finite")
        return points

    def _cells_of(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return a number for each voxel that holds points, sorted."""
        x, y, z = lattice_coordinates(points, self.extraction.voxel_size, np.zeros(3)).T & _LOW_BITS
        return np.unique((x << 42) | (y << 21) | z)

    def _input_warnings(self) -> tuple[str, ...]:
        dropped = self.counts.dropped_points
        return (f"{dropped} points were not finite and were dropped",) if dropped else ()
