"""The poses that compete with the best one, and when a near look-alike may be told from it.

Buildings repeat themselves: the halves of a duplex fit each other half-turned nearly as well as
themselves. What tells the wrong half is a wall that should be there: the floor right before it was
seen, the wall itself was not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from topometric_ros.fusion.poses import angle, apart, inverse
from topometric_ros.matching.candidate import Candidate
from topometric_ros.matching.evidence import Evidence
from topometric_ros.matching.search_poses import pose_of, same_pose

Judged = tuple[Candidate, Evidence]

_CLEAN_CONFLICT = 0.005
"""Largest wall conflict of a pose that may be told from a look-alike by absent walls."""

_CLEAN_IN_VIEW = 300
"""Fewest wall cells in view of such a pose: two rooms or so."""

_CLEAN_ABSENT = 0.025
"""Largest share of them that may be absent; right poses show 0 to 0.026, noise of the rasters."""

_LEAST_ABSENT = 0.01
"""A smaller share of the best pose counts as this much, so that no ratio is made of noise."""

_TIMES_ABSENT = 2.5
"""How many times more of its walls in view a look-alike must lack."""


def distinct(
    judged: Sequence[Judged], order: Sequence[int], reach: tuple[float, float, float]
) -> list[int]:
    """Return the indices in `order` without those whose pose is one with an earlier one.

    Parameters
    ----------
    judged : candidates with their evidence
    order : indices of `judged`, best first
    reach : m on the plan, rad and m in height within which two poses are one
    """
    kept: list[int] = []
    for k in order:
        pose = pose_of(judged[k][0].T_a_b)
        if not any(
            same_pose(pose_of(judged[j][0].T_a_b), pose, np.array(judged[j][1].centre[:2]), reach)
            for j in kept
        ):
            kept.append(k)
    return kept


def difference(
    one: NDArray[np.float64], other: NDArray[np.float64], centre: tuple[float, float, float]
) -> tuple[float, float]:
    """Return how far (m) and by what angle (degrees) a second pose moves the walls in common."""
    return apart(one, other, np.array([centre])), float(np.degrees(angle(inverse(one) @ other)))


def disproved_margin(best: Evidence, rivals: Sequence[Evidence]) -> float:
    """Return how clearly absent walls disprove every rival of a clean pose: from 1 they do.

    It is the smallest share of absent walls among the rivals, over the share that disproves:
    `_TIMES_ABSENT` times the best pose's. 0 where the best pose is not clean itself or no rival
    is given.
    """
    clean = (
        best.wall_conflict <= _CLEAN_CONFLICT
        and best.wall_in_view >= _CLEAN_IN_VIEW
        and best.wall_absent <= _CLEAN_ABSENT
    )
    if not clean or not rivals:
        return 0.0
    needed = _TIMES_ABSENT * max(best.wall_absent, _LEAST_ABSENT)
    return min(rival.wall_absent for rival in rivals) / needed
