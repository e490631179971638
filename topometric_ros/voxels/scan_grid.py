"""ScanGrid: points of many scans in small cells, and what later scans looked through.

Each cell keeps the mean of its points, the number of scans that hit it and of those whose rays
passed close by that mean and ended beyond. A ray that skims a wall enters many of its cells but
comes near the mean point of few, so walls are not eaten; a person who has walked on is looked
through at once. Memory grows with the surface that was ever hit, not with scans or volume.

Evidence is counted by scans rather than by points, as in occupancy grids (Moravec & Elfes 1985;
Hornung et al. 2013, whose rule that a scan's hits outweigh its misses is kept), by a ratio in place
of log-odds: what stood for long must be looked through for long.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.voxels import scan_kernels as kernels

_FARTHEST = 50_000.0
_MOST_CELLS = 2_000_000
"""Points farther from the anchor than so many m or cells are left out: no lattice reaches them."""


@dataclass(frozen=True)
class ScanConfig:
    """When a cell of the scans counts as empty again: scan mode only."""

    carve: bool = parameter(True, "Drop what later scans look through, as a person who walked on.")
    core: float = parameter(
        0.025,
        "A ray that passes a cell's mean point this near looks through the cell.",
        unit="m",
        minimum=0.005,
        maximum=0.1,
    )
    margin: float = parameter(
        0.15,
        "The last stretch of a ray, which clears nothing: noise and drift end short of it.",
        unit="m",
        minimum=0.0,
        maximum=2.0,
    )
    reach: float = parameter(
        20.0, "How far from the sensor a ray clears.", unit="m", minimum=0.5, maximum=30.0
    )
    least: int = parameter(
        1,
        "Scans that must have looked through a cell before it is dropped.",
        minimum=1,
        maximum=100,
    )
    ratio: float = parameter(
        1.0,
        "A cell is dropped that this many times as many scans looked through as hit it.",
        minimum=0.1,
        maximum=100.0,
    )


class ScanGrid:
    """Cells of one map's scans.

    Parameters
    ----------
    cell : edge of a cell, m
    anchor : (3,) float64, m, the centre of cell (0, 0, 0)
    config : ScanConfig
    """

    def __init__(self, cell: float, anchor: NDArray[np.float64], config: ScanConfig) -> None:
        self.cell = cell
        self.config = config
        self._anchor = np.asarray(anchor, np.float64)
        self._used = np.zeros(2, np.int64)
        self._keys = np.full(1 << 12, kernels.EMPTY, np.int64)
        self._numbers = np.zeros(1 << 12, np.int32)
        self._bricks = np.zeros(1 << 11, np.int64)
        self._rows = np.full((1 << 11, 64), kernels.EMPTY, np.int32)
        self._sums = np.zeros((1 << 14, 3), np.float32)
        self._counts = np.zeros(1 << 14, np.uint16)
        self._evidence = np.zeros((1 << 14, 5), np.uint8)
        self._scan = 0

    def add(self, points: NDArray[np.float64], origin: NDArray[np.float64] | None = None) -> int:
        """Take one scan.

        Parameters
        ----------
        points : (N, 3) float64, m, map frame, finite
        origin : (3,) float64, m, where the sensor was; None where it is not known: nothing is
            looked through then

        Returns
        -------
        How many points were left out since they lie too far from the anchor: 50 km, or less
        where the cells are under 2.5 cm.
        """
        relative = points - self._anchor
        farthest = min(_FARTHEST, _MOST_CELLS * self.cell)
        near = (np.abs(relative) < farthest).all(axis=1)
        left_out = len(points) - int(np.count_nonzero(near))
        if left_out:
            relative = relative[near]
        # The cells remember in one byte when they were last hit; 0 is never.
        self._scan = self._scan % 255 + 1
        ends = self._put(np.ascontiguousarray(relative))
        if origin is not None and self.config.carve:
            self._look_through(np.asarray(origin, np.float64) - self._anchor, relative[ends])
        return left_out

    def points(self) -> NDArray[np.float64]:
        """Return the mean point of each cell kept: (K, 3) float64, m, in an order of its own.

        The order depends on the cells alone. :meth:`change` counts from here.
        """
        bricks = self._bricks[: self._used[0]]
        kept, _ = self._changes()
        found = kernels.means(
            self._bricks, np.argsort(bricks), self._rows, self._sums, self._counts,
            self._evidence, self.cell, self.config.least, self.config.ratio, kept,
        )  # fmt: skip
        return np.asarray(found + self._anchor)

    def change(self) -> float:
        """Return the share of cells that came or went since the points were last taken: 0 to 1."""
        kept, changed = self._changes()
        return changed / max(kept, changed, 1)

    @property
    def cells(self) -> int:
        """How many cells hold points, kept or carved."""
        return int(self._used[1])

    @property
    def memory(self) -> int:
        """Bytes taken."""
        tables = (self._keys, self._numbers, self._bricks, self._rows)
        return sum(a.nbytes for a in (*tables, self._sums, self._counts, self._evidence))

    def _changes(self) -> tuple[int, int]:
        rule = self.config
        kept, changed = kernels.changes(self._evidence, self._used[1], rule.least, rule.ratio)
        return int(kept), int(changed)

    def _put(self, points: NDArray[np.float64]) -> NDArray[np.int64]:
        """Put points into cells; return the first point of each cell hit: (E,)."""
        ends = np.empty(len(points), np.int64)
        place = (0, 0)
        while True:
            place = kernels.put(
                self._keys, self._numbers, self._bricks, self._rows, self._sums, self._counts,
                self._evidence, self._used, points, self.cell, self._scan, ends, place,
            )  # fmt: skip
            if place[0] == len(points):
                return ends[: place[1]]
            self._grow()

    def _grow(self) -> None:
        """Make room in the table that is full."""
        bricks, cells = self._used
        if cells == len(self._counts):
            self._sums, self._counts, self._evidence = (
                _longer(a, 0) for a in (self._sums, self._counts, self._evidence)
            )
        if bricks == len(self._bricks):
            self._bricks = _longer(self._bricks, 0)
            self._rows = _longer(self._rows, kernels.EMPTY)
            size = len(self._keys)
            while size < 2 * len(self._bricks):
                size *= 2
            self._keys = np.full(size, kernels.EMPTY, np.int64)
            self._numbers = np.zeros(size, np.int32)
            kernels.rehash(self._keys, self._numbers, self._bricks, bricks)

    def _look_through(self, origin: NDArray[np.float64], ends: NDArray[np.float64]) -> None:
        rays = ends - origin
        lengths = np.linalg.norm(rays, axis=1)
        shortened = np.minimum(lengths - self.config.margin, self.config.reach)
        far = shortened > 0.0
        drawn = origin + rays[far] * (shortened[far] / lengths[far])[:, None]
        kernels.look_through(
            self._keys, self._numbers, self._rows, self._sums, self._counts, self._evidence,
            origin, drawn, self.cell, self.config.core, self._scan,
        )  # fmt: skip


def _longer(array: Any, fill: int) -> Any:
    """Return an array half as long again, the new rows filled."""
    more = np.full((len(array) // 2 + 1, *array.shape[1:]), fill, array.dtype)
    return np.concatenate([array, more])
