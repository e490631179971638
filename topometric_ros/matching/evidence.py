"""What speaks for and against a pose, counted on the storeys that it brings together.

Any candidate is judged here, whatever proposed it. Everything is counted twice, b's cells in a's
tables and the reverse, and the worse count holds: a pose and its inverse get the same evidence.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.matching.search_fields import (
    CELL,
    MapFields,
    ScoringConfig,
    StoreyFields,
    prepare,
    storey_pairs,
)
from topometric_ros.matching.search_poses import (
    Pose,
    common_centre,
    compare,
    pose_of,
    score_around,
)
from topometric_ros.matching.search_refine import RefineConfig, refine_pose
from topometric_ros.topometric_map import TopometricMap

_NEAR = 1.5
"""Cells within which a wall stands on a wall, or furniture on furniture."""

_IN_FRONT = (3, 4, 5)
"""Cells in front of a wall, on its free side: where two of them are free, it was in plain view."""

_THERE, _ABSENT = 2.0, 3.0
"""Cells to the nearest wall up to which a wall in plain view is there, and past which it is not."""

_SCORE_ZERO_AT_WALLS = 0.1
_SCORE_ZERO_AT_FURNITURE = 0.5
_FURNITURE_ASSUMED = 10
"""Furniture cells in agreement that are added to those judged: few cells say little."""

_SCORE_FULL_ACROSS = 0.25
"""Wall across as a share of that along: a corridor that slides along another has less.

Otherwise the free floor of two corridors outweighs the walls of two rooms."""


@dataclass(frozen=True)
class Evidence:
    """The evidence of one pose; of both directions the worse.

    Shares are of the cells that could be judged, lengths and areas in m and m².
    """

    score: float
    """S of the pose, see `search_poses.score_around`."""
    value: float
    """S made smaller by conflicts: what poses are compared by."""
    wall_agree: int
    """Wall cells on the other map's walls."""
    wall_conflict_cells: int
    """Wall cells well inside the other map's seen-free floor, in the worse direction."""
    wall_conflict: float
    """Conflict / (conflict + agree): 0 where nothing could be judged."""
    free_floor: float
    """Floor that both maps saw free, m²."""
    free_share: float
    """The same as a share of all that the smaller map saw free: 1 where it adds no floor."""
    agreed_wall: float
    """Wall that both saw from the same side, m."""
    smallest_eigenvalue: float
    """m: of the sum of n nᵀ over `agreed_wall`. A corridor alone cannot fix its own length."""
    furniture_judged: int
    furniture_conflict_cells: int
    furniture_conflict: float
    """Share of the furniture seen by one where the other saw the bare floor."""
    wall_in_view: int
    """Wall cells of either map in front of which the other saw free floor: it had to see them."""
    wall_absent: float
    """Share of those where the other has no wall: a door, say, where there should be none."""
    storeys: int
    """Storeys that the pose brings together."""
    centre: tuple[float, float, float]
    """Centroid of b's walls in common, m, level frame of b: where poses are compared."""


def evaluate(
    a: TopometricMap | MapFields,
    b: TopometricMap | MapFields,
    T_a_b: NDArray[np.float64],
    config: ScoringConfig,
) -> Evidence:
    """Count what speaks for and against a pose.

    Parameters
    ----------
    a, b : maps, or what :func:`search_fields.prepare` made of them
    T_a_b : (4, 4) float64, m, level frame of b to level frame of a; its tilt is left out
    config : ScoringConfig, the same that the search used

    Returns
    -------
    Evidence; all counts are 0 where the pose brings no storeys together
    """
    fields_a, fields_b = prepare(a, config), prepare(b, config)
    pose = pose_of(T_a_b)
    back = pose_of(np.asarray(np.linalg.inv(pose.matrix()), np.float64))
    ways = [
        _one_way(fields_a, fields_b, pose, config),
        _one_way(fields_b, fields_a, back, config),
    ]
    counts = [way[1] for way in ways]
    score = min(way[0] for way in ways)
    wall = max((_share(c.conflict, c.agree), c.conflict) for c in counts)
    furniture = max(
        (_share(c.furniture_conflict, c.furniture_agree), c.furniture_conflict, c.furniture_judged)
        for c in counts
    )
    in_view, absent = (sum(c.in_view for c in counts), sum(c.absent for c in counts))
    centre = common_centre(compare(fields_a, fields_b, pose.height, None), pose)
    along = max(min(c.same_side for c in counts) * CELL, 1e-6)
    across = min(c.smallest_eigenvalue for c in counts)
    return Evidence(
        score=score,
        value=_value(score, wall[0], furniture[1:], across / along),
        wall_agree=min(c.agree for c in counts),
        wall_conflict_cells=wall[1],
        wall_conflict=wall[0],
        free_floor=min(c.free for c in counts) * CELL**2,
        free_share=min(c.free for c in counts)
        / max(1, min(map(_free_cells, (fields_a, fields_b)))),
        agreed_wall=min(c.same_side for c in counts) * CELL,
        smallest_eigenvalue=across,
        furniture_judged=furniture[2],
        furniture_conflict_cells=furniture[1],
        furniture_conflict=furniture[0],
        wall_in_view=in_view,
        wall_absent=_share(absent, in_view - absent),
        storeys=len(storey_pairs(fields_a, fields_b, pose.height)),
        centre=(float(centre[0]), float(centre[1]), 0.0),
    )


def _free_cells(fields: MapFields) -> int:
    return sum(len(storey.free) for storey in fields.storeys)


def _value(score: float, wall: float, furniture: tuple[int, int], across: float) -> float:
    """Return S made smaller by conflicts and where the walls in common hardly fix the position.

    `wall` is a share, `furniture` the cells in conflict and judged, `across` the smallest
    eigenvalue as a share of all wall in common.
    """
    displaced, judged = furniture
    share = displaced / (judged + _FURNITURE_ASSUMED)
    along = max(1.0 - across, 1e-6)
    return (
        max(0.0, score)
        * max(0.0, 1.0 - wall / _SCORE_ZERO_AT_WALLS)
        * max(0.0, 1.0 - share / _SCORE_ZERO_AT_FURNITURE)
        * min(1.0, across / along / _SCORE_FULL_ACROSS)
    )


def refine(
    a: TopometricMap | MapFields,
    b: TopometricMap | MapFields,
    T_a_b: NDArray[np.float64],
    config: ScoringConfig,
) -> NDArray[np.float64]:
    """Return the best planar pose near a rough one (within about 3° and 0.5 m), same height.

    A candidate of another source than the search must be refined before its evidence is compared
    with others': the runner-up of a pose must not be a rough copy of the same pose.
    """
    fields_a, fields_b = prepare(a, config), prepare(b, config)
    return refine_pose(fields_a, fields_b, pose_of(T_a_b), config, RefineConfig()).matrix()


@dataclass(frozen=True)
class _Counts:
    """Cells of one map judged in the other's tables."""

    smallest_eigenvalue: float
    agree: int
    conflict: int
    same_side: int
    free: int
    furniture_agree: int
    furniture_conflict: int
    in_view: int
    absent: int

    @property
    def furniture_judged(self) -> int:
        return self.furniture_agree + self.furniture_conflict


def _share(against: int, with_it: int) -> float:
    return against / (against + with_it) if against else 0.0


def _one_way(
    a: MapFields, b: MapFields, pose: Pose, config: ScoringConfig
) -> tuple[float, _Counts]:
    """S and the counts of b's cells in a's tables."""
    weights = (config.conflict_weight, config.free_weight)
    comparison = compare(a, b, pose.height, None)
    still = np.zeros(1)
    score = score_around(comparison, pose, np.zeros(2), still, still, weights)[0, 0, 0]
    total = np.zeros(11)
    for i, j in storey_pairs(a, b, pose.height):
        total += _count(a.storeys[i], b.storeys[j], pose, config.conflict_depth / CELL)
    xx, xy, yy = total[8:11]
    smallest = (xx + yy) / 2.0 - np.hypot((xx - yy) / 2.0, xy)
    counts = [int(n) for n in total[:8]]
    return float(score), _Counts(float(smallest) * CELL, *counts)


def _count(a: StoreyFields, b: StoreyFields, pose: Pose, depth: float) -> NDArray[np.float64]:
    """Counts of one pair of storeys, in the order of `_Counts`, and last Σ n nᵀ (xx, xy, yy)."""
    c, s = np.cos(pose.yaw), np.sin(pose.yaw)
    start = (np.array([pose.x, pose.y]) - a.origin) / CELL
    walls = _count_walls(
        a.wall_distance, a.side, a.free_depth, b.walls, b.wall_sides, c, s, start, depth
    )
    agree, conflict, same_side, xx, xy, yy = walls
    free = _count_free(a.kind, b.free, c, s, start)
    placed, displaced = _count_furniture(
        a.furniture_distance, a.bare_depth, b.furniture, c, s, start, depth
    )
    in_view, absent = _count_in_view(
        a.kind, a.wall_distance, b.walls, b.wall_sides, c, s, start, np.array(_IN_FRONT)
    )
    return np.array(
        [agree, conflict, same_side, free, placed, displaced, in_view, absent, xx, xy, yy], float
    )


@njit(cache=True, nogil=True)
def _count_walls(  # type: ignore[no-untyped-def]
    wall_distance, side, free_depth, walls, wall_sides, c, s, start, depth
):
    """Wall cells that agree, conflict, agree from the same side, and Σ n nᵀ of the last."""
    agree, conflict, same = 0, 0, 0
    xx, xy, yy = 0.0, 0.0, 0.0
    for w in range(len(walls)):
        i = int(np.floor((c * walls[w, 0] - s * walls[w, 1]) / CELL + start[0] + 0.5))
        j = int(np.floor((s * walls[w, 0] + c * walls[w, 1]) / CELL + start[1] + 0.5))
        if i < 0 or j < 0 or i >= wall_distance.shape[0] or j >= wall_distance.shape[1]:
            continue
        if wall_distance[i, j] <= _NEAR:
            agree += 1
            x = c * wall_sides[w, 0] - s * wall_sides[w, 1]
            y = s * wall_sides[w, 0] + c * wall_sides[w, 1]
            if x * side[i, j, 0] + y * side[i, j, 1] > 0.5:
                same += 1
                xx += x * x
                xy += x * y
                yy += y * y
        elif free_depth[i, j] >= depth:
            conflict += 1
    return agree, conflict, same, xx, xy, yy


@njit(cache=True, nogil=True)
def _count_in_view(  # type: ignore[no-untyped-def]
    kind, wall_distance, walls, wall_sides, c, s, start, in_front
):
    """Wall cells in front of which the other map saw free floor, and those it has no wall for."""
    in_view, absent = 0, 0
    for w in range(len(walls)):
        nx, ny = wall_sides[w]
        if nx * nx + ny * ny < 0.25:
            continue
        free = 0
        for cells in in_front:
            x = walls[w, 0] + cells * CELL * nx
            y = walls[w, 1] + cells * CELL * ny
            i = int(np.floor((c * x - s * y) / CELL + start[0] + 0.5))
            j = int(np.floor((s * x + c * y) / CELL + start[1] + 0.5))
            if i >= 0 and j >= 0 and i < kind.shape[0] and j < kind.shape[1]:
                free += kind[i, j] == 1
        i = int(np.floor((c * walls[w, 0] - s * walls[w, 1]) / CELL + start[0] + 0.5))
        j = int(np.floor((s * walls[w, 0] + c * walls[w, 1]) / CELL + start[1] + 0.5))
        outside = i < 0 or j < 0 or i >= kind.shape[0] or j >= kind.shape[1]
        if free < 2 or outside:
            continue
        if wall_distance[i, j] <= _THERE:
            in_view += 1
        elif wall_distance[i, j] > _ABSENT:
            in_view += 1
            absent += 1
    return in_view, absent


@njit(cache=True, nogil=True)
def _count_free(kind, free, c, s, start):  # type: ignore[no-untyped-def]
    """Free cells that are free in the other map too."""
    count = 0
    for f in range(len(free)):
        i = int(np.floor((c * free[f, 0] - s * free[f, 1]) / CELL + start[0] + 0.5))
        j = int(np.floor((s * free[f, 0] + c * free[f, 1]) / CELL + start[1] + 0.5))
        inside = i >= 0 and j >= 0 and i < kind.shape[0] and j < kind.shape[1]
        if inside and kind[i, j] == 1:
            count += 1
    return count


@njit(cache=True, nogil=True)
def _count_furniture(  # type: ignore[no-untyped-def]
    distance, bare_depth, cells, c, s, start, depth
):
    """Furniture cells on the other map's furniture, and on its bare floor."""
    placed, displaced = 0, 0
    for f in range(len(cells)):
        i = int(np.floor((c * cells[f, 0] - s * cells[f, 1]) / CELL + start[0] + 0.5))
        j = int(np.floor((s * cells[f, 0] + c * cells[f, 1]) / CELL + start[1] + 0.5))
        if i < 0 or j < 0 or i >= distance.shape[0] or j >= distance.shape[1]:
            continue
        if distance[i, j] <= _NEAR:
            placed += 1
        elif bare_depth[i, j] >= depth:
            displaced += 1
    return placed, displaced
