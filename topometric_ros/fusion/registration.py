"""Fine registration: point-to-plane ICP that turns about z only (thesis §4.4.1).

Gravity is measured better than any cloud can tell, so only the yaw and three translations are
unknown: a 4 x 4 linear system a step (Kubelka et al. 2022). The gates on the distance of pairs
shrink from round to round: a fixed one leaves centimetres where shrinking ones leave millimetres.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.configuration import parameter
from topometric_ros.errors import ConfigurationError, TopometricError
from topometric_ros.fusion.poses import Transform, apply, yaw_pose
from topometric_ros.fusion.surface import Surface

_DRAWN_FIRST = 10
"""So many times the points that are used are looked at for lying near the target."""


class RegistrationError(TopometricError):
    """Two surfaces that share too little to be registered."""


@dataclass(frozen=True)
class RegistrationConfig:
    """How surfaces are registered and how sure the result is held to be."""

    gates: tuple[str, ...] = parameter(
        ("0.4", "0.25", "0.15", "0.08"),
        "Largest distances (m) of a pair from its plane, one round each; none is taken below "
        "half a voxel.",
    )
    steps: int = parameter(10, "Largest number of steps in a round.", minimum=1, maximum=100)
    points: int = parameter(
        8000, "Points drawn from what the source shares with the target.", minimum=100
    )
    seed: int = parameter(0, "Seed of that draw.", minimum=0)
    normals_cosine: float = parameter(
        0.6, "Smallest cosine between the normals of a pair.", minimum=0.0, maximum=1.0
    )
    unsided_weight: float = parameter(
        0.1,
        "Weight of a pair of which it is not known that both points were seen from one side.",
        minimum=0.0,
        maximum=1.0,
    )
    smallest_pairs: int = parameter(50, "Fewer pairs than this register nothing.", minimum=10)
    gravity_deviation: float = parameter(
        0.3,
        "Standard deviation of roll and pitch, which are taken from the agents and not estimated.",
        unit="degree",
        minimum=0.0,
        maximum=10.0,
    )
    correlated_area: float = parameter(
        0.25,
        "Area of surface whose errors are one and the same: it counts as one measurement.",
        unit="m²",
        minimum=0.0001,
        maximum=100.0,
    )


@dataclass(frozen=True)
class Registration:
    """The transform that ICP ends at.

    `rmse` (m) is of the pairs' distances to their planes within the last gate, `inliers` the share
    of the points drawn that have such a pair. `covariance` (6, 6) over (x, y, z, roll, pitch, yaw)
    in m and rad: translation in the target frame, small turns about its axes. Roll and pitch are
    held, not estimated: their variance is that of the agents' gravity, without correlations.
    """

    T_target_source: Transform
    rmse: float
    inliers: float
    covariance: NDArray[np.float64]


@dataclass(frozen=True)
class _Pairs:
    """Source points where they lie now, and their counterparts' normals and distances."""

    moved: NDArray[np.float64]
    normals: NDArray[np.float64]
    residuals: NDArray[np.float64]
    weights: NDArray[np.float64]


def register(
    source: Surface,
    target: Surface,
    T_init: Transform,
    config: RegistrationConfig,
    tree: cKDTree | None = None,
) -> Registration:
    """Refine the pose of one surface on another.

    Parameters
    ----------
    source, target : Surface, each in its own gravity-aligned frame
    T_init : (4, 4) float64, T_target_source to start from, rotation about z only
    config : RegistrationConfig
    tree : the tree of the target's points, if the caller has one

    Raises
    ------
    RegistrationError
        Fewer pairs than `smallest_pairs` at the start or under way.
    """
    tree = tree or cKDTree(target.points)
    gates = _gates(config, max(source.spacing, target.spacing))
    source = _shared_part(source, tree, T_init, gates[0], config)
    T = T_init.copy()
    for gate in gates:
        for _ in range(config.steps):
            T, step = _step(_pairs(source, target, tree, T, gate, config), T, config)
            if step < 1e-4:
                break
    pairs = _pairs(source, target, tree, T, gates[-1], config)
    return Registration(
        T_target_source=T,
        rmse=float(np.sqrt(np.mean(pairs.residuals**2))) if len(pairs.residuals) else 0.0,
        inliers=len(pairs.residuals) / len(source),
        covariance=_covariance(pairs, T, target.spacing, config),
    )


def _gates(config: RegistrationConfig, spacing: float) -> list[float]:
    """Return the gates in metres, none below what the spacing of the points supports."""
    try:
        gates = [float(gate) for gate in config.gates]
    except ValueError as error:
        raise ConfigurationError(
            f"registration.gates: expected metres, got {config.gates}"
        ) from error
    return [max(gate, spacing / 2) for gate in gates]


def _shared_part(
    source: Surface, tree: cKDTree, T: Transform, gate: float, config: RegistrationConfig
) -> Surface:
    """Return at most `points` of the source's points that start near the target."""
    generator = np.random.default_rng(config.seed)
    if len(source) > _DRAWN_FIRST * config.points:
        drawn = generator.choice(len(source), _DRAWN_FIRST * config.points, replace=False)
        source = source.take(np.sort(drawn))
    reach, _ = tree.query(apply(T, source.points), distance_upper_bound=gate + source.spacing)
    near = np.flatnonzero(np.isfinite(reach))
    if len(near) < config.smallest_pairs:
        raise RegistrationError(
            f"only {len(near)} points lie within {gate:g} m of the other map; "
            f"at least {config.smallest_pairs} are needed"
        )
    if len(near) > config.points:
        near = np.sort(generator.choice(near, config.points, replace=False))
    return source.take(near)


def _pairs(
    source: Surface,
    target: Surface,
    tree: cKDTree,
    T: Transform,
    gate: float,
    config: RegistrationConfig,
) -> _Pairs:
    """Pair every source point with the nearest target point whose normal fits, within the gate.

    A pair's points may lie a voxel apart along the wall; only the distance across it is gated.
    """
    moved = apply(T, source.points)
    reach = max(gate, 1.5 * target.spacing)
    distance, nearest = tree.query(moved, distance_upper_bound=reach)
    rows = np.flatnonzero(np.isfinite(distance))
    nearest = nearest[rows]
    normals = target.normals[nearest]
    residuals = np.sum(normals * (moved[rows] - target.points[nearest]), axis=1)
    agree = np.sum(normals * (source.normals[rows] @ T[:3, :3].T), axis=1)
    sided = source.sided[rows] & target.sided[nearest]
    agree = np.where(sided, agree, np.abs(agree))
    keep = (np.abs(residuals) < gate) & (agree >= config.normals_cosine)
    residuals = residuals[keep]
    weights = (1.0 - (residuals / gate) ** 2) ** 2  # Tukey's biweight
    # Which side of a wall was seen may be unknown: it must not pull one face onto the other.
    weights[~sided[keep]] *= config.unsided_weight
    return _Pairs(moved[rows[keep]], normals[keep], residuals, weights)


def _step(pairs: _Pairs, T: Transform, config: RegistrationConfig) -> tuple[Transform, float]:
    """Take one Gauss-Newton step; return the new pose and how far it moved the pairs (m)."""
    if len(pairs.residuals) < config.smallest_pairs:
        raise RegistrationError(
            f"only {len(pairs.residuals)} pairs of points are left; "
            f"at least {config.smallest_pairs} are needed"
        )
    middle = pairs.moved.mean(axis=0)
    J = _jacobian(pairs.normals, pairs.moved - middle)
    H = J.T @ (pairs.weights[:, None] * J)
    # A corridor says nothing about its own length: damping keeps such a direction where it is.
    H += 1e-4 * np.trace(H) / 4 * np.eye(4)
    update = -np.linalg.solve(H, J.T @ (pairs.weights * pairs.residuals))
    turn = yaw_pose(update[0], (0.0, 0.0, 0.0))
    turn[:3, 3] = middle + update[1:] - turn[:3, :3] @ middle
    spread = float(np.sqrt(np.mean((pairs.moved - middle) ** 2) * 2))
    return turn @ T, float(np.abs(update[0]) * spread + np.linalg.norm(update[1:]))


def _jacobian(normals: NDArray[np.float64], arms: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the change of each distance with (yaw, x, y, z): (n, 4)."""
    by_yaw = normals[:, 1] * arms[:, 0] - normals[:, 0] * arms[:, 1]  # n · (z × arm)
    return np.column_stack([by_yaw, normals])


def _covariance(
    pairs: _Pairs, T: Transform, spacing: float, config: RegistrationConfig
) -> NDArray[np.float64]:
    """Return the covariance (6, 6) of the pose from the Hessian and the residuals' variance.

    Neighbouring voxels err together, so a patch of `correlated_area` counts as one measurement;
    without that ten thousand pairs would promise a tenth of a millimetre.
    """
    J = _jacobian(pairs.normals, pairs.moved - T[:3, 3])
    H = J.T @ (pairs.weights[:, None] * J)
    together = max(1.0, config.correlated_area / spacing**2)
    # Residuals of the noise-free case must not promise certainty: a tenth of a voxel at least.
    variance = max(float(np.mean(pairs.residuals**2)), (0.1 * spacing) ** 2)
    H += 1e-9 * max(np.trace(H), 1.0) * np.eye(4)
    four = np.linalg.inv(H) * variance * together
    covariance = np.zeros((6, 6))
    rows = np.array([5, 0, 1, 2])
    covariance[np.ix_(rows, rows)] = four
    covariance[3, 3] = covariance[4, 4] = np.radians(config.gravity_deviation) ** 2
    return (covariance + covariance.T) / 2
