"""Registration from no first pose: fast point feature histograms, RANSAC under gravity, ICP.

Features are Open3D's (Rusu, Blodow & Beetz 2009), which is installed anyway. Its RANSAC is not
used: it samples three pairs for six unknowns where gravity leaves four, which two pairs fix, and
gives other poses from run to run. Two pairs whose length on the plan and difference in height agree
make a pose; the one that most pairs agree with wins and is refined.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.fusion.icp import gravity_icp
from topometric_ros.fusion.poses import Transform, yaw_pose
from topometric_ros.fusion.registration_config import (
    Registration,
    RegistrationConfig,
    RegistrationError,
)
from topometric_ros.fusion.surface import Surface
from topometric_ros.matching.hypotheses import register_positions
from topometric_ros.voxels.grid import voxelise

_FEATURE_RADIUS = 5.0
"""Radius of a feature in edges of the thinned cells, as in Open3D's own examples."""

_SAMPLES = 100_000
"""Pairs of correspondences that are drawn; most are dropped at once."""

_TRIED = 2000
"""Poses whose inliers are counted."""

_SHORTEST = 1.0
"""Two correspondences nearer to each other on the plan than this (m) fix no yaw."""


def fpfh_ransac(
    source: Surface,
    target: Surface,
    T_init: Transform,
    config: RegistrationConfig,
    tree: cKDTree | None = None,
) -> Registration:
    """Find the pose by features, then refine it; a :class:`Registrar` that needs no first pose.

    Raises
    ------
    RegistrationError
        Too few points, or no two correspondences that fit.
    """
    size = max(config.feature_size, source.spacing, target.spacing)
    near, far = _thinned(source, size), _thinned(target, size)
    if min(len(near), len(far)) < config.smallest_pairs:
        raise RegistrationError(
            f"only {min(len(near), len(far))} cells of {size:g} m have a known side; "
            f"at least {config.smallest_pairs} are needed"
        )
    features_near, features_far = _features(near, size), _features(far, size)
    of_far = cKDTree(features_far).query(features_near)[1]
    T = _ransac(near.points, far.points[of_far], 1.5 * size, config.seed)
    return gravity_icp(source, target, T, config, tree)


def _thinned(surface: Surface, size: float) -> Surface:
    """Return one point a cell of those that know their free side: only their normals have a sign.

    Each takes the mean point of its cell and the summed normal.
    """
    own = surface.take(surface.sided)
    if len(own) == 0:
        return own
    grid, row = voxelise(own.points, size, own.points.min(axis=0))
    counts = np.bincount(row, minlength=len(grid))[:, None]
    points, normals = np.zeros((len(grid), 3)), np.zeros((len(grid), 3))
    np.add.at(points, row, own.points)
    np.add.at(normals, row, own.normals)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    kept = length[:, 0] > 0.5
    normals = normals[kept] / length[kept]
    return Surface(points[kept] / counts[kept], normals, np.ones(len(normals), bool), size)


def _features(surface: Surface, size: float) -> NDArray[np.float64]:
    """Return the fast point feature histogram of each point: (n, 33)."""
    import open3d

    o3d: Any = open3d  # Its stubs ask for arguments that have defaults.
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(surface.points))
    cloud.normals = o3d.utility.Vector3dVector(surface.normals)
    search = o3d.geometry.KDTreeSearchParamHybrid(radius=_FEATURE_RADIUS * size, max_nn=100)
    found = o3d.pipelines.registration.compute_fpfh_feature(cloud, search)
    return np.asarray(found.data).T


def _ransac(
    source: NDArray[np.float64], target: NDArray[np.float64], gate: float, seed: int
) -> Transform:
    """Return the yaw and translation that most correspondences (n, 3) each agree with."""
    drawn = np.random.default_rng(seed).integers(len(source), size=(_SAMPLES, 2))
    i, j = drawn[:, 0], drawn[:, 1]
    arm_s, arm_t = source[j] - source[i], target[j] - target[i]
    length_s, length_t = np.hypot(*arm_s.T[:2]), np.hypot(*arm_t.T[:2])
    fits = (
        (length_s > _SHORTEST)
        & (np.abs(length_s - length_t) < gate)
        & (np.abs(arm_s[:, 2] - arm_t[:, 2]) < gate)
    )
    rows = np.flatnonzero(fits)[:_TRIED]
    if len(rows) == 0:
        raise RegistrationError(f"no two of {len(source)} feature matches fit each other")
    yaws = np.arctan2(arm_t[rows, 1], arm_t[rows, 0]) - np.arctan2(arm_s[rows, 1], arm_s[rows, 0])
    best, most = np.eye(4), -1
    for yaw, a, b in zip(yaws, i[rows], j[rows], strict=True):
        T = _through(source[[a, b]], target[[a, b]], float(yaw))
        agree = _agree(T, source, target, gate)
        if agree.sum() > most:
            best, most = T, int(agree.sum())
    for _ in range(3):
        agree = _agree(best, source, target, gate)
        best, _ = register_positions(target[agree], source[agree])
    return best


def _agree(
    T: Transform, source: NDArray[np.float64], target: NDArray[np.float64], gate: float
) -> NDArray[np.bool_]:
    off = source @ T[:3, :3].T + T[:3, 3] - target
    agree: NDArray[np.bool_] = np.einsum("ij,ij->i", off, off) < gate**2
    return agree


def _through(source: NDArray[np.float64], target: NDArray[np.float64], yaw: float) -> Transform:
    """Return the pose of a known yaw that brings the middles of both together."""
    T = yaw_pose(yaw, (0.0, 0.0, 0.0))
    T[:3, 3] = target.mean(axis=0) - T[:3, :3] @ source.mean(axis=0)
    return T
