"""Points of many scans gathered into the mean of each small cell, in bounded memory."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.extent import anchor
from topometric_ros.voxels.grid import lattice_coordinates
from topometric_ros.voxels.morton import morton_encode

_WAITING = 1_000_000
"""Points gathered before they are sorted into cells: sorting rarely is cheaper."""


class PointAccumulator:
    """Means of the points in each cell of a lattice anchored at the frame's origin.

    Where the first points lie far from it, the lattice is anchored near them instead.

    Parameters
    ----------
    cell : edge of a cell, m
    """

    def __init__(self, cell: float) -> None:
        self.cell = cell
        self._anchor: NDArray[np.float64] | None = None
        self._codes = np.empty(0, np.uint64)
        self._sums = np.empty((0, 4))
        self._waiting: list[NDArray[np.float64]] = []

    def add(self, points: NDArray[np.float64]) -> None:
        """Take points (N, 3) float64, m, finite."""
        if len(points):
            self._waiting.append(points)
        if sum(map(len, self._waiting)) > _WAITING:
            self._sort()

    def points(self) -> NDArray[np.float64]:
        """Return one point, the mean, for each cell that holds any: (K, 3) float64, m."""
        self._sort()
        return self._sums[:, :3] / self._sums[:, 3:]

    def _sort(self) -> None:
        """Move the waiting points into their cells; sums keep a mean independent of the batches."""
        if not self._waiting:
            return
        points = np.concatenate(self._waiting)
        self._waiting = []
        if self._anchor is None:
            self._anchor = anchor(points)
        codes = morton_encode(lattice_coordinates(points, self.cell, self._anchor))
        weighted = np.column_stack([points, np.ones(len(points))])
        self._codes, inverse = np.unique(np.concatenate([self._codes, codes]), return_inverse=True)
        rows = np.concatenate([self._sums, weighted])
        self._sums = np.stack(
            [np.bincount(inverse, rows[:, i], len(self._codes)) for i in range(4)], axis=1
        )
