"""Small arithmetic of transforms with a turn about z only, and of rigid transforms in general."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Transform = NDArray[np.float64]


def yaw_pose(
    yaw: float, translation: NDArray[np.float64] | tuple[float, float, float]
) -> Transform:
    """Return the (4, 4) transform that turns by `yaw` (rad) about z and then moves (m)."""
    T = np.eye(4)
    cosine, sine = np.cos(yaw), np.sin(yaw)
    T[:2, :2] = [[cosine, -sine], [sine, cosine]]
    T[:3, 3] = translation
    return T


def turned(rotation: NDArray[np.float64]) -> Transform:
    """Return the (4, 4) transform that turns by a rotation vector (3,), rad, and moves nothing."""
    if rotation[0] == 0.0 == rotation[1]:
        return yaw_pose(float(rotation[2]), (0.0, 0.0, 0.0))
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rotation).as_matrix()
    return T


def yaw_of(T: Transform) -> float:
    """Return the turn about z of a transform, rad in (-π, π]."""
    return float(np.arctan2(T[1, 0], T[0, 0]))


def inverse(T: Transform) -> Transform:
    """Return the inverse of a rigid transform by transposing its rotation."""
    result = np.eye(4)
    result[:3, :3] = T[:3, :3].T
    result[:3, 3] = -T[:3, :3].T @ T[:3, 3]
    return result


def apply(T: Transform, points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (N, 3) in the target frame of `T`."""
    return points @ T[:3, :3].T + T[:3, 3]


def angle(T: Transform) -> float:
    """Return the angle of a transform's rotation, rad in [0, π]."""
    cosine = (np.trace(T[:3, :3]) - 1.0) / 2.0
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def apart(one: Transform, other: Transform, positions: NDArray[np.float64]) -> float:
    """Return how far apart two transforms put positions (n, 3), on average, in metres."""
    return float(np.linalg.norm(apply(one, positions) - apply(other, positions), axis=1).mean())


def input_frames(T_level: Transform, level_a: Transform, level_b: Transform) -> Transform:
    """Return T_a_b between input frames from the one between level frames.

    `level_a` and `level_b` are the maps' `T_level_input`.
    """
    return inverse(level_a) @ T_level @ level_b


def level_frames(T_input: Transform, level_a: Transform, level_b: Transform) -> Transform:
    """Undo :func:`input_frames`."""
    return level_a @ T_input @ inverse(level_b)


def carried(
    covariance: NDArray[np.float64], turn: NDArray[np.float64], arm: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covariance (6, 6) of a transform's translation and turns in other coordinates.

    A small translation δ and turn ω become `turn` (3, 3) times δ + ω × `arm` (3,), m, and ω.
    """
    x, y, z = arm
    carry = np.zeros((6, 6))
    carry[:3, :3] = carry[3:, 3:] = turn
    carry[:3, 3:] = -turn @ np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return carry @ covariance @ carry.T


def matrix_lines(T: Transform) -> list[str]:
    """Return the rows of a transform (4, 4) to print and to copy.

    Nine decimals: in projected coordinates, 10,000 km from their origin, the sixth decimal of a
    turn moves a point by 10 m.
    """
    return ["  ".join(f"{value: 13.9f}" for value in row) for row in T]
