"""The way that an agent's sensor took, noted scan by scan in bounded memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.io.trajectories import AgentTrajectory

_STEP = 0.1
"""Places nearer than this to the last one noted are left out, m."""


class Track:
    """Places of a sensor in the map's frame; memory grows with the way, not with time."""

    def __init__(self) -> None:
        self._stamps: list[int] = []
        self._positions: list[NDArray[np.float64]] = []

    def add(self, stamp: int, position: NDArray[np.float64]) -> None:
        """Note a place (3,), m, at `stamp` (ns)."""
        if self._positions and np.linalg.norm(position - self._positions[-1]) < _STEP:
            return
        self._stamps.append(stamp)
        self._positions.append(position.copy())

    def trajectory(self, agent: str, frame_id: str) -> AgentTrajectory | None:
        """Return the way in the order of its stamps, None where no place was noted."""
        if not self._stamps:
            return None
        stamps = np.array(self._stamps, np.int64)
        order = np.argsort(stamps, kind="stable")
        return AgentTrajectory(agent, frame_id, stamps[order], np.array(self._positions)[order])
