"""Planar poses of map b in map a, and the score S of many of them at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.matching.search_fields import CELL, MapFields, StoreyFields, storey_pairs


@dataclass(frozen=True)
class Pose:
    """`p_a = R(yaw) p_b + (x, y, height)`, level frames, rad and m; `score` is S at it."""

    yaw: float
    x: float
    y: float
    height: float
    score: float = 0.0

    def matrix(self) -> NDArray[np.float64]:
        """Return `T_a_b` (4, 4) float64."""
        T = np.eye(4)
        c, s = np.cos(self.yaw), np.sin(self.yaw)
        T[:2, :2] = [[c, -s], [s, c]]
        T[:3, 3] = self.x, self.y, self.height
        return T

    def moved(self, point: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return a point (2,) of b's plan in a's."""
        return self.matrix()[:2, :2] @ point + (self.x, self.y)


def pose_of(T_a_b: NDArray[np.float64]) -> Pose:
    """Return the planar pose of a transform (4, 4) between level frames, without its tilt."""
    yaw = float(np.arctan2(T_a_b[1, 0] - T_a_b[0, 1], T_a_b[0, 0] + T_a_b[1, 1]))
    return Pose(yaw, float(T_a_b[0, 3]), float(T_a_b[1, 3]), float(T_a_b[2, 3]))


def same_pose(
    one: Pose, other: Pose, centre: NDArray[np.float64], reach: tuple[float, float, float]
) -> bool:
    """Return whether two poses put b's point `centre` (2,) at the same place.

    `reach` is how far they may differ there: metres on the plan, yaw in rad, metres in height.
    """
    turn = abs((one.yaw - other.yaw + np.pi) % (2.0 * np.pi) - np.pi)
    shift = np.linalg.norm(one.moved(centre) - other.moved(centre))
    return bool(
        shift <= reach[0] and turn <= reach[1] and abs(one.height - other.height) <= reach[2]
    )


@dataclass(frozen=True)
class Comparison:
    """The storeys that two maps share at one height: a's tables and some of b's cells."""

    tables: tuple[StoreyFields, ...]
    walls: tuple[NDArray[np.float64], ...]
    """Of each storey (K, 4): position (m) and free side of b's wall cells."""
    free: tuple[NDArray[np.float64], ...]
    """Of each storey (K, 2): position (m) of b's free cells."""
    wall_share: float
    """Wall cells that each of `walls` stands for."""
    free_share: float


def compare(a: MapFields, b: MapFields, height: float, samples: int | None) -> Comparison:
    """Pair the storeys at a height; take about `samples` of b's wall and of its free cells."""
    pairs = storey_pairs(a, b, height)
    storeys = [b.storeys[j] for _, j in pairs]
    walls = [np.hstack([s.walls, s.wall_sides]) for s in storeys]
    free = [s.free for s in storeys]
    wall_step = _stride(sum(map(len, walls)), samples)
    free_step = _stride(sum(map(len, free)), samples)
    return Comparison(
        tables=tuple(a.storeys[i] for i, _ in pairs),
        walls=tuple(_every(cells, wall_step) for cells in walls),
        free=tuple(_every(cells, free_step) for cells in free),
        wall_share=max(1.0, wall_step),
        free_share=max(1.0, free_step),
    )


def _stride(count: int, samples: int | None) -> float:
    return 1.0 if samples is None else count / samples


def _every(cells: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Return every `step`-th cell: a plain stride would beat with the raster's rows."""
    if step <= 1.0:
        return cells
    rows = np.floor(np.arange(0, len(cells), step)).astype(np.int64)
    return cells[rows[rows < len(cells)]]  # A step that is no binary fraction may reach the end.


def score_around(
    comparison: Comparison,
    pose: Pose,
    centre: NDArray[np.float64],
    turns: NDArray[np.float64],
    shifts: NDArray[np.float64],
    weights: tuple[float, float],
) -> NDArray[np.float64]:
    """Return S of the poses round one: turned about `centre` by `turns`, then shifted by `shifts`.

    S = Σ over b's walls [g · (1 − ω + ω n·n′) − λ · (free there)]
      + Σ over b's free cells [−λ · (wall there) + μ · (free there)].

    Parameters
    ----------
    centre : (2,) float64, m, level frame of b: the point that a turn leaves where it is
    turns : (T,) rad; shifts : (D,) m, used along x and along y
    weights : λ, cost of a conflict, and μ, gain of a free cell

    Returns
    -------
    (T, D, D) float64
    """
    total = np.zeros((len(turns), len(shifts), len(shifts)))
    target = pose.moved(centre)
    for table, walls, free in zip(
        comparison.tables, comparison.walls, comparison.free, strict=True
    ):
        for k, turn in enumerate(turns):
            c, s = np.cos(pose.yaw + turn), np.sin(pose.yaw + turn)
            start = (target - np.array([[c, -s], [s, c]]) @ centre - table.origin) / CELL
            total[k] += _score_shifts(
                table.pull, table.kind, walls, free, c, s, start, shifts / CELL,
                weights[0], weights[1], comparison.wall_share, comparison.free_share,
            )  # fmt: skip
    return total


@njit(cache=True, nogil=True)
def _score_shifts(  # type: ignore[no-untyped-def]
    pull, kind, walls, free, c, s, start, shifts, conflict, gain, wall_share, free_share
):
    """S of one storey at one yaw and every shift; positions in cells of a's tables."""
    nx, ny = kind.shape
    n = len(shifts)
    result = np.zeros((n, n))
    for w in range(len(walls)):
        x = (c * walls[w, 0] - s * walls[w, 1]) / CELL + start[0] + 0.5
        y = (s * walls[w, 0] + c * walls[w, 1]) / CELL + start[1] + 0.5
        side_x = c * walls[w, 2] - s * walls[w, 3]
        side_y = s * walls[w, 2] + c * walls[w, 3]
        for p in range(n):
            i = int(np.floor(x + shifts[p]))
            if i < 0 or i >= nx:
                continue
            for q in range(n):
                j = int(np.floor(y + shifts[q]))
                if j < 0 or j >= ny:
                    continue
                cell = pull[i, j]
                result[p, q] += wall_share * (
                    cell[0] + cell[1] * side_x + cell[2] * side_y - conflict * cell[3]
                )
    for f in range(len(free)):
        x = (c * free[f, 0] - s * free[f, 1]) / CELL + start[0] + 0.5
        y = (s * free[f, 0] + c * free[f, 1]) / CELL + start[1] + 0.5
        for p in range(n):
            i = int(np.floor(x + shifts[p]))
            if i < 0 or i >= nx:
                continue
            for q in range(n):
                j = int(np.floor(y + shifts[q]))
                if j < 0 or j >= ny:
                    continue
                if kind[i, j] == 1:
                    result[p, q] += free_share * gain
                elif kind[i, j] == 2:
                    result[p, q] -= free_share * conflict
    return result


def common_centre(comparison: Comparison, pose: Pose) -> NDArray[np.float64]:
    """Return the centroid of b's walls within 0.3 m of a's at a pose: (2,) float64, m, b's frame.

    Turning about it keeps the walls in common together. Without any, the centroid of b's walls.
    """
    near = [
        walls[wall_distances(table, walls, pose) <= 3.0, :2]
        for table, walls in zip(comparison.tables, comparison.walls, strict=True)
    ]
    chosen = np.concatenate(near) if near else np.zeros((0, 2))
    if len(chosen) == 0:
        everything = [cells[:, :2] for cells in (*comparison.walls, *comparison.free)]
        chosen = np.concatenate(everything) if everything else chosen
    return chosen.mean(axis=0) if len(chosen) else np.zeros(2)


def wall_distances(
    table: StoreyFields, cells: NDArray[np.float64], pose: Pose
) -> NDArray[np.float32]:
    """Return how many cells each of b's cells (K, 2+) is from a's nearest wall at a pose: (K,)."""
    c, s = np.cos(pose.yaw), np.sin(pose.yaw)
    x = c * cells[:, 0] - s * cells[:, 1] + pose.x
    y = s * cells[:, 0] + c * cells[:, 1] + pose.y
    i = np.floor((x - table.origin[0]) / CELL + 0.5).astype(np.int64)
    j = np.floor((y - table.origin[1]) / CELL + 0.5).astype(np.int64)
    nx, ny = table.kind.shape
    inside = (i >= 0) & (i < nx) & (j >= 0) & (j < ny)
    result = np.full(len(cells), np.inf, np.float32)
    result[inside] = table.wall_distance[i[inside], j[inside]]
    return result
