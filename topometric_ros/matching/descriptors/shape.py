"""How far a room's surfaces lie from each other, and how they are spread over height.

Two histograms in one vector. The first is of horizontal distances between pairs of voxels (the
shape distribution D2 of Osada et al. 2002, in the plane), the second of heights above the room's
lowest voxel. Neither changes with yaw or place, and a part that was not seen takes from every bin a
little instead of moving a single number a lot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.distance import pdist

from topometric_ros.matching.descriptors.base import room_voxels
from topometric_ros.topometric_map import TopometricMap

_DISTANCES = np.arange(0.0, 10.1, 0.5)
_HEIGHTS = np.arange(0.0, 4.1, 0.25)
_POINTS = 400
"""Voxels a room that pairs are made of: evenly many along the Morton order."""


@dataclass(frozen=True)
class ShapeDescriptor:
    """Shares of pairs by horizontal distance and of voxels by height, in percent."""

    version: int = 1

    @property
    def name(self) -> str:
        """What the descriptor is called in a map."""
        return "shape"

    @property
    def dimension(self) -> int:
        """Number of bins of both histograms; the last of each is open."""
        return len(_DISTANCES) + len(_HEIGHTS)

    @property
    def by_ratio(self) -> bool:
        """Whether values are compared by their logarithm."""
        return True

    def __call__(
        self, topometric_map: TopometricMap, members: Sequence[Sequence[int]] | None = None
    ) -> NDArray[np.float32]:
        """Describe every room, or each set of rooms in `members` merged: (R, 38) float32."""
        size = topometric_map.voxel_size
        rows = [
            self.histograms(voxels.astype(np.float64) * size)
            for voxels in room_voxels(topometric_map, members)
        ]
        return np.array(rows, dtype=np.float32).reshape(-1, self.dimension)

    def histograms(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return both histograms of a room's cell centres (n, 3), m: (38,), percent."""
        if len(points) < 2:
            return np.zeros(self.dimension)
        chosen = points[np.linspace(0, len(points) - 1, min(len(points), _POINTS)).astype(int)]
        above = points[:, 2] - points[:, 2].min()
        return np.concatenate(
            [
                _percent(pdist(chosen[:, :2]), _DISTANCES),
                _percent(above, _HEIGHTS),
            ]
        )


def _percent(values: NDArray[np.float64], edges: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the share of values from each edge on to the next, the last one open, in percent."""
    bins = np.minimum((values / (edges[1] - edges[0])).astype(np.int64), len(edges) - 1)
    return 100.0 * np.bincount(bins, minlength=len(edges)) / len(values)
