"""Open3D's fast global registration on FPFH matches, then ICP.

Reference: Q.-Y. Zhou, J. Park, V. Koltun, "Fast global registration", ECCV 2016.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.evaluation.peers.base import PeerResult
from topometric_ros.evaluation.peers.open3d_steps import describe, finish_with_icp


class FastGlobalRegistration:
    """Thinned to `voxel_size` m; a pose is accepted at an ICP fitness of `least_fitness`."""

    name = "fgr_icp"

    def __init__(self, voxel_size: float = 0.3, least_fitness: float = 0.5) -> None:
        self._voxel_size = voxel_size
        self._least_fitness = least_fitness

    def align(self, points_a: NDArray[np.float64], points_b: NDArray[np.float64]) -> PeerResult:
        """Return the pose of the robust line process over feature matches, refined."""
        import open3d as o3d

        registration = o3d.pipelines.registration
        a, b = (describe(points, self._voxel_size) for points in (points_a, points_b))
        option = registration.FastGlobalRegistrationOption(
            maximum_correspondence_distance=0.5 * self._voxel_size
        )
        found = registration.registration_fgr_based_on_feature_matching(
            b.cloud, a.cloud, b.feature, a.feature, option
        )
        T_a_b = np.array(found.transformation)
        return finish_with_icp(a.cloud, b.cloud, T_a_b, self._voxel_size, self._least_fitness)
