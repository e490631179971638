"""Judging the candidate poses of two maps by all that the maps hold.

`verification.decide` weighs numbers. What has to be looked up in the maps once more is asked here,
and only where it matters: a fine pose where a rough one is refused, ceilings, and the same rooms
elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from topometric_ros.alignment import AlignmentStatus
from topometric_ros.fusion.ceilings import open_above
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.furniture import Pieces, compare_furniture
from topometric_ros.fusion.poses import Transform, apart
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.fusion.registration import Registration, RegistrationError
from topometric_ros.fusion.rivals import Judged
from topometric_ros.fusion.verification import Decision, decide, doubt_repeated
from topometric_ros.matching.candidate import Candidate
from topometric_ros.matching.evidence import evaluate
from topometric_ros.matching.likeness import likeness

_CLEAN = 0.005
"""Share of the walls in conflict up to which only a copy casts doubt on a small part in common;
where more conflicts, the place may be a rough copy itself."""

FinePose = Callable[[Candidate], Registration]
"""Registers a candidate finely: `fusion.fine_pose.fine_poses` of two maps."""

FurnitureAt = Callable[[Transform], Pieces]
"""Compares the furniture of two maps, level frame of b to that of a: :func:`furniture_at`."""


def judge(
    a: Prepared,
    b: Prepared,
    candidates: Sequence[Candidate],
    fine: FinePose,
    furniture: FurnitureAt,
    config: MergeConfig,
) -> tuple[list[Judged], Decision]:
    """Return the candidates with their evidence, and what is decided.

    A pose that is refused for what conflicts is judged once more where it was registered: a few
    centimetres put walls into the other's free floor, and furniture that was moved can only be told
    there.
    """
    scoring = config.search.scoring
    judged = [(c, evaluate(a.fields, b.fields, c.T_a_b, scoring)) for c in candidates]
    decision = decide(judged, config.verification)
    finer = _registered_best(a, b, judged, decision, fine, config)
    if finer is not None:
        judged, decision = finer, decide(finer, config.verification)
    if decision.status is not AlignmentStatus.REJECTED or decision.best is None:
        return judged, decision
    best = judged[decision.best][0]

    def where_registered() -> Pieces:
        try:
            return furniture(fine(best).T_target_source)
        except RegistrationError:
            return Pieces(0, 0)

    return judged, decide(judged, config.verification, where_registered)


def furniture_at(a: Prepared, b: Prepared) -> FurnitureAt:
    """Return what compares the furniture of two maps to the centimetre, once for each pose.

    Judging and accepting ask for the same one.
    """
    made: dict[bytes, Pieces] = {}

    def at(T_a_b: Transform) -> Pieces:
        key = T_a_b.tobytes()
        if key not in made:
            made[key] = compare_furniture((a.map, a.surface), (b.map, b.surface), T_a_b)
        return made[key]

    return at


def unless_elsewhere(
    a: Prepared,
    b: Prepared,
    judged: Sequence[Judged],
    decision: Decision,
    fine: FinePose,
    config: MergeConfig,
) -> Decision:
    """Doubt an accepted pose that may be another storey, or one room of which there are more.

    The search for more of a room costs as much as that for the pose, so it is made for small parts
    only.
    """
    if decision.status is not AlignmentStatus.ACCEPTED or decision.best is None:
        return decision
    candidate, evidence = judged[decision.best]
    limits = config.verification
    contradiction = open_above(a.map, b.map, (a.fields, b.fields), candidate.T_a_b)
    if contradiction is not None:
        status = AlignmentStatus.REJECTED
        return replace(decision, status=status, reason=contradiction.reason(), confidence=0.0)
    small = evidence.free_floor < limits.repeated_floor
    if not small or evidence.free_share >= limits.repeated_part:
        return decision
    try:
        T = fine(candidate).T_target_source
    except RegistrationError:
        T = candidate.T_a_b
    clean = evidence.wall_conflict <= _CLEAN
    share = likeness(a.fields, b.fields, T, config.search.scoring, copies=clean)
    return doubt_repeated(decision, evidence, share, limits)


def _registered_best(
    a: Prepared,
    b: Prepared,
    judged: list[Judged],
    decision: Decision,
    fine: FinePose,
    config: MergeConfig,
) -> list[Judged] | None:
    """Return the candidates with a refused best one registered; None where that changes nothing."""
    if decision.status is not AlignmentStatus.REJECTED or decision.best is None:
        return None
    candidate, evidence = judged[decision.best]
    conflicts = evidence.wall_conflict_cells + evidence.furniture_conflict_cells > 0
    if not conflicts or evidence.value < config.verification.clear_gap:
        return None
    try:
        T = fine(candidate).T_target_source
    except RegistrationError:
        return None
    if apart(T, candidate.T_a_b, np.array([evidence.centre])) > config.largest_correction:
        return None
    finer = evaluate(a.fields, b.fields, T, config.search.scoring)
    if finer.value <= evidence.value:
        return None
    result = list(judged)
    result[decision.best] = replace(candidate, T_a_b=T), finer
    return result
