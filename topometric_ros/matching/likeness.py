"""Whether what two maps share occurs elsewhere in them too: one of many like rooms proves little.

A pose that brings together a single room is believed because nothing contradicts it and no other
pose of the maps comes near. Where rooms repeat, the room next to it would do as well, and whether
the maps hold it is luck. So the part in common is cut out and searched for in either map.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.matching.evidence import evaluate
from topometric_ros.matching.search_fields import CELL, MapFields, ScoringConfig, StoreyFields
from topometric_ros.matching.search_poses import (
    Pose,
    compare,
    pose_of,
    same_pose,
    score_around,
    storey_pairs,
)
from topometric_ros.matching.search_refine import DISTINCT, RefineConfig, refine_poses
from topometric_ros.matching.search_sweep import SweepConfig, sweep

_REACH = 2
"""Cells round what the other map knows that still count as seen by both."""

_ALIKE = 0.1
"""Share of the walls that may conflict where a place is alike: copies of a room show 0 to 0.04,
rooms of other sizes 0.15 to 0.3, though their S may be as good."""

_ALIKE_FLOOR = 0.2
"""Share of the floor in common that must lie on floor there: walls alone are no place."""

_SWEEP = SweepConfig(keep=24)
_REFINE = RefineConfig(coarse_samples=3000, second_samples=6000, keep_coarse=8, keep=5)


def likeness(
    a: MapFields,
    b: MapFields,
    T_a_b: NDArray[np.float64],
    config: ScoringConfig,
    copies: bool = False,
) -> float:
    """Return how well what two maps share at a pose fits elsewhere: a share of how it fits there.

    Parameters
    ----------
    a, b : what :func:`search_fields.prepare` made of the maps
    T_a_b : (4, 4) float64, m, level frame of b to level frame of a
    config : ScoringConfig, the same that the search used
    copies : count only places whose walls fit as a copy's would; else rough likeness does

    Returns
    -------
    0 where it is unlike everything else, 1 and more where it fits elsewhere as well as there; of
    both maps the larger
    """
    pose = pose_of(T_a_b)
    back = pose_of(np.asarray(np.linalg.inv(pose.matrix()), np.float64))
    ways = ((a, _common_part(a, b, pose), pose), (b, _common_part(b, a, back), back))
    return max(_elsewhere(host, part, there, config, copies) for host, part, there in ways)


def _elsewhere(
    host: MapFields, part: MapFields, there: Pose, config: ScoringConfig, copies: bool
) -> float:
    """S of the best other pose of a part in a map, over S of the given one."""
    cells = [s.walls for s in part.storeys if len(s.walls)]
    if not cells:
        return 1.0
    weights = (config.conflict_weight, config.free_weight)
    still = np.zeros(1)
    comparison = compare(host, part, there.height, None)
    score = score_around(comparison, there, np.zeros(2), still, still, weights)[0, 0, 0]
    if score <= 0.0:
        return 1.0
    centre = np.concatenate(cells).mean(axis=0)
    found = refine_poses(host, part, sweep(host, part, _SWEEP), config, _REFINE)
    others = [p for p in found if not same_pose(p, there, centre, DISTINCT)]
    if copies:
        floor = evaluate(host, part, there.matrix(), config).free_floor
        others = [p for p in others if _is_copy(host, part, p, floor, config)]
    return max(0.0, *(float(p.score) for p in others)) / score if others else 0.0


def _is_copy(
    host: MapFields, part: MapFields, pose: Pose, floor: float, config: ScoringConfig
) -> bool:
    """Whether a part fits a pose as its copy would, of which some of the floor (m²) was seen."""
    there = evaluate(host, part, pose.matrix(), config)
    return there.wall_conflict <= _ALIKE and there.free_floor >= _ALIKE_FLOOR * floor


def _common_part(a: MapFields, b: MapFields, pose: Pose) -> MapFields:
    """Return the cells of b that lie where a has seen walls or free floor."""
    storeys = []
    for i, j in storey_pairs(a, b, pose.height):
        table, storey = a.storeys[i], b.storeys[j]
        seen = ndimage.binary_dilation(table.kind > 0, iterations=_REACH)
        wall = _lookup(table, seen, storey.walls, pose)
        free = _lookup(table, seen, storey.free, pose)
        part = replace(
            storey,
            walls=storey.walls[wall],
            wall_sides=storey.wall_sides[wall],
            free=storey.free[free],
        )
        if len(part.walls) + len(part.free):
            storeys.append(part)
    return MapFields(tuple(storeys))


def _lookup(
    table: StoreyFields, mask: NDArray[np.bool_], cells: NDArray[np.float64], pose: Pose
) -> NDArray[np.bool_]:
    """Return which of b's cells (K, 2) fall on the mask of a's table at a pose: (K,)."""
    moved = cells @ pose.matrix()[:2, :2].T + (pose.x, pose.y)
    index = np.floor((moved - table.origin) / CELL + 0.5).astype(np.int64)
    inside = np.all((index >= 0) & (index < mask.shape), axis=1)
    index[~inside] = 0
    return inside & mask[index[:, 0], index[:, 1]]
