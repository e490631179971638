"""A smooth bend of agents' maps: nodes on the floor that move a little, and what is near with them.

Where parts of a map were laid onto another one (`fusion.nonrigid`) what is left is drift within a
part. Each node turns about the vertical and shifts; a point goes with the nodes nearest to where it
was seen from, weighed by their distance. All maps bend at once, so that points of two agents come
to lie on each other's planes; neighbouring nodes hang together as tightly as odometry is good
(embedded deformation: Sumner, Schmid & Pauly 2007).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_diag, coo_array, csr_array, diags_array, hstack
from scipy.sparse.linalg import spsolve
from scipy.spatial import cKDTree

from topometric_ros.fusion.surface import Surface

_GATES = (0.3, 0.2, 0.12, 0.08)
"""Largest distances of a pair of points from its plane, m: rounds of Gauss-Newton."""
_STEPS = 3
_POINTS = 20_000
"""Points of a pair of agents that are looked at, at most."""
_NEAR = 4
"""Nodes that a point goes with."""
_SIGHT = 0.4
"""How far before a wall a point is taken to have been seen from, m."""
_STICK = 1.2
"""How far above a node's floor it is sought, m."""
_NOISE = 0.02
"""Standard deviation of a point from its plane, m."""
_TOGETHER = 0.1
"""Area of surface that counts as one measurement, m²."""
_SPREAD = np.array([np.radians(3.0), 0.5, 0.5, 0.5])
"""How far a node may go by itself: yaw (rad), x, y and z (m)."""


@dataclass(frozen=True)
class Net:
    """Nodes of one agent's map, all in the global level frame, and the points that go with them.

    `nodes` (K, 3) m, `edges` (E, 2) rows of neighbouring nodes; `points` and `normals` (N, 3), of
    which those that are `sided` are known to face free space; `near` (N, k) rows of the nodes that
    each goes with and how much, `shares` (N, k); `area` (m²) of surface that a point stands for.
    """

    nodes: NDArray[np.float64]
    edges: NDArray[np.int64]
    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    sided: NDArray[np.bool_]
    near: NDArray[np.int64]
    shares: NDArray[np.float64]
    area: float

    def moved(
        self, state: NDArray[np.float64], rows: NDArray[np.int64] | None = None
    ) -> NDArray[np.float64]:
        """Return where points go when the nodes' yaw and shift are `state` (K, 4)."""
        points, near, shares = (
            (x if rows is None else x[rows]) for x in (self.points, self.near, self.shares)
        )
        arms = points[:, None] - self.nodes[near]
        cosine, sine = np.cos(state[near, 0]), np.sin(state[near, 0])
        turned = np.stack(
            [
                cosine * arms[..., 0] - sine * arms[..., 1],
                sine * arms[..., 0] + cosine * arms[..., 1],
                arms[..., 2],
            ],
            axis=-1,
        )
        return np.sum(shares[..., None] * (turned + self.nodes[near] + state[near, 1:]), axis=1)

    def carried(
        self, points: NDArray[np.float64], state: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Return where any points (n, 3) go: each as the net's nearest point."""
        rows = self.tree.query(points)[1].astype(np.int64)
        other = replace(self, points=points, near=self.near[rows], shares=self.shares[rows])
        return other.moved(state)

    @cached_property
    def tree(self) -> cKDTree:
        """Of the points."""
        return cKDTree(self.points)

    def jacobian(self, rows: NDArray[np.int64], normals: NDArray[np.float64]) -> csr_array:
        """Return how points' way along normals changes with the nodes' yaw and shift: (n, 4K)."""
        near = self.near[rows]
        arms = self.points[rows][:, None] - self.nodes[near]
        change = np.empty((*near.shape, 4))
        change[..., 0] = normals[:, None, 1] * arms[..., 0] - normals[:, None, 0] * arms[..., 1]
        change[..., 1:] = normals[:, None]
        change *= self.shares[rows][..., None]
        columns = 4 * near[..., None] + np.arange(4)
        lines = np.broadcast_to(np.arange(len(rows))[:, None, None], change.shape)
        shape = (len(rows), 4 * len(self.nodes))
        return coo_array((change.ravel(), (lines.ravel(), columns.ravel())), shape=shape).tocsr()


def net_of(
    surface: Surface,
    there: NDArray[np.float64],
    normals: NDArray[np.float64],
    floor: NDArray[np.float64],
    spacing: float,
) -> Net:
    """Spread nodes over the floor of a map.

    Parameters
    ----------
    surface : of the map
    there, normals : (N, 3) float64, its points and normals in the global level frame
    floor : (M, 3) float64, m, cells where somebody could stand, in the global level frame
    spacing : edge of the cells that get a node each, m
    """
    cells = np.floor(floor / spacing).astype(np.int64)
    _, of_cell, count = np.unique(cells, axis=0, return_inverse=True, return_counts=True)
    of_cell = of_cell.ravel()
    nodes = np.column_stack([np.bincount(of_cell, axis) / count for axis in floor.T])
    beside = of_cell[cKDTree(floor).query_pairs(1.8 * surface.spacing, output_type="ndarray")]
    edges = np.unique(np.sort(beside[beside[:, 0] != beside[:, 1]], axis=1), axis=0)
    seen_from = there + np.where(surface.sided[:, None], _SIGHT * normals, 0.0)
    seen_from[:, 2] -= _STICK
    flat = np.array([1.0, 1.0, 0.5])
    distance, near = cKDTree(nodes * flat).query(seen_from * flat, k=min(_NEAR, len(nodes)))
    distance, near = distance.reshape(len(there), -1), near.reshape(len(there), -1)
    shares = np.exp(-0.5 * (distance / (spacing / 1.5)) ** 2) + 1e-12
    shares /= shares.sum(axis=1, keepdims=True)
    edges = edges.reshape(-1, 2)
    area = surface.spacing**2
    return Net(nodes, edges, there, normals, surface.sided, near, shares, area)


def smooth_states(nets: Sequence[Net], drift: float, yaw_drift: float) -> list[NDArray[np.float64]]:
    """Return the yaw and the shift of each map's nodes that bring the maps onto each other.

    Parameters
    ----------
    nets : two or more
    drift, yaw_drift : standard deviations over the first metre between nodes, m and rad

    Returns
    -------
    (K, 4) of each net
    """
    states = [np.zeros((len(net.nodes), 4)) for net in nets]
    held = block_diag([_held(net, drift, yaw_drift) for net in nets], format="csr")
    ends = np.cumsum([4 * len(net.nodes) for net in nets])[:-1]
    drawn = {
        pair: _shared(*(nets[k].points for k in pair)) for pair in combinations(range(len(nets)), 2)
    }
    for gate in _GATES:
        trees = [cKDTree(net.moved(state)) for net, state in zip(nets, states, strict=True)]
        for _ in range(_STEPS):
            x = np.concatenate([state.ravel() for state in states])
            H, g = held.copy(), held @ x
            for (i, j), (rows, share) in drawn.items():
                J, weights, off = _equations(nets, states, trees[i], (i, j), rows, gate)
                weights *= share
                H, g = H + J.T @ (diags_array(weights) @ J), g + J.T @ (weights * off)
            x = x - spsolve(H.tocsc(), g)
            states = [part.reshape(-1, 4) for part in np.split(x, ends)]
    return states


def _held(net: Net, drift: float, yaw_drift: float) -> csr_array:
    """Return what holds a map's nodes together, and where they are: (4K, 4K)."""
    a, b = net.edges.T
    way = np.linalg.norm(net.nodes[a] - net.nodes[b], axis=1)
    middle = (net.nodes[a] + net.nodes[b]) / 2.0
    lines, columns, values = [], [], []
    # Both ends must put the middle at the same place, and turn alike.
    for end, sign in ((a, 1.0), (b, -1.0)):
        arm = middle - net.nodes[end]
        for axis, by_turn in enumerate((-arm[:, 1], arm[:, 0], np.zeros(len(arm)))):
            row = 4 * np.arange(len(way)) + axis
            lines += [row, row]
            columns += [4 * end + 1 + axis, 4 * end]
            values += [sign / (drift * np.sqrt(way)), sign * by_turn / (drift * np.sqrt(way))]
        lines.append(4 * np.arange(len(way)) + 3)
        columns.append(4 * end)
        values.append(sign / (yaw_drift * np.sqrt(way)))
    size = 4 * len(net.nodes)
    where = (np.concatenate(lines), np.concatenate(columns))
    J = coo_array((np.concatenate(values), where), shape=(4 * len(way), size)).tocsr()
    alone = np.tile(1.0 / _SPREAD**2, len(net.nodes))
    return (J.T @ J + diags_array(alone)).tocsr()


def _shared(
    target: NDArray[np.float64], source: NDArray[np.float64]
) -> tuple[NDArray[np.int64], float]:
    """Return rows of the source near the target, and how many points each stands for."""
    reach, _ = cKDTree(target).query(source, distance_upper_bound=0.5)
    rows = np.flatnonzero(np.isfinite(reach))
    if len(rows) <= _POINTS:
        return rows, 1.0
    drawn = np.random.default_rng(0).choice(rows, _POINTS, replace=False)
    return np.sort(drawn), len(rows) / _POINTS


def _equations(
    nets: Sequence[Net],
    states: Sequence[NDArray[np.float64]],
    tree: cKDTree,
    pair: tuple[int, int],
    rows: NDArray[np.int64],
    gate: float,
) -> tuple[csr_array, NDArray[np.float64], NDArray[np.float64]]:
    """Return how points of the second map of a pair lie before planes of the first.

    Returns
    -------
    jacobian over all nodes, weights, and the distances in m
    """
    first, second = (nets[k] for k in pair)
    moved = second.moved(states[pair[1]], rows)
    reach, nearest = tree.query(moved, distance_upper_bound=max(gate, 0.15))
    found = np.isfinite(reach)
    rows, nearest, moved = rows[found], nearest[found].astype(np.int64), moved[found]
    normals = first.normals[nearest]
    off = np.sum(normals * (moved - first.moved(states[pair[0]], nearest)), axis=1)
    alike = np.sum(normals * second.normals[rows], axis=1) > 0.8
    good = alike & first.sided[nearest] & second.sided[rows] & (np.abs(off) < gate)
    rows, nearest, normals, off = rows[good], nearest[good], normals[good], off[good]
    blocks = [csr_array((len(rows), 4 * len(net.nodes))) for net in nets]
    blocks[pair[1]] = second.jacobian(rows, normals)
    blocks[pair[0]] = -first.jacobian(nearest, normals)
    weights = (1.0 - (off / gate) ** 2) ** 2 * second.area / _TOGETHER / _NOISE**2
    return hstack(blocks, format="csr"), weights, off
