"""Deep closest point: counterparts from a network, the transform by SVD, then ICP (thesis §4.4.1).

The network (Wang & Solomon 2019, made small; `training/` holds how it was trained) sees some points
of both surfaces with their normals and gives each source point a place in the target and a weight.
The draft finds that "constraining the registration is difficult as it requires retraining": here
the SVD is outside the network and turns about z only, where it has a closed form. It is trained for
rooms that start within 30° and 1 m of each other, farther than ICP's gates reach. A network cannot
tell where it is wrong: of the start and its answers the pose is taken that brings the most points
onto the target.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.fusion.icp import gravity_icp
from topometric_ros.fusion.poses import Transform, apply
from topometric_ros.fusion.registration_config import (
    Registration,
    RegistrationConfig,
    RegistrationError,
)
from topometric_ros.fusion.surface import Surface
from topometric_ros.matching.hypotheses import register_positions
from topometric_ros.matching.onnx_network import onnx_network

MODEL = Path(__file__).with_suffix(".onnx")

_POINTS = 384
"""Points of each surface that the network sees."""

_ON = 0.4
"""A source point farther than this from the target does not lie on it, m."""

_LEAST_SURE = 1e-9
"""What is added to every weight: where the network trusts no counterpart all weigh alike."""

_ROUNDS = 3
"""So many times the network looks, each time from where the last transform brought the source."""


def deep_closest_point(
    source: Surface,
    target: Surface,
    T_init: Transform,
    config: RegistrationConfig,
    tree: cKDTree | None = None,
) -> Registration:
    """Find the pose by the network's counterparts, then refine it; a :class:`Registrar`.

    Raises
    ------
    ConfigurationError
        onnxruntime is not installed.
    RegistrationError
        The surfaces share too little.
    """
    tree = tree or cKDTree(target.points)
    poses = [T_init, *network_poses(source, target, T_init, config)]
    held = [_held(source, target, tree, T, config.seed) for T in poses]
    return gravity_icp(source, target, poses[int(np.argmax(held))], config, tree)


def network_poses(
    source: Surface, target: Surface, T_init: Transform, config: RegistrationConfig
) -> list[Transform]:
    """Return T_target_source (4, 4) after each look of the network, turning about z only.

    Raises
    ------
    ConfigurationError
        onnxruntime is not installed.
    RegistrationError
        One of the surfaces has fewer than `smallest_pairs` points.
    """
    if min(len(source), len(target)) < config.smallest_pairs:
        raise RegistrationError(
            f"only {min(len(source), len(target))} points; "
            f"at least {config.smallest_pairs} are needed"
        )
    network = onnx_network(MODEL, "registration.method: deep_closest_point")
    source, target = _drawn(source, config.seed), _drawn(target, config.seed)
    middle = target.points.mean(axis=0)
    there = _numbers(target, np.eye(4), middle)
    poses = [T_init]
    for _ in range(_ROUNDS):
        here = _numbers(source, poses[-1], middle)
        counterparts, weights = network({"source": here, "target": there})
        places = counterparts[0].astype(np.float64) + middle
        sure = weights[0].astype(np.float64) + _LEAST_SURE
        poses.append(register_positions(places, source.points, sure)[0])
    return poses[1:]


def _held(source: Surface, target: Surface, tree: cKDTree, T: Transform, seed: int) -> float:
    """Return the share of some source points that lie on the target, the farther the less."""
    source = _drawn(source, seed)
    distance, nearest = tree.query(apply(T, source.points), distance_upper_bound=_ON)
    rows = np.flatnonzero(np.isfinite(distance))
    normals, sided = target.facing(nearest[rows])
    agree = np.einsum("ij,ij->i", source.normals[rows] @ T[:3, :3].T, normals)
    sided &= source.sided[rows]
    right = np.where(sided, agree, np.abs(agree)) > 0.5
    return float((1.0 - distance[rows[right]] / _ON).sum()) / len(source)


def _drawn(surface: Surface, seed: int) -> Surface:
    """Return some of a surface's points, all of them where it has few."""
    if len(surface) <= _POINTS:
        return surface
    rows = np.random.default_rng(seed).choice(len(surface), _POINTS, replace=False)
    return surface.take(np.sort(rows))


def _numbers(surface: Surface, T: Transform, middle: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return what the network takes: (1, n, 6) places from the middle and normals, 0 if unsided."""
    normals = surface.normals @ T[:3, :3].T * surface.sided[:, None]
    numbers = np.concatenate([apply(T, surface.points) - middle, normals], axis=1)
    return numbers[None].astype(np.float32)
