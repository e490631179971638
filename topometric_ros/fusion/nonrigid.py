"""Non-rigid fusion: drifted maps are bent onto each other, so that no wall is doubled.

A pose graph of rooms, long ones cut into parts. Parts of one agent's map that touch or that a
passage joins hang together as tightly as odometry is good, which falls with the root of the way;
parts of two agents that show the same place are tied by registering one on the other's map. What
drift is left within the parts a smooth bend takes (`fusion.smooth_bend`). What comes out is taken
only where it brings the agents' surfaces closer together by enough: a map without drift stays as it
is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.configuration import parameter
from topometric_ros.fusion.pose_graph import Link, misfit, optimised
from topometric_ros.fusion.poses import Transform, apply, inverse
from topometric_ros.fusion.registration import (
    Registration,
    RegistrationConfig,
    RegistrationError,
    register,
)
from topometric_ros.fusion.smooth_bend import Net, net_of, smooth_states
from topometric_ros.fusion.surface import Surface, surface_of
from topometric_ros.matching.hypotheses import register_positions
from topometric_ros.topometric_map import NO_ROOM, TopometricMap

Placed = tuple[TopometricMap, Transform]
"""A map and its level frame's transform to the global level frame."""


def _registration() -> RegistrationConfig:
    return RegistrationConfig(gates=(0.5, 0.3, 0.15, 0.08), points=2000)


@dataclass(frozen=True)
class NonRigidConfig:
    """How far rooms may shift within an agent's map."""

    enabled: bool = parameter(False, "Bend agents' maps onto each other where they have drifted.")
    drift: float = parameter(
        0.03, "Standard deviation of the drift over the first metre of an agent's way; it grows "
        "with the root of the way.", unit="m", minimum=0.0001, maximum=1.0,
    )  # fmt: skip
    yaw_drift: float = parameter(
        0.3, "Standard deviation of the heading's drift over the first metre of the way; it "
        "grows with the root of the way.", unit="deg", minimum=0.001, maximum=10.0,
    )  # fmt: skip
    part: float = parameter(
        5.0, "Rooms longer than this are cut into parts that move on their own.", unit="m",
        minimum=1.0, maximum=1000.0,
    )  # fmt: skip
    smallest_part: int = parameter(
        200, "Voxels from which a part moves on its own.", minimum=10
    )  # fmt: skip
    smallest_inliers: float = parameter(
        0.4, "Share of a part's points that must lie on the other map for the two to be tied.",
        minimum=0.0, maximum=1.0,
    )  # fmt: skip
    largest_step: float = parameter(
        1.0, "A part that registration moves farther than this is not tied.", unit="m",
        minimum=0.0, maximum=10.0,
    )  # fmt: skip
    node: float = parameter(
        1.2, "Distance of the nodes of the smooth bend that follows; 0: parts move, nothing bends.",
        unit="m", minimum=0.0, maximum=10.0,
    )  # fmt: skip
    gain: float = parameter(
        0.05, "Share by which the gap between the agents' surfaces must shrink.", minimum=0.0,
        maximum=1.0,
    )  # fmt: skip
    registration: RegistrationConfig = field(default_factory=_registration)


@dataclass(frozen=True)
class Bend:
    """Where each part of one agent's map goes: level frame to the global level frame.

    `transforms` (R, 4, 4) are of the parts, `owner` says which is that of each of the tree's points
    (level frame). `net` bends what the parts have placed further, by the `state` of its nodes.
    """

    transforms: NDArray[np.float64]
    tree: cKDTree
    owner: NDArray[np.int64]
    net: Net | None = None
    state: NDArray[np.float64] | None = None

    def apply(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return where points (N, 3), m, go, each with the part that is nearest to it."""
        row = self.owner[self.tree.query(points)[1]]
        T = self.transforms[row]
        there = np.einsum("nij,nj->ni", T[:, :3, :3], points) + T[:, :3, 3]
        if self.net is None or self.state is None:
            return there
        return self.net.carried(there, self.state)


@dataclass(frozen=True)
class _Parts:
    """One agent's map in parts: the part of each voxel (-1: none), the parts' rooms and middles."""

    of_voxel: NDArray[np.int64]
    rooms: NDArray[np.int64]
    middles: NDArray[np.float64]
    first: int
    """Number in the pose graph of the first part."""

    def __len__(self) -> int:
        return len(self.rooms)


def bends(placed: Sequence[Placed], config: NonRigidConfig) -> list[Bend] | None:
    """Return how each agent's map is to be bent, or None where that would gain too little.

    Parameters
    ----------
    placed : two or more maps, the anchor first; its largest part stays where it is
    """
    parts: list[_Parts] = []
    for m, _ in placed:
        parts.append(_parts(m, sum(map(len, parts)), config))
    if not all(map(len, parts)):
        return None
    surfaces = [surface_of(m) for m, _ in placed]
    ties = _ties(placed, surfaces, parts, config)
    if not ties:
        return None
    start = [T for (_, T), own in zip(placed, parts, strict=True) for _ in range(len(own))]
    middles = np.concatenate([own.middles for own in parts])
    odometry = _odometry(placed, parts, config)
    poses = optimised(start, [*odometry, *ties], middles)
    # A tie that the others contradict was registered wrongly; the rest decides once more.
    limit = 3.0 * float(np.median([misfit(link, poses, middles).gap for link in ties])) + 0.02
    kept = [link for link in ties if misfit(link, poses, middles).gap <= limit]
    poses = optimised(start, [*odometry, *kept], middles)
    found = [_bend(m, own, poses) for (m, _), own in zip(placed, parts, strict=True)]
    rigid = [_rigid(m, T) for m, T in placed]
    before, reached = _gap_of(rigid, surfaces), _gap_of(found, surfaces)
    most = (1.0 - config.gain) * before
    if reached > most:
        found, reached = rigid, before
    if config.node > 0.0:
        found = _smoothed(found, placed, surfaces, config)
        reached = _gap_of(found, surfaces)
    return found if reached <= most else None


def _gap_of(found: Sequence[Bend], surfaces: Sequence[Surface]) -> float:
    return gap(surfaces, [b.apply(s.points) for b, s in zip(found, surfaces, strict=True)])


def _rigid(m: TopometricMap, T: Transform) -> Bend:
    """Return what bends nothing."""
    return Bend(T[None], cKDTree(m.surface()[:1]), np.zeros(1, np.int64))


def _smoothed(
    found: Sequence[Bend],
    placed: Sequence[Placed],
    surfaces: Sequence[Surface],
    config: NonRigidConfig,
) -> list[Bend]:
    """Return bends that go on smoothly where parts were placed."""
    nets = []
    for bend, (m, T), surface in zip(found, placed, surfaces, strict=True):
        floor = bend.apply(np.asarray(m.origin) + m.navigable * m.voxel_size)
        there, normals = bend.apply(surface.points), surface.normals @ T[:3, :3].T
        if len(floor) == 0:
            return list(found)
        nets.append(net_of(surface, there, normals, floor, config.node))
    states = smooth_states(nets, config.drift, float(np.radians(config.yaw_drift)))
    return [
        replace(bend, net=net, state=state)
        for bend, net, state in zip(found, nets, states, strict=True)
    ]


def gap(surfaces: Sequence[Surface], there: Sequence[NDArray[np.float64]]) -> float:
    """Return how far apart the agents' faces of the same walls lie: the mean over points, m.

    Parameters
    ----------
    surfaces : with the normals of each agent's points; turns of some degrees are passed over
    there : (N, 3) of each agent, where its points are, one frame
    """
    distances = []
    for i in range(len(surfaces)):
        tree = cKDTree(there[i])
        normals = _normals_there(surfaces[i], there[i])
        for j in range(i + 1, len(surfaces)):
            points, own = there[j][::5], _normals_there(surfaces[j], there[j])[::5]
            reach, nearest = tree.query(points, distance_upper_bound=0.5)
            rows = np.flatnonzero(np.isfinite(reach))
            near = nearest[rows]
            alike = np.sum(own[rows] * normals[near], axis=1) > 0.8
            known = surfaces[j].sided[::5][rows] & surfaces[i].sided[near]
            upright = np.abs(normals[near, 2]) < 0.2
            rows, near = rows[alike & known & upright], near[alike & known & upright]
            distances.append(
                np.abs(np.sum(normals[near] * (points[rows] - there[i][near]), axis=1))
            )
    every = np.concatenate(distances) if distances else np.zeros(0)
    return float(every.mean()) if len(every) else 0.0


def _normals_there(surface: Surface, there: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return normals turned as the whole cloud was: by the yaw that fits best."""
    T, _ = register_positions(there, surface.points)
    return surface.normals @ T[:3, :3].T


def _parts(m: TopometricMap, first: int, config: NonRigidConfig) -> _Parts:
    """Cut a map's rooms into parts, the largest first."""
    surface = m.surface()
    cells = np.floor(surface[:, :2] / config.part).astype(np.int64)
    low = {r.id: np.array(r.bounds[0][:2]) for r in m.rooms}
    long = {r.id: max(np.subtract(*r.bounds[::-1])[:2]) > config.part for r in m.rooms}
    for room in low:
        own = m.room == room
        cells[own] = np.floor((surface[own, :2] - low[room]) / config.part) if long[room] else 0
    key = np.column_stack([m.room, cells])
    distinct, of_voxel, count = np.unique(key, axis=0, return_inverse=True, return_counts=True)
    good = (distinct[:, 0] != NO_ROOM) & (count >= config.smallest_part)
    order = np.argsort(-count[good], kind="stable")
    number = np.full(len(distinct), -1)
    number[np.flatnonzero(good)[order]] = np.arange(len(order))
    of_voxel = number[of_voxel.ravel()]
    rooms = distinct[good, 0][order]
    middles = [surface[of_voxel == k].mean(axis=0) for k in range(len(rooms))]
    return _Parts(of_voxel, rooms, np.array(middles).reshape(-1, 3), first)


def _odometry(
    placed: Sequence[Placed], parts: Sequence[_Parts], config: NonRigidConfig
) -> list[Link]:
    """Tie parts of one agent: those of a room, those at a passage, and each to the nearest."""
    links: dict[tuple[int, int], Link] = {}
    for (m, _), own in zip(placed, parts, strict=True):
        far = np.linalg.norm(own.middles[:, None] - own.middles[None], axis=2)
        joined = [
            (i, j, (own.middles[i] + own.middles[j]) / 2.0)
            for i in range(len(own))
            for j in range(i)
            if own.rooms[i] == own.rooms[j] and far[i, j] < 1.6 * config.part
        ]
        for k in range(1, len(own)):
            nearest = int(np.argmin(far[k, :k]))
            joined.append((k, nearest, (own.middles[k] + own.middles[nearest]) / 2.0))
        for passage in m.passages:
            at = np.array(passage.position)
            ends = [np.flatnonzero(own.rooms == room) for room in passage.rooms]
            if all(map(len, ends)):
                i, j = (
                    int(e[np.argmin(np.linalg.norm(own.middles[e] - at, axis=1))]) for e in ends
                )
                joined.append((i, j, at))
        for i, j, at in joined:
            pair = (own.first + min(i, j), own.first + max(i, j))
            way = float(np.linalg.norm(own.middles[[i, j]] - at, axis=1).sum())
            links.setdefault(pair, Link(*pair, np.eye(4), _of_way(max(way, 1.0), at, config)))
    return list(links.values())


def _of_way(way: float, at: NDArray[np.float64], config: NonRigidConfig) -> NDArray[np.float64]:
    """Return the covariance of the identity after a way (m), its turn made at a place (3,)."""
    x, y, z = at
    carry = np.eye(6)
    carry[:3, 3:] = [[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]]
    turn = np.radians(config.yaw_drift)
    spread = np.array([config.drift] * 3 + [turn] * 3) ** 2 * way
    spread[3:5] = 1e-9
    return carry @ np.diag(spread) @ carry.T


def _ties(
    placed: Sequence[Placed],
    surfaces: Sequence[Surface],
    parts: Sequence[_Parts],
    config: NonRigidConfig,
) -> list[Link]:
    """Register each part of a later agent's map on each earlier agent's that shows it."""
    links = []
    for i, (_, T_i) in enumerate(placed):
        tree = cKDTree(surfaces[i].points)
        for j in range(i + 1, len(placed)):
            T_init = inverse(T_i) @ placed[j][1]
            for k in range(len(parts[j])):
                part = surfaces[j].take(parts[j].of_voxel == k)
                reach, nearest = tree.query(apply(T_init, part.points), distance_upper_bound=0.5)
                met = parts[i].of_voxel[nearest[np.isfinite(reach)]]
                met, counts = np.unique(met[met >= 0], return_counts=True)
                if counts.sum() < config.smallest_part / 2:
                    continue
                tie = _tie(part, surfaces[i], T_init, tree, config)
                if tie is not None:
                    ends = parts[i].first + int(met[np.argmax(counts)]), parts[j].first + k
                    links.append(Link(*ends, tie.T_target_source, tie.covariance))
    return links


def _tie(
    part: Surface, target: Surface, T_init: Transform, tree: cKDTree, config: NonRigidConfig
) -> Registration | None:
    """Register a part, or return None where that cannot be believed."""
    try:
        found = register(part, target, T_init, config.registration, tree)
    except RegistrationError:
        return None
    moved = apply(found.T_target_source, part.points) - apply(T_init, part.points)
    far = float(np.linalg.norm(moved, axis=1).mean()) > config.largest_step
    return None if far or found.inliers < config.smallest_inliers else found


def _bend(m: TopometricMap, own: _Parts, poses: Sequence[Transform]) -> Bend:
    """Return the bend of one agent's map."""
    rows = np.flatnonzero(own.of_voxel >= 0)
    transforms = np.array(poses[own.first : own.first + len(own)])
    return Bend(transforms, cKDTree(m.surface()[rows]), own.of_voxel[rows])
