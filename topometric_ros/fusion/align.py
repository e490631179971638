"""Aligning two maps: propose, judge, decide, register, judge again.

Poses are proposed from matched rooms (thesis §4.3) and by the global search over the storeys'
rasters; what was seen free in one map and solid in the other decides between them; the winner is
registered finely and must pass the same gates once more.
"""

from __future__ import annotations

import logging
from dataclasses import replace
from functools import partial

import numpy as np

from topometric_ros.alignment import Alignment, AlignmentStatus, Alternative, RoomMatch
from topometric_ros.fusion.align_by_prior import candidate_of, decide_by_prior, with_prior
from topometric_ros.fusion.candidates import find_candidates
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.fine_pose import fine_pose, fine_poses
from topometric_ros.fusion.gates import missed_gate, objection
from topometric_ros.fusion.judge import FinePose, FurnitureAt, furniture_at, judge, unless_elsewhere
from topometric_ros.fusion.overlap import same_rooms, shared_voxels
from topometric_ros.fusion.poses import Transform, apart, carried, input_frames, inverse
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.fusion.priors import Prior, parse_priors, prior_between
from topometric_ros.fusion.registration import (
    Registration,
    RegistrationError,
)
from topometric_ros.fusion.rivals import Judged
from topometric_ros.fusion.scale import stretch, unlike_scale
from topometric_ros.fusion.twins import twin_doubt
from topometric_ros.fusion.verification import TWIN_TRUST, Decision
from topometric_ros.matching.candidate import Candidate
from topometric_ros.matching.evidence import Evidence, evaluate
from topometric_ros.matching.propose import room_distances
from topometric_ros.matching.search_fields import ScoringConfig
from topometric_ros.stopwatch import Stopwatch
from topometric_ros.topometric_map import TopometricMap

logger = logging.getLogger(__name__)

SAME_ROOM_SHARE = 0.5
"""Share of what both maps saw of the smaller of two rooms that makes them the same place."""


def align(
    a: TopometricMap | Prepared,
    b: TopometricMap | Prepared,
    config: MergeConfig,
    stopwatch: Stopwatch | None = None,
) -> Alignment:
    """Find the transform from the input frame of map b to that of map a, or say why there is none.

    Parameters
    ----------
    a, b : maps of two agents, or what was prepared of them
    config : MergeConfig
    stopwatch : gathers the CPU seconds of the stages

    Raises
    ------
    ConfigurationError
        A prior makes no sense.
    """
    watch = stopwatch or Stopwatch()
    a, b = (
        m if isinstance(m, Prepared) else Prepared(m, config.search.scoring, config.matching)
        for m in (a, b)
    )
    if not (len(a.map.voxels) and len(b.map.voxels)):
        empty = a if len(a.map.voxels) == 0 else b
        return _refused(a, b, AlignmentStatus.NONE, f"the map of {empty.map.agent!r} is empty")
    coarser = max(a.map.voxel_size, b.map.voxel_size)
    a, b = a.at(coarser), b.at(coarser)
    prior = prior_between(parse_priors(config.priors), a.map.agent, b.map.agent)
    alignment = _aligned(a, b, config, watch, prior)
    if prior is not None:
        alignment = with_prior(alignment, prior, a, b, config)
    told = None if alignment.accepted else unlike_scale(a.map, b.map)
    return alignment if told is None else replace(alignment, reason=f"{told} ({alignment.reason})")


def _aligned(
    a: Prepared, b: Prepared, config: MergeConfig, watch: Stopwatch, prior: Prior | None
) -> Alignment:
    """Align two maps of one resolution."""
    candidates = find_candidates(a, b, config, watch)
    if config.check != "rivals":
        return _believed(a, b, candidates, config, watch)
    if prior is not None:
        candidates.append(candidate_of(prior, a, b, config))
    fine, furniture = fine_poses(a, b, config), furniture_at(a, b)
    with watch.stage("evidence"):
        judged, decision = judge(a, b, candidates, fine, furniture, config)
        if prior is not None:
            judged, decision = decide_by_prior(judged, decision, prior, a, b, config)
        else:
            decision = unless_elsewhere(a, b, judged, decision, fine, config)
    alternatives = _alternatives(a, b, decision)
    if decision.status is not AlignmentStatus.ACCEPTED or decision.best is None:
        refused = _refused(a, b, decision.status, decision.reason)
        score = judged[decision.best][1].value if decision.best is not None else 0.0
        return replace(
            refused, alternatives=alternatives, confidence=decision.confidence, score=score
        )
    best = judged[decision.best]
    return _registered(
        a, b, best, decision, fine, furniture, config, watch, ask_twins=prior is None
    )


def _registered(
    a: Prepared,
    b: Prepared,
    best: Judged,
    decision: Decision,
    fine: FinePose,
    furniture: FurnitureAt,
    config: MergeConfig,
    watch: Stopwatch,
    ask_twins: bool,
) -> Alignment:
    """Register an accepted candidate and judge it again where it ends.

    With `ask_twins` also whether an identical flat would look the same: before, furniture in
    conflict may have been too few cells to count, and to the centimetre it is compared only here.
    """
    candidate = best[0]
    alternatives = _alternatives(a, b, decision)
    try:
        with watch.stage("registration"):
            result = fine(candidate)
    except RegistrationError as error:
        refused = _refused(a, b, AlignmentStatus.REJECTED, f"registration failed: {error}")
        return replace(refused, alternatives=alternatives)
    T = result.T_target_source
    with watch.stage("evidence"):
        evidence = evaluate(a.fields, b.fields, T, _scoring(config))
    moved = apart(T, candidate.T_a_b, np.array([evidence.centre]))
    pieces = partial(furniture, T)
    refusal = objection(evidence, decision.gap, decision.ratio, config.verification, pieces)
    if moved > config.largest_correction:
        refusal = (
            f"registration moved the pose by {moved:.2f} m, at most "
            f"{config.largest_correction:g} m are believed"
        )
    refusal = refusal or _stretched(a, b, T, config, watch)
    if refusal is not None:
        refused = _refused(a, b, AlignmentStatus.REJECTED, f"after registration: {refusal}")
        return replace(refused, alternatives=alternatives, score=evidence.value)

    doubt = twin_doubt(evidence, config.verification, pieces) if ask_twins else None
    if doubt is not None:
        pose = Alternative(_to_input(a, b, T), evidence.value)
        return replace(
            _refused(a, b, AlignmentStatus.AMBIGUOUS, doubt),
            alternatives=(pose, *alternatives[1:]),
            confidence=min(decision.confidence, TWIN_TRUST),
            score=evidence.value,
        )
    return _accepted(a, b, result, decision, alternatives[1:], evidence, config, watch)


def _stretched(
    a: Prepared, b: Prepared, T: Transform, config: MergeConfig, watch: Stopwatch
) -> str | None:
    """Return in words why two maps that fit are of unlike scale, or None."""
    try:
        with watch.stage("registration"):
            factor, spread = stretch(b.surface, a.surface, T, config.registration, a.tree)
    except RegistrationError as error:
        return str(error)
    if abs(factor - 1.0) - 2.0 * spread <= config.largest_stretch:
        return None
    return (
        f"{a.map.agent} is {factor:.3f} times as large as {b.map.agent} "
        f"(± {2.0 * spread:.3f}), {config.largest_stretch:g} more or less is believed"
    )


def _believed(
    a: Prepared,
    b: Prepared,
    candidates: list[Candidate],
    config: MergeConfig,
    watch: Stopwatch,
) -> Alignment:
    """Accept the best hypothesis of matched rooms, with no other check than the gates."""
    if not candidates:
        return _refused(a, b, AlignmentStatus.NONE, "no rooms could be matched")
    best = candidates[0]
    try:
        with watch.stage("registration"):
            result = fine_pose(a, b, best, config)
    except RegistrationError as error:
        return _refused(a, b, AlignmentStatus.NONE, f"registration failed: {error}")
    with watch.stage("evidence"):
        evidence = evaluate(a.fields, b.fields, result.T_target_source, _scoring(config))
    checked = "it was not verified"
    if config.check == "gates":
        checked = "it passes the gates"
        missed = missed_gate(evidence, config.verification)
        if missed is not None:
            refused = _refused(a, b, AlignmentStatus.REJECTED, missed)
            pose = Alternative(_to_input(a, b, result.T_target_source), evidence.value)
            return replace(refused, alternatives=(pose,), score=evidence.value)
    decision = Decision(
        AlignmentStatus.ACCEPTED,
        f"the hypothesis of {len(best.matches)} matched rooms is the largest; {checked}",
        0,
        confidence=len(best.matches) / max(1, min(len(a.map.rooms), len(b.map.rooms))),
    )
    return _accepted(a, b, result, decision, (), evidence, config, watch)


def _accepted(
    a: Prepared,
    b: Prepared,
    result: Registration,
    decision: Decision,
    alternatives: tuple[Alternative, ...],
    evidence: Evidence,
    config: MergeConfig,
    watch: Stopwatch,
) -> Alignment:
    """Return the alignment with its overlap and its matches, in the input frames."""
    T = result.T_target_source
    with watch.stage("overlap"):
        rows_a, rows_b, overlap = shared_voxels(a.map, b.map, T)
        part = config.room_part
        pairs = same_rooms(a.map, b.map, rows_a, rows_b, SAME_ROOM_SHARE, part)
    with watch.stage("matching"):
        distances = room_distances(a.described, b.described, config.matching)
    return Alignment(
        agents=(a.map.agent, b.map.agent),
        status=AlignmentStatus.ACCEPTED,
        reason=decision.reason,
        T_a_b=_to_input(a, b, T),
        alternatives=alternatives,
        confidence=decision.confidence,
        overlap=overlap,
        rmse=result.rmse,
        matches=tuple(
            RoomMatch(a.map.rooms[i].id, b.map.rooms[j].id, float(distances[i, j]))
            for i, j in pairs
        ),
        covariance=_covariance_of_input(a, b, result),
        score=evidence.value,
        inliers=result.inliers,
    )


def _refused(a: Prepared, b: Prepared, status: AlignmentStatus, reason: str) -> Alignment:
    return Alignment((a.map.agent, b.map.agent), status, reason)


def _alternatives(a: Prepared, b: Prepared, decision: Decision) -> tuple[Alternative, ...]:
    """Return the poses that were considered, in the input frames, the best first."""
    return tuple(Alternative(_to_input(a, b, x.T_a_b), x.score) for x in decision.alternatives)


def _to_input(a: Prepared, b: Prepared, T_level: Transform) -> Transform:
    return input_frames(T_level, a.map.T_level_input, b.map.T_level_input)


def _covariance_of_input(
    a: Prepared, b: Prepared, result: Registration
) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    """Carry the covariance of the level frames' transform to the input frames'.

    With T_input = L_a⁻¹ T L_b a small turn ω of T also moves L_b's origin, by ω × R t_b.
    """
    turn = inverse(a.map.T_level_input)[:3, :3]
    arm = result.T_target_source[:3, :3] @ b.map.T_level_input[:3, 3]
    return carried(result.covariance, turn, arm)


def _scoring(config: MergeConfig) -> ScoringConfig:
    return config.search.scoring
