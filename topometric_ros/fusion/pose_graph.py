"""A pose graph of agents: one frame for all from transforms between pairs, wrong ones switched off.

Four unknowns an agent, its yaw and its place: gravity is known. Least squares alone would share a
wrong alignment's error among all agents, and a robust kernel alone can settle in a wrong basin, so
the kernel is tightened step by step: graduated non-convexity with truncated least squares (Yang,
Antonante, Tzoumas & Carlone 2020).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.fusion.poses import Transform, apply, yaw_of, yaw_pose

_ROUNDS = 100
_STEPS = 20
_STILL = 1e-9
"""Least squares ends when no agent moves more than this, m and rad."""
_TIGHTEN = 1.4
"""Factor by which each round of the graduated kernel is less convex, as its authors have it."""
_FLOOR = (0.01, np.radians(0.05))
"""Smallest standard deviations that an alignment is believed to have, m and rad."""
_PRIOR_REACH = 4.3
"""Standard deviations that a prior may be off: as far as `fusion.priors` allows."""


@dataclass(frozen=True)
class Link:
    """An alignment in the pose graph: agents by number, `T_a_b` between their frames.

    `covariance` is that of the alignment, (6, 6) over (x, y, z, roll, pitch, yaw), or None;
    `fixed` links were set by hand and are never switched off; without a covariance they hold as
    they are. A `prior` may be off by as much as its covariance allows, direction by direction.
    """

    a: int
    b: int
    T_a_b: Transform
    covariance: NDArray[np.float64] | None = None
    fixed: bool = False
    prior: bool = False


@dataclass(frozen=True)
class Misfit:
    """How far a link is from the poses: metres at the middle of b's map, and rad about z."""

    gap: float
    turn: float


def misfit(link: Link, poses: Sequence[Transform], middles: NDArray[np.float64]) -> Misfit:
    """Return how far the poses are from what a link says.

    Parameters
    ----------
    link : Link
    poses : T_group_agent (4, 4) of each agent, z of the group's frame up
    middles : (n, 3) float64, the middle of each agent's map in its own frame, m
    """
    gap, turn, _, _ = _error(link, poses, middles)
    return Misfit(float(np.linalg.norm(gap)), abs(turn))


def agrees(
    link: Link,
    poses: Sequence[Transform],
    middles: NDArray[np.float64],
    limits: tuple[float, float],
) -> bool:
    """Whether the poses are as a link says: within the gap (m) and turn (rad), or a prior's own."""
    if link.prior:
        gap, turn, _, _ = _error(link, poses, middles)
        off = np.array([*gap, turn])
        return bool(off @ _allowance(link, poses, middles, limits) @ off <= 1.0)
    found = misfit(link, poses, middles)
    return found.gap <= limits[0] and found.turn <= limits[1]


def switched_on(
    start: Sequence[Transform],
    links: Sequence[Link],
    middles: NDArray[np.float64],
    limits: tuple[float, float],
    trust: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Return how much each link is believed once the wrong ones are switched off: (L,) in 0..1.

    Parameters
    ----------
    start : poses to start from; the first stays where it is
    links : Link
    middles : (n, 3) float64, the middle of each agent's map in its own frame, m
    limits : the gap (m) and turn (rad) at which a link counts as wrong; a prior's are its own
    trust : (L,) float64, what switching each link off costs; where the others leave open which link
        of a cycle is wrong, the one that costs least goes
    """
    poses = list(start)
    fixed = np.array([link.fixed for link in links])
    allowance = np.array([_allowance(link, start, middles, limits) for link in links])
    weights = np.ones(len(links))
    control = 0.0
    for _ in range(_ROUNDS):
        poses = _least_squares(poses, links, middles, weights[:, None, None] * allowance)
        off = [_error(link, poses, middles)[:2] for link in links]
        errors = np.array([[*gap, turn] for gap, turn in off])
        squared = np.einsum("li,lij,lj->l", errors, allowance, errors) / trust
        if control == 0.0:
            if squared.max() <= 1.0:
                return weights
            control = 1.0 / (2.0 * squared.max() - 1.0)
        least, most = control / (control + 1.0), (control + 1.0) / control
        with np.errstate(divide="ignore"):
            between = np.sqrt(control * (control + 1.0) / squared) - control
        weights = np.where(squared >= most, 0.0, np.where(squared <= least, 1.0, between))
        weights[fixed] = 1.0
        if np.isin(weights, (0.0, 1.0)).all():
            break
        control *= _TIGHTEN
    return weights


def optimised(
    start: Sequence[Transform], links: Sequence[Link], middles: NDArray[np.float64]
) -> list[Transform]:
    """Return the poses that agree best with links, each weighed by its covariance.

    Parameters
    ----------
    start : poses to start from, near the answer; the first stays where it is
    links : Link, all held to be right
    middles : (n, 3) float64, the middle of each agent's map in its own frame, m
    """
    scale = np.array([_information(link, start, middles) for link in links])
    return _least_squares(list(start), links, middles, scale)


def _allowance(
    link: Link,
    poses: Sequence[Transform],
    middles: NDArray[np.float64],
    limits: tuple[float, float],
) -> NDArray[np.float64]:
    """Return the (4, 4) form that is one where a link's gap and turn are as large as allowed."""
    squares = np.diag([limits[0]] * 3 + [limits[1]]) ** 2
    if link.prior:
        squares += _PRIOR_REACH**2 * _spread(link, poses, middles)
    return np.asarray(np.linalg.inv(squares), dtype=np.float64)


def _information(
    link: Link, poses: Sequence[Transform], middles: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the weights (4, 4) of a link's gap and turn: one over the variances at b's middle."""
    floor = np.array([_FLOOR[0]] * 3 + [_FLOOR[1]]) ** 2
    if link.covariance is None:
        return np.diag((1e6 if link.fixed else 1.0) / floor)
    spread = _spread(link, poses, middles)
    if link.prior:
        return np.asarray(np.linalg.inv(spread + np.diag(floor)), dtype=np.float64)
    place = max(float(np.trace(spread[:3, :3])) / 3.0, _FLOOR[0] ** 2)
    turn = max(float(spread[3, 3]), _FLOOR[1] ** 2)
    return np.diag(1.0 / np.array([place, place, place, turn]))


def _spread(
    link: Link, poses: Sequence[Transform], middles: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the covariance (4, 4), in the group's frame, of a link's gap and turn."""
    assert link.covariance is not None
    x, y, _ = link.T_a_b[:3, :3] @ middles[link.b]
    # Roll and pitch are held, not measured: their variance says nothing about the link.
    free = np.ix_([0, 1, 2, 5], [0, 1, 2, 5])
    carry = np.eye(4)
    carry[:2, 3] = -y, x
    carry[:3] = poses[link.a][:3, :3] @ carry[:3]
    return carry @ link.covariance[free] @ carry.T


def _error(
    link: Link, poses: Sequence[Transform], middles: NDArray[np.float64]
) -> tuple[NDArray[np.float64], float, NDArray[np.float64], NDArray[np.float64]]:
    """Return gap (3,) and turn of a link, and where a's and b's middles lie in the group."""
    said = poses[link.a] @ link.T_a_b
    there = apply(poses[link.b], middles[link.b][None])[0]
    gap = apply(said, middles[link.b][None])[0] - there
    left = np.eye(4)
    left[:3, :3] = said[:3, :3] @ poses[link.b][:3, :3].T
    return gap, yaw_of(left), apply(poses[link.a], middles[link.a][None])[0], there


def _least_squares(
    poses: list[Transform],
    links: Sequence[Link],
    middles: NDArray[np.float64],
    scale: NDArray[np.float64],
) -> list[Transform]:
    """Gauss-Newton; each agent turns about its own middle. `scale` (L, 4, 4): gap and turn."""
    size = 4 * len(poses)
    for _ in range(_STEPS):
        H, g = np.zeros((size, size)), np.zeros(size)
        for link, weight in zip(links, scale, strict=True):
            gap, turn, middle_a, middle_b = _error(link, poses, middles)
            J = np.zeros((4, 8))
            arm = middle_b + gap - middle_a
            J[:3, 0] = (-arm[1], arm[0], 0.0)
            J[:3, 1:4], J[:3, 5:] = np.eye(3), -np.eye(3)
            J[3, 0], J[3, 4] = 1.0, -1.0
            rows = np.r_[4 * link.a : 4 * link.a + 4, 4 * link.b : 4 * link.b + 4]
            H[np.ix_(rows, rows)] += J.T @ weight @ J
            g[rows] += J.T @ (weight @ np.r_[gap, turn])
        # An agent whose links are all switched off stays where it is.
        H += 1e-9 * max(float(np.trace(H)), 1.0) / size * np.eye(size)
        move = np.zeros(size)
        move[4:] = -np.linalg.solve(H[4:, 4:], g[4:])
        poses = [
            _moved(pose, middle, step)
            for pose, middle, step in zip(poses, middles, move.reshape(-1, 4), strict=True)
        ]
        if np.abs(move).max() < _STILL:
            break
    return poses


def _moved(pose: Transform, middle: NDArray[np.float64], step: NDArray[np.float64]) -> Transform:
    """Turn a pose by step[0] about the middle of its map and move it by the rest."""
    centre = apply(pose, middle[None])[0]
    turn = yaw_pose(float(step[0]), (0.0, 0.0, 0.0))
    turn[:3, 3] = centre + step[1:] - turn[:3, :3] @ centre
    return turn @ pose
