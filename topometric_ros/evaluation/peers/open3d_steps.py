"""The steps that the two Open3D pipelines share: features on a thinned cloud, then ICP.

References: R. B. Rusu et al., "Fast point feature histograms (FPFH) for 3D registration", ICRA
2009; Q.-Y. Zhou et al., "Open3D: a modern library for 3D data processing", 2018. Radii as in
Open3D's own tutorial: normals from twice the voxel edge, features from five times.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.evaluation.peers.base import PeerResult

_NORMAL_RADIUS = 2.0
_FEATURE_RADIUS = 5.0
_ICP_DISTANCES = (1.5, 0.5)
"""Gates of the two rounds of ICP in voxel edges."""


@dataclass(frozen=True)
class Described:
    """A thinned cloud with normals (an Open3D cloud) and the FPFH feature of each point."""

    cloud: Any
    feature: Any


def describe(points: NDArray[np.float64], voxel_size: float) -> Described:
    """Thin a cloud (N, 3), m, to `voxel_size` (m) and compute the features of what is left."""
    import open3d

    # Its stubs ask for arguments that have defaults.
    o3d: Any = open3d
    raw = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points))
    cloud = raw.voxel_down_sample(voxel_size)
    tree = o3d.geometry.KDTreeSearchParamHybrid
    cloud.estimate_normals(tree(radius=_NORMAL_RADIUS * voxel_size, max_nn=30))
    feature = o3d.pipelines.registration.compute_fpfh_feature(
        cloud, tree(radius=_FEATURE_RADIUS * voxel_size, max_nn=100)
    )
    return Described(cloud, feature)


def finish_with_icp(
    a: Any, b: Any, T_a_b: NDArray[np.float64], voxel_size: float, least_fitness: float
) -> PeerResult:
    """Refine a pose by point-to-plane ICP; accept it where ICP's fitness is high enough.

    `a` and `b` are Open3D clouds, `a` with normals. The fitness is the share of b's points with a
    neighbour in a within half a voxel edge; Open3D leaves the rule to its user.
    """
    import open3d as o3d

    registration = o3d.pipelines.registration
    fitness = 0.0
    for factor in _ICP_DISTANCES:
        refined = registration.registration_icp(
            b,
            a,
            factor * voxel_size,
            T_a_b,
            registration.TransformationEstimationPointToPlane(),
            registration.ICPConvergenceCriteria(max_iteration=30),
        )
        T_a_b, fitness = np.array(refined.transformation), float(refined.fitness)
    return PeerResult(T_a_b, fitness >= least_fitness, fitness)
