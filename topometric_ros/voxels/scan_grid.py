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

from collections.abc import Mapping
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
            start = np.asarray(origin, np.float64) - self._anchor
            self._look_through(start, relative[ends], self._evidence, self._scan)
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

    def fit(self, points: NDArray[np.float64], origin: NDArray[np.float64]) -> tuple[int, int]:
        """Return how a scan fits what is known, changing nothing.

        Parameters
        ----------
        points, origin : as of :meth:`add`

        Returns
        -------
        How many cells kept lie where the scan has points or beside them, and how many others its
        rays look through. The first is the larger of one that lies where it belongs; both are few
        where nothing was known yet.
        """
        count = self._used[1]
        evidence = self._evidence.copy()
        kept = kernels.kept(evidence[:count], self.config.least, self.config.ratio)
        evidence[:, [kernels.HIT_AT, kernels.MISSED_AT]] = 0
        relative = np.ascontiguousarray(points - self._anchor)
        kernels.hit_beside(self._keys, self._numbers, self._rows, evidence, relative, self.cell, 1)
        self._look_through(origin - self._anchor, relative, evidence, 1)
        hit, missed = (
            evidence[:count, column] == 1 for column in (kernels.HIT_AT, kernels.MISSED_AT)
        )
        return int((hit & kept).sum()), int((missed & kept).sum())

    def held(self) -> dict[str, NDArray[Any]]:
        """Return all that the cells hold, of which :meth:`of` makes the same grid again.

        `cells` (K, 3) int32, `sums` (K, 3) float32, m, `counts` (K,) int32, `evidence` (K, 5) int8.
        """
        bricks, count = self._used
        number, place = np.nonzero(self._rows[:bricks] >= 0)
        cells = np.empty((count, 3), np.int32)
        cells[self._rows[number, place]] = kernels.cells_of(self._bricks[number], place)
        return {
            "cells": cells,
            "sums": self._sums[:count].copy(),
            "counts": self._counts[:count].astype(np.int32),
            "evidence": self._evidence[:count].view(np.int8).copy(),
        }

    @classmethod
    def of(
        cls,
        cell: float,
        anchor: NDArray[np.float64],
        config: ScanConfig,
        scan: int,
        held: Mapping[str, NDArray[Any]],
    ) -> ScanGrid:
        """Return a grid of what another one held, after so many scans (1 to 255, in a circle).

        Raises
        ------
        ValueError
            What is given contradicts itself.
        """
        cells, sums, counts, evidence = (held[k] for k in ("cells", "sums", "counts", "evidence"))
        shapes = [a.shape for a in (cells, sums, counts, evidence)]
        if shapes != [(len(cells), 3), (len(cells), 3), (len(cells),), (len(cells), 5)]:
            raise ValueError(f"cells, sums, counts and evidence of shapes {shapes}")
        if not (
            np.isfinite(anchor).all() and (np.abs(cells) < _MOST_CELLS).all() and 0 < scan < 256
        ):
            raise ValueError("an anchor, a cell or a count of scans out of range")
        if not ((counts > 0) & (counts <= kernels.FULLEST)).all():
            raise ValueError("a cell of no point or of too many")
        if not (np.abs(sums) <= cell * counts[:, None]).all():
            raise ValueError("a mean point outside of its cell")
        grid = cls(cell, anchor, config)
        grid._put(cells * cell)
        if grid.cells != len(cells):
            raise ValueError("a cell twice")
        grid._scan = scan
        rows = slice(len(cells))
        grid._sums[rows], grid._counts[rows] = sums, counts
        grid._evidence[rows] = evidence.view(np.uint8)
        return grid

    def change(self) -> float:
        """Return the share of cells that came or went since the points were last taken: 0 to 1."""
        kept, changed = self._changes()
        return changed / max(kept, changed, 1)

    @property
    def anchor(self) -> NDArray[np.float64]:
        """(3,) float64, m, the centre of cell (0, 0, 0)."""
        return self._anchor

    @property
    def scan(self) -> int:
        """The number of the newest scan, 1 to 255 in a circle; 0 before the first."""
        return self._scan

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

    def _look_through(
        self,
        origin: NDArray[np.float64],
        ends: NDArray[np.float64],
        evidence: NDArray[np.uint8],
        now: int,
    ) -> None:
        rays = ends - origin
        lengths = np.linalg.norm(rays, axis=1)
        shortened = np.minimum(lengths - self.config.margin, self.config.reach)
        far = shortened > 0.0
        drawn = origin + rays[far] * (shortened[far] / lengths[far])[:, None]
        kernels.look_through(
            self._keys, self._numbers, self._rows, self._sums, self._counts, evidence,
            origin, drawn, self.cell, self.config.core, now,
        )  # fmt: skip


def _longer(array: Any, fill: int) -> Any:
    """Return an array half as long again, the new rows filled."""
    more = np.full((len(array) // 2 + 1, *array.shape[1:]), fill, array.dtype)
    return np.concatenate([array, more])
