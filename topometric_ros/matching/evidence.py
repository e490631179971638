"""What speaks for and against a pose, counted on the storeys that it brings together.

Any candidate is judged here, whatever proposed it. Everything is counted twice, b's cells in a's
tables and the reverse, and the worse count holds: a pose and its inverse get the same evidence.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from topometric_ros.matching.evidence_counts import Counts, count_cells, largest_leaf
from topometric_ros.matching.search_fields import (
    CELL,
    MapFields,
    ScoringConfig,
    prepare,
    storey_pairs,
)
from topometric_ros.matching.search_poses import (
    Comparison,
    Pose,
    common_centre,
    compare,
    pose_of,
    score_around,
)
from topometric_ros.matching.search_refine import RefineConfig, refine_pose
from topometric_ros.topometric_map import TopometricMap

_SCORE_ZERO_AT_WALLS, _SCORE_ZERO_AT_FURNITURE = 0.1, 0.5
"""Shares of the walls, and of the furniture, in conflict from which a pose has no value."""
_FURNITURE_ASSUMED = 10
"""Furniture cells in agreement that are added to those judged: few cells say little."""

_SCORE_FULL_ACROSS = 0.25
"""Wall across as a share of that along: a corridor that slides along another has less.

Otherwise the free floor of two corridors outweighs the walls of two rooms."""

_SCORE_FULL_FIXED = 0.6
"""Share of S that a slide must cost for the same: ends of walls and doors fix a position too.

A corridor laid on another one lost 0.25 at most, 20 of 21 right poses lost more than 0.3."""

_ACROSS_AT_ALL = 1.0
"""Wall across (m) from which what a slide costs counts in full."""

_ACROSS_NOT_ASKED = 2.5
"""Wall across (m) from which a slide is not tried where the share is large enough too."""

_SLIDES = np.arange(0.3, 2.0, 0.2)
"""How far along the walls (m); farther than poses that are one, nearer than the next room."""


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
    """Wall cells well inside the other map's seen-free floor, in the worse direction, without the
    largest clump that may be the leaf of a door."""
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
    fixed: float
    """Share of S lost where b slides along the walls in common: 1 where walls across prevent it."""
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
    counts = [way[2] for way in ways]
    score, fixed = min(way[0] for way in ways), min(way[1] for way in ways)
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
        value=_value(score, wall[0], furniture[1:], (across, across / along), fixed),
        wall_agree=min(c.agree for c in counts),
        wall_conflict_cells=wall[1],
        wall_conflict=wall[0],
        free_floor=min(c.free for c in counts) * CELL**2,
        free_share=min(c.free for c in counts)
        / max(1, min(map(_free_cells, (fields_a, fields_b)))),
        agreed_wall=min(c.same_side for c in counts) * CELL,
        smallest_eigenvalue=across,
        fixed=fixed,
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


def _value(
    score: float, wall: float, furniture: tuple[int, int], across: tuple[float, float], fixed: float
) -> float:
    """Return S made smaller by conflicts and where the walls in common hardly fix the position.

    `wall` is a share, `furniture` the cells in conflict and judged, `across` the smallest
    eigenvalue (m) and its share of all wall in common, `fixed` the share of S that a slide costs.
    """
    displaced, judged = furniture
    share = displaced / (judged + _FURNITURE_ASSUMED)
    length, part = across
    along = max(1.0 - part, 1e-6)
    held = min(1.0, length / _ACROSS_AT_ALL) * fixed / _SCORE_FULL_FIXED
    return (
        max(0.0, score)
        * max(0.0, 1.0 - wall / _SCORE_ZERO_AT_WALLS)
        * max(0.0, 1.0 - share / _SCORE_ZERO_AT_FURNITURE)
        * min(1.0, max(part / along / _SCORE_FULL_ACROSS, held))
    )


def refine(
    a: TopometricMap | MapFields,
    b: TopometricMap | MapFields,
    T_a_b: NDArray[np.float64],
    config: ScoringConfig,
) -> NDArray[np.float64]:
    """Return the best planar pose (4, 4) near a rough one: within some 3° and 0.5 m, same height.

    A candidate of another source than the search must be refined before its evidence is compared
    with others': the runner-up of a pose must not be a rough copy of the same pose.
    """
    fields_a, fields_b = prepare(a, config), prepare(b, config)
    return refine_pose(fields_a, fields_b, pose_of(T_a_b), config, RefineConfig()).matrix()


def _share(against: int, with_it: int) -> float:
    return against / (against + with_it) if against else 0.0


def _one_way(
    a: MapFields, b: MapFields, pose: Pose, config: ScoringConfig
) -> tuple[float, float, Counts]:
    """S, what of it is lost by sliding, and the counts of b's cells in a's tables."""
    weights = (config.conflict_weight, config.free_weight)
    comparison = compare(a, b, pose.height, None)
    score = _score(comparison, pose, weights)
    total, leaf = np.zeros(11), 0
    depth = config.conflict_depth / CELL
    for i, j in storey_pairs(a, b, pose.height):
        counted = count_cells(a.storeys[i], b.storeys[j], pose, depth)
        total += counted
        if counted[1] > 0:
            leaf = max(leaf, largest_leaf(a.storeys[i], b.storeys[j], pose, depth))
    total[1] -= leaf
    xx, xy, yy = total[8:11]
    (smallest, largest), axes = np.linalg.eigh(np.array([[xx, xy], [xy, yy]]) * CELL)
    fixed = 1.0
    if score > 0.0 and smallest < max(_ACROSS_NOT_ASKED, _SCORE_FULL_ACROSS * largest):
        slid = _best_slid(comparison, pose, axes[:, 0], weights)
        fixed = min(1.0, 1.0 - slid / score)
    counts = [int(n) for n in total[:8]]
    return score, fixed, Counts(float(max(0.0, smallest)), *counts)


def _score(comparison: Comparison, pose: Pose, weights: tuple[float, float]) -> float:
    still = np.zeros(1)
    return float(score_around(comparison, pose, np.zeros(2), still, still, weights)[0, 0, 0])


def _best_slid(
    comparison: Comparison, pose: Pose, along: NDArray[np.float64], weights: tuple[float, float]
) -> float:
    """Return the best S of the poses slid along a direction (2,) of a's plan."""
    return max(
        _score(comparison, replace(pose, x=pose.x + x, y=pose.y + y), weights)
        for x, y in np.outer(np.concatenate([_SLIDES, -_SLIDES]), along)
    )
