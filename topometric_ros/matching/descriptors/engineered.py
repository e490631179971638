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
from topometric_ros.matching.planes import fit_planes
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
    version: int = 1

    @property
    def name(self) -> str:
        """The name tells the kind of box, which changes the numbers."""
        return "engineered" if self.box == "oriented" else "engineered_axis_aligned"

    @property
    def dimension(self) -> int:
        """Number of features."""
        return len(FEATURES)

    def __call__(
        self, topometric_map: TopometricMap, members: Sequence[Sequence[int]] | None = None
    ) -> NDArray[np.float32]:
        """Describe every room, or each set of rooms in `members` merged: (R, 9) float32."""
        size = topometric_map.voxel_size
        rows = [
            self.features(voxels.astype(np.float64) * size, size)
            for voxels in room_voxels(topometric_map, members)
        ]
        return np.array(rows, dtype=np.float32).reshape(-1, self.dimension)

    def features(self, points: NDArray[np.float64], voxel_size: float) -> list[float]:
        """Return the nine features of a room's cell centres (n, 3), m; zeros without points."""
        if len(points) == 0:
            return [0.0] * self.dimension
        height = float(np.ptp(points[:, 2]))
        length, width = self._sides(points[:, :2])
        centred = points - points.mean(axis=0)
        eigenvalues, vectors = np.linalg.eigh(centred.T @ centred / len(points))
        third, second, first = np.maximum(eigenvalues, 0.0)
        tiny = np.finfo(float).tiny
        _, plane_distances = fit_planes(points, self.roughness_neighbours)
        return [
            length * width * height,
            height,
            length * width,
            float(np.linalg.norm(centred, axis=1).mean()),
            len(points) * voxel_size**2,
            float(first / max(second + third, tiny)) if first > 0 else 0.0,
            float(third / max(first + second, tiny)),
            float(abs(vectors[2, 2])),
            float(plane_distances.mean()),
        ]

    def _sides(self, horizontal: NDArray[np.float64]) -> tuple[float, float]:
        """Return the two sides (m) of the horizontal bounding rectangle of points (n, 2)."""
        aligned = np.ptp(horizontal, axis=0)
        if self.box == "axis_aligned" or len(horizontal) < 3 or aligned.min() == 0:
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
