"""The code of a point-completion autoencoder (thesis §4.3.4).

The encoder was trained to give the code from which the complete room can be made, and to give two
partial views of one room codes that are near each other; `training/` holds how. It is run by
onnxruntime (extra `learned`). A room is brought into the direction of its walls; which of the four
quarter turns is the right one cannot be told, so the code is the mean of all four.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.matching.descriptors.base import room_voxels
from topometric_ros.matching.main_direction import sharpest_direction
from topometric_ros.matching.onnx_network import onnx_network
from topometric_ros.topometric_map import TopometricMap

MODEL = Path(__file__).with_suffix(".onnx")

_POINTS = 512
"""Voxels a room that the encoder sees: evenly many along the Morton order."""

_CELL = 0.1
"""Edge of the columns that walls are told by, m."""

_WALL = 8
"""A column with so many voxels belongs to a wall."""

_GRIDS = ((45.0, 1.5), (1.5, 0.3))
"""Half-range and step of the wall directions that are tried, °."""


@dataclass(frozen=True)
class LearnedDescriptor:
    """The mean code of a room's four quarter turns.

    Raises
    ------
    ConfigurationError
        On the first room: onnxruntime is not installed.
    """

    version: int = 1

    @property
    def name(self) -> str:
        """What the descriptor is called in a map."""
        return "learned"

    @property
    def dimension(self) -> int:
        """Length of the code."""
        return 128

    @property
    def by_ratio(self) -> bool:
        """A code is no size; it has both signs."""
        return False

    def __call__(
        self, topometric_map: TopometricMap, members: Sequence[Sequence[int]] | None = None
    ) -> NDArray[np.float32]:
        """Describe every room, or each set of rooms in `members` merged: (R, 128) float32."""
        size = topometric_map.voxel_size
        rows = [
            self.code(voxels.astype(np.float64) * size)
            for voxels in room_voxels(topometric_map, members)
        ]
        return np.array(rows, dtype=np.float32).reshape(-1, self.dimension)

    def code(self, points: NDArray[np.float64]) -> NDArray[np.float32]:
        """Return the code of a room's cell centres (n, 3), m: (128,)."""
        if len(points) == 0:
            return np.zeros(self.dimension, dtype=np.float32)
        turned = turned_copies(points).astype(np.float32)
        codes = onnx_network(MODEL, "matching.descriptors.names: learned")({"points": turned})[0]
        mean: NDArray[np.float32] = codes.mean(axis=0)
        return mean


def turned_copies(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (n, 3) along their walls, in four quarter turns: (4, at most 512, 3), m."""
    yaw = wall_direction(points)
    rows = np.linspace(0, len(points) - 1, min(len(points), _POINTS)).astype(int)
    c, s = np.cos(yaw), np.sin(yaw)
    along = centred(points[rows] @ np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]))
    x, y, z = along.T
    return np.stack(
        [np.stack(axes, axis=1) for axes in ((x, y, z), (-y, x, z), (-x, -y, z), (y, -x, z))]
    )


def centred(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (n, 3) about the middle of their extent, the floor at z = 0.

    The extent leaves out two points of a hundred at each end.
    """
    low, high = np.quantile(points, (0.02, 0.98), axis=0)
    return points - np.array([(low[0] + high[0]) / 2, (low[1] + high[1]) / 2, low[2]])


def wall_direction(points: NDArray[np.float64]) -> float:
    """Return the direction of most walls of one room (n, 3), in [0, π/2) rad."""
    cells = np.round(points[:, :2] / _CELL).astype(np.int64)
    columns, count = np.unique(cells, axis=0, return_counts=True)
    walls = columns[count >= _WALL]
    chosen = (walls if len(walls) >= 10 else columns).astype(np.float64)
    return sharpest_direction([_CELL * chosen], _GRIDS)
