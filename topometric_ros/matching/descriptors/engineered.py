"""Nine engineered features of a room's geometry (thesis §4.3.2), z up.

They are stored in their own units (m, m², m³); the distance between rooms standardises each over
the rooms of both maps, so that no unit drowns the rest. Two readings differ from the draft so that
the same room gives the same numbers in every frame and at every voxel size: the bounding box is the
smallest upright one (`box="oriented"`), and the number of points is the surface they cover.
"Quotient of eigenvalues" is λ1 / (λ2 + λ3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError

from topometric_ros.matching.descriptors.base import room_voxels
from topometric_ros.matching.descriptors.roughness import roughness
from topometric_ros.topometric_map import TopometricMap

FEATURES = (
    "volume",
    "height",
    "horizontal_area",
    "mean_distance_to_centroid",
    "surface",
    "quotient_of_eigenvalues",
    "smallest_to_largest_eigenvalues",
    "verticality",
    "roughness",
)


@dataclass(frozen=True)
class EngineeredDescriptor:
    """The nine features in the order of :data:`FEATURES`."""

    box: str = "oriented"
    roughness_neighbours: int = 12
    version: int = 2

    @property
    def name(self) -> str:
        """The name tells the kind of box, which changes the numbers."""
        return "engineered" if self.box == "oriented" else "engineered_axis_aligned"

    @property
    def dimension(self) -> int:
        """Number of features."""
        return len(FEATURES)

    @property
    def by_ratio(self) -> bool:
        """Whether values are compared by their logarithm."""
        return True

    def __call__(
        self, topometric_map: TopometricMap, members: Sequence[Sequence[int]] | None = None
    ) -> NDArray[np.float32]:
        """Describe every room, or each set of rooms in `members` merged: (R, 9) float32."""
        size = topometric_map.voxel_size
        rows = [self.features(voxels, size) for voxels in room_voxels(topometric_map, members)]
        return np.array(rows, dtype=np.float32).reshape(-1, self.dimension)

    def features(self, voxels: NDArray[np.int32], voxel_size: float) -> list[float]:
        """Return the nine features of a room's voxels (n, 3), edge in m; zeros without voxels."""
        if len(voxels) == 0:
            return [0.0] * self.dimension
        points = voxels.astype(np.float64) * voxel_size
        height = float(np.ptp(points[:, 2]))
        length, width = bounding_sides(_outline(voxels) * np.float64(voxel_size), self.box)
        centred = points - points.mean(axis=0)
        eigenvalues, vectors = np.linalg.eigh(centred.T @ centred / len(points))
        third, second, first = np.maximum(eigenvalues, 0.0)
        tiny = np.finfo(float).tiny
        return [
            length * width * height,
            height,
            length * width,
            float(np.linalg.norm(centred, axis=1).mean()),
            len(points) * voxel_size**2,
            float(first / max(second + third, tiny)) if first > 0 else 0.0,
            float(third / max(first + second, tiny)),
            float(abs(vectors[2, 2])),
            roughness(voxels, self.roughness_neighbours) * voxel_size,
        ]


def _outline(voxels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the first and last cell of every row along y, seen from above: (m, 2) int32."""
    low = voxels[:, 0].min()
    first = np.full(voxels[:, 0].max() - low + 1, np.iinfo(np.int32).max, np.int32)
    last = np.full(len(first), np.iinfo(np.int32).min, np.int32)
    np.minimum.at(first, voxels[:, 0] - low, voxels[:, 1])
    np.maximum.at(last, voxels[:, 0] - low, voxels[:, 1])
    held = np.flatnonzero(last >= first)
    ends = [np.stack([held + low, side[held]], 1) for side in (first, last)]
    return np.concatenate(ends).astype(np.int32)


def bounding_sides(horizontal: NDArray[np.float64], box: str) -> tuple[float, float]:
    """Return the two sides of the smallest rectangle round points (n, 2), or the aligned one.

    `box` is "oriented" or "axis_aligned".
    """
    aligned = np.ptp(horizontal, axis=0)
    if box == "axis_aligned" or len(horizontal) < 3 or aligned.min() == 0:
        return float(aligned[0]), float(aligned[1])
    try:
        hull = horizontal[ConvexHull(horizontal).vertices]
    except QhullError:  # all points on one oblique line
        return float(np.linalg.norm(aligned)), 0.0
    edges = np.roll(hull, -1, axis=0) - hull
    along = edges / np.linalg.norm(edges, axis=1, keepdims=True)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1)
    lengths, widths = np.ptp(hull @ along.T, axis=0), np.ptp(hull @ across.T, axis=0)
    smallest = int(np.argmin(lengths * widths))
    return float(lengths[smallest]), float(widths[smallest])
