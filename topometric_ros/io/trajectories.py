"""Where agents were while they mapped: NAME.trajectories.json beside a map file or a cloud.

Maps do not carry it, since nobody needs it to merge; it is kept beside them for those who look at
them. The same file is written by whatever knows the poses and read wherever a map is loaded.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError, one_line
from topometric_ros.io.summaries import write_atomically

SCHEMA = "topometric-trajectories/1"


class TrajectoryError(TopometricError):
    """A file of trajectories that makes no sense."""


@dataclass(frozen=True)
class AgentTrajectory:
    """Where one agent's sensor was.

    `stamps` (N,) int64, ns since the epoch, not decreasing; `positions` (N, 3) float64, m, in
    `frame_id`, the frame of the points that the agent's map was made of.
    """

    agent: str
    frame_id: str
    stamps: NDArray[np.int64]
    positions: NDArray[np.float64]

    def moved(self, T_target_frame: NDArray[np.float64]) -> AgentTrajectory:
        """Return the same way in another frame, (4, 4)."""
        positions = self.positions @ T_target_frame[:3, :3].T + T_target_frame[:3, 3]
        return replace(self, positions=positions)


def trajectories_path(path: Path) -> Path:
    """Return where the trajectories of a map file or a cloud are.

    Examples
    --------
    >>> trajectories_path(Path("out/global.tmap")).name
    'global.trajectories.json'
    """
    return path.with_name(f"{path.stem}.trajectories.json")


def write_trajectories(path: Path, trajectories: Sequence[AgentTrajectory]) -> None:
    """Write the file beside `path`; without trajectories an older one is removed."""
    target = trajectories_path(path)
    if not trajectories:
        target.unlink(missing_ok=True)
        return
    agents = [
        {
            "id": entry.agent,
            "frame_id": entry.frame_id,
            "stamps": [int(stamp) for stamp in entry.stamps],
            "positions": np.round(entry.positions, 3).tolist(),
        }
        for entry in trajectories
    ]
    data = json.dumps({"schema": SCHEMA, "agents": agents}, allow_nan=False)
    write_atomically(target, f"{data}\n".encode())


def read_trajectories(path: Path) -> tuple[AgentTrajectory, ...]:
    """Return the trajectories beside `path`, none where there is no such file.

    Raises
    ------
    TrajectoryError
        The file is damaged or of an unknown schema.
    """
    source = trajectories_path(path)
    if not source.is_file():
        return ()
    try:
        content = json.loads(source.read_text(encoding="utf-8"))
        if content["schema"] != SCHEMA:
            raise ValueError(f"schema: expected {SCHEMA}, got {content['schema']!r}")
        return tuple(_trajectory(entry) for entry in content["agents"])
    except (OSError, ValueError, KeyError, TypeError, OverflowError, RecursionError) as error:
        raise TrajectoryError(f"{source}: not a file of trajectories: {one_line(error)}") from error


def trajectory_of(path: Path, agent: str) -> AgentTrajectory | None:
    """Return the trajectory that the file beside an agent's map or cloud holds, None without one.

    The only one, whatever it is called, or that of `agent`.

    Raises
    ------
    TrajectoryError
        As :func:`read_trajectories`.
    """
    found = read_trajectories(path)
    return found[0] if len(found) == 1 else next((t for t in found if t.agent == agent), None)


def _trajectory(entry: dict[str, Any]) -> AgentTrajectory:
    stamps = np.array(entry["stamps"], np.int64).reshape(-1)
    positions = np.array(entry["positions"], np.float64).reshape(-1, 3)
    if len(stamps) != len(positions) or not np.isfinite(positions).all():
        raise ValueError(f"{entry['id']}: {len(stamps)} stamps, {len(positions)} finite positions")
    return AgentTrajectory(str(entry["id"]), str(entry["frame_id"]), stamps, positions)
