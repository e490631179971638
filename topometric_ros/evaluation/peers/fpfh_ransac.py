"""Open3D's classic pipeline: FPFH features, RANSAC over their matches, ICP.

Reference: R. B. Rusu et al., "Fast point feature histograms (FPFH) for 3D registration", ICRA 2009.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.evaluation.peers.base import PeerResult
from topometric_ros.evaluation.peers.open3d_steps import describe, finish_with_icp

_SEED = 0


class FpfhRansac:
    """Thinned to `voxel_size` m; a pose is accepted at an ICP fitness of `least_fitness`."""

    name = "fpfh_ransac_icp"

    def __init__(
        self,
        voxel_size: float = 0.3,
        least_fitness: float = 0.5,
        iterations: int = 100_000,
    ) -> None:
        self._voxel_size = voxel_size
        self._least_fitness = least_fitness
        self._iterations = iterations

    def align(self, points_a: NDArray[np.float64], points_b: NDArray[np.float64]) -> PeerResult:
        """Return the pose with the most consistent feature matches, refined."""
        import open3d as o3d

        registration = o3d.pipelines.registration
        o3d.utility.random.seed(_SEED)
        a, b = (describe(points, self._voxel_size) for points in (points_a, points_b))
        gate = 1.5 * self._voxel_size
        found = registration.registration_ransac_based_on_feature_matching(
            b.cloud,
            a.cloud,
            b.feature,
            a.feature,
            True,
            gate,
            registration.TransformationEstimationPointToPoint(False),
            3,
            [
                registration.CorrespondenceCheckerBasedOnEdgeLength(0.9),
                registration.CorrespondenceCheckerBasedOnDistance(gate),
            ],
            registration.RANSACConvergenceCriteria(self._iterations, 0.999),
        )
        T_a_b = np.array(found.transformation)
        return finish_with_icp(a.cloud, b.cloud, T_a_b, self._voxel_size, self._least_fitness)
