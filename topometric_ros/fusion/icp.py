"""Point-to-plane ICP that turns about chosen axes (thesis §4.4.1).

Gravity is measured better than any cloud can tell, so by default only the yaw and three
translations are unknown: a 4 x 4 linear system a step (Kubelka et al. 2022). Another axis, or all
three, may be chosen. The gates on the distance of pairs shrink from round to round: a fixed one
leaves centimetres where shrinking ones leave millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.fusion.poses import Transform, apply, turned
from topometric_ros.fusion.registration_config import (
    Registration,
    RegistrationConfig,
    RegistrationError,
)
from topometric_ros.fusion.surface import Surface

Axes = NDArray[np.float64]
"""(k, 3): unit vectors of the target's frame that may be turned about."""

UP: Axes = np.array([[0.0, 0.0, 1.0]])
ALL: Axes = np.eye(3)

_DRAWN_FIRST = 10
"""So many times the points that are used are looked at for lying near the target."""

_FEW = 2000
"""Points that are enough in all rounds but the last, which alone says where the pose ends."""


@dataclass(frozen=True)
class Pairs:
    """Source points where they lie now, and their counterparts' normals and distances."""

    moved: NDArray[np.float64]
    normals: NDArray[np.float64]
    residuals: NDArray[np.float64]
    weights: NDArray[np.float64]


def gravity_icp(
    source: Surface,
    target: Surface,
    T_init: Transform,
    config: RegistrationConfig,
    tree: cKDTree | None = None,
) -> Registration:
    """Refine the yaw and the translation of a pose; a :class:`Registrar`."""
    return _icp(source, target, T_init, config, tree, UP)


def full_icp(
    source: Surface,
    target: Surface,
    T_init: Transform,
    config: RegistrationConfig,
    tree: cKDTree | None = None,
) -> Registration:
    """Refine all six unknowns of a pose, where tilt is to be estimated; a :class:`Registrar`."""
    return _icp(source, target, T_init, config, tree, ALL)


def axis_icp(
    source: Surface,
    target: Surface,
    T_init: Transform,
    config: RegistrationConfig,
    tree: cKDTree | None = None,
) -> Registration:
    """Refine the turn about `config.axis` and the translation; a :class:`Registrar`."""
    axis = np.array([config.axis])
    return _icp(source, target, T_init, config, tree, axis / np.linalg.norm(axis))


def gates_of(config: RegistrationConfig, spacing: float) -> list[float]:
    """Return the gates in metres, none below what the spacing of the points supports."""
    return [max(gate, spacing / 2) for gate in config.gates]


def shared_part(
    source: Surface, tree: cKDTree, T: Transform, gate: float, config: RegistrationConfig
) -> Surface:
    """Return at most `points` of the source's points that start near the target.

    Raises
    ------
    RegistrationError
        Fewer than `smallest_pairs` do.
    """
    generator = np.random.default_rng(config.seed)
    drawn = np.arange(len(source))
    if len(source) > _DRAWN_FIRST * config.points:
        drawn = generator.choice(len(source), _DRAWN_FIRST * config.points, replace=False)
        drawn = np.sort(drawn)
    moved = apply(T, source.points[drawn])
    reach, _ = tree.query(moved, distance_upper_bound=gate + source.spacing)
    near = drawn[np.isfinite(reach)]
    if len(near) < config.smallest_pairs:
        raise RegistrationError(
            f"only {len(near)} points lie within {gate:g} m of the other map; "
            f"at least {config.smallest_pairs} are needed"
        )
    if len(near) > config.points:
        near = np.sort(generator.choice(near, config.points, replace=False))
    return source.take(near)


def measured(
    source: Surface,
    target: Surface,
    tree: cKDTree,
    T: Transform,
    config: RegistrationConfig,
    axes: Axes,
) -> Registration:
    """Return what a pose leaves of the source's points, all of which are looked at.

    Parameters
    ----------
    axes : what was turned about to find `T`; other turns have the variance of gravity
    """
    gate = gates_of(config, max(source.spacing, target.spacing))[-1]
    pairs = pairs_of(source, target, tree, T, gate, config)
    return Registration(
        T_target_source=T,
        rmse=float(np.sqrt(np.mean(pairs.residuals**2))) if len(pairs.residuals) else 0.0,
        inliers=len(pairs.residuals) / len(source),
        covariance=_covariance(pairs, T, target.spacing, config, axes),
    )


def _icp(
    source: Surface,
    target: Surface,
    T_init: Transform,
    config: RegistrationConfig,
    tree: cKDTree | None,
    axes: Axes,
) -> Registration:
    """Refine a pose, turning about `axes` only."""
    tree = tree or cKDTree(target.points)
    gates = gates_of(config, max(source.spacing, target.spacing))
    source = shared_part(source, tree, T_init, gates[0], config)
    few = source.take(np.arange(0, len(source), max(1, len(source) // _FEW)))
    T = T_init.copy()
    for round_, gate in enumerate(gates):
        used = source if round_ == len(gates) - 1 else few
        for _ in range(config.steps):
            T, step = _step(pairs_of(used, target, tree, T, gate, config), T, config, axes)
            if step < 1e-4:
                break
    return measured(source, target, tree, T, config, axes)


def pairs_of(
    source: Surface,
    target: Surface,
    tree: cKDTree,
    T: Transform,
    gate: float,
    config: RegistrationConfig,
) -> Pairs:
    """Pair every source point with the nearest target point whose normal fits, within the gate.

    A pair's points may lie a voxel apart along the wall; only the distance across it is gated.
    """
    moved = apply(T, source.points)
    reach = max(gate, 1.5 * target.spacing)
    distance, nearest = tree.query(moved, distance_upper_bound=reach)
    rows = np.flatnonzero(np.isfinite(distance))
    nearest = nearest[rows]
    normals, sided = target.facing(nearest)
    own_normals, own_sided = source.facing(rows)
    residuals = np.sum(normals * (moved[rows] - target.points[nearest]), axis=1)
    agree = np.sum(normals * (own_normals @ T[:3, :3].T), axis=1)
    sided &= own_sided
    agree = np.where(sided, agree, np.abs(agree))
    keep = (np.abs(residuals) < gate) & (agree >= config.normals_cosine)
    residuals = residuals[keep]
    weights = (1.0 - (residuals / gate) ** 2) ** 2  # Tukey's biweight
    # Which side of a wall was seen may be unknown: it must not pull one face onto the other.
    weights[~sided[keep]] *= config.unsided_weight
    return Pairs(moved[rows[keep]], normals[keep], residuals, weights)


def _step(
    pairs: Pairs, T: Transform, config: RegistrationConfig, axes: Axes
) -> tuple[Transform, float]:
    """Take one Gauss-Newton step; return the new pose and how far it moved the pairs (m)."""
    if len(pairs.residuals) < config.smallest_pairs:
        raise RegistrationError(
            f"only {len(pairs.residuals)} pairs of points are left; "
            f"at least {config.smallest_pairs} are needed"
        )
    middle = pairs.moved.mean(axis=0)
    J = jacobian(pairs.normals, pairs.moved - middle, axes)
    H = J.T @ (pairs.weights[:, None] * J)
    # A corridor says nothing about its own length: damping keeps such a direction where it is.
    H += 1e-4 * np.trace(H) / len(H) * np.eye(len(H))
    update = -np.linalg.solve(H, J.T @ (pairs.weights * pairs.residuals))
    turn = turned(update[:-3] @ axes)
    turn[:3, 3] = middle + update[-3:] - turn[:3, :3] @ middle
    spread = float(np.sqrt(np.mean((pairs.moved - middle) ** 2) * 2))
    angle = float(np.linalg.norm(update[:-3]))
    return turn @ T, angle * spread + float(np.linalg.norm(update[-3:]))


def jacobian(
    normals: NDArray[np.float64], arms: NDArray[np.float64], axes: Axes
) -> NDArray[np.float64]:
    """Return the change of each distance with the turns and (x, y, z): (n, k + 3)."""
    return np.column_stack([np.cross(arms, normals) @ axes.T, normals])


def _covariance(
    pairs: Pairs, T: Transform, spacing: float, config: RegistrationConfig, axes: Axes
) -> NDArray[np.float64]:
    """Return the covariance (6, 6) of the pose from the Hessian and the residuals' variance.

    Neighbouring voxels err together, so a patch of `correlated_area` counts as one measurement;
    without that ten thousand pairs would promise a tenth of a millimetre.
    """
    J = jacobian(pairs.normals, pairs.moved - T[:3, 3], axes)
    H = J.T @ (pairs.weights[:, None] * J)
    together = max(1.0, config.correlated_area / spacing**2)
    # Residuals of the noise-free case must not promise certainty: a tenth of a voxel at least.
    errors = float(np.mean(pairs.residuals**2)) if len(pairs.residuals) else 0.0
    variance = max(errors, (0.1 * spacing) ** 2)
    H += 1e-9 * max(np.trace(H), 1.0) * np.eye(len(H))
    found = np.linalg.inv(H) * variance * together
    spread = np.zeros((6, len(H)))
    spread[:3, -3:] = np.eye(3)
    spread[3:, :-3] = axes.T
    covariance = spread @ found @ spread.T
    held = np.eye(3) - axes.T @ axes
    covariance[3:, 3:] += held * np.radians(config.gravity_deviation) ** 2
    return (covariance + covariance.T) / 2
