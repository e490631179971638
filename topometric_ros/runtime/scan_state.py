"""What an agent's scans came to, as a file: an extractor that starts again need not gather anew.

The container is that of a .tmap file (`io/map_format.py`): sizes and checksums are verified before
anything is believed. The file holds the cells that scans are gathered in and the sensor's way, not
the map: that is extracted again. Written in one step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.io.map_format import MapFileError, Section, encode, read_sections
from topometric_ros.io.packing import PackingError
from topometric_ros.io.summaries import floats, write_atomically
from topometric_ros.io.trajectories import AgentTrajectory
from topometric_ros.voxels.scan_grid import ScanConfig, ScanGrid

SCHEMA = "topometric-scans/1"

_AGAINST = 0.1
"""Cells that scans look through, as a share of those they hit again, above which they do not fit.

On the demo's walks it is at most 0.02; with the frame turned by 20° or more 0.16 to 0.7."""

_JUDGED = 5
"""Scans by which that is judged."""


@dataclass(frozen=True)
class ScanState:
    """The scans of one session: `grid` is what they came to in `frame_id`, `stamp` the newest's."""

    agent: str
    frame_id: str
    stamp: int
    scans: int
    dropped_points: int
    grid: ScanGrid
    way: AgentTrajectory | None


def save_scans(path: Path, state: ScanState) -> None:
    """Write a state in one step: an older file stays until the new one is whole, on the disk.

    Raises
    ------
    MapFileError
        The file cannot be written.
    """
    grid, way = state.grid, state.way
    fields = {
        "schema": SCHEMA,
        **{name: getattr(state, name) for name in ("agent", "frame_id", "stamp", "scans")},
        "dropped_points": state.dropped_points,
        "cell": grid.cell,
        "anchor": floats(grid.anchor),
        "scan": grid.scan,
    }
    arrays = grid.held()
    if way is not None:
        arrays["stamps"] = np.ascontiguousarray(way.stamps).view(np.int32).reshape(-1, 2)
        arrays["positions"] = np.ascontiguousarray(way.positions, np.float64)
    try:
        data = encode(fields, [Section(name, "array", array) for name, array in arrays.items()])
    except (PackingError, ValueError) as error:
        raise MapFileError(f"{path}: the scans cannot be packed: {error}") from error
    write_atomically(path, data, durable=True)


def load_scans(path: Path, config: ScanConfig) -> ScanState:
    """Read a state; its grid goes on by the rules of `config`.

    Raises
    ------
    MapFileError
        The file is missing, damaged, or of another kind or version.
    """
    fields, arrays = read_sections(path, SCHEMA)
    try:
        anchor = np.array(fields["anchor"], np.float64).reshape(3)
        grid = ScanGrid.of(float(fields["cell"]), anchor, config, int(fields["scan"]), arrays)
        agent, frame_id = str(fields["agent"]), str(fields["frame_id"])
        stamp, scans, dropped = (int(fields[k]) for k in ("stamp", "scans", "dropped_points"))
        way = _way(agent, frame_id, arrays)
        return ScanState(agent, frame_id, stamp, scans, dropped, grid, way)
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise MapFileError(f"{path}: the scans make no sense: {error!r}") from error


def _way(agent: str, frame_id: str, arrays: Mapping[str, NDArray[Any]]) -> AgentTrajectory | None:
    if "stamps" not in arrays:
        return None
    stamps = np.ascontiguousarray(arrays["stamps"], np.int32).view(np.int64).reshape(-1)
    positions = arrays["positions"].astype(np.float64).reshape(len(stamps), 3)
    if not np.isfinite(positions).all():
        raise ValueError("a place that is not finite")
    return AgentTrajectory(agent, frame_id, stamps, positions)


class Doubt:
    """Whether scans still belong where those before a restart lie, or a SLAM has begun anew too."""

    def __init__(self, grid: ScanGrid) -> None:
        self._grid = grid
        self._scans: list[tuple[NDArray[np.float64], NDArray[np.float64] | None]] = []
        self._hit = self._through = 0

    def hear(
        self, points: NDArray[np.float64], sensor: NDArray[np.float64] | None
    ) -> list[tuple[NDArray[np.float64], NDArray[np.float64] | None]] | None:
        """Hold a scan, as of :meth:`ScanGrid.add`; return all held where there are enough."""
        self._scans.append((points, sensor))
        if sensor is not None:
            hit, through = self._grid.fit(points, sensor)
            self._hit, self._through = self._hit + hit, self._through + through
        return self._scans if len(self._scans) >= _JUDGED else None

    @property
    def fits(self) -> bool:
        """Whether the scans heard so far lie where the older ones do, or where nothing is known."""
        return self._through <= _AGAINST * self._hit

    def told(self) -> str:
        """Return in words how they do not."""
        return f"they look through {self._through} cells that are known and hit {self._hit} of them"
