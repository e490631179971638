"""What a prior changes in the alignment of two maps: fewer rivals, one candidate more, a veto."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.poses import Transform, input_frames, level_frames, yaw_of, yaw_pose
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.fusion.priors import Prior
from topometric_ros.fusion.rivals import Judged
from topometric_ros.fusion.verification import Decision, decide
from topometric_ros.matching.candidate import Candidate
from topometric_ros.matching.evidence import evaluate, refine

_NEAR = (1.0, np.radians(15.0))
"""Standard deviations (m, rad) up to which a prior tells a place from its twin elsewhere."""

_CONTRADICTION = "one of the two is wrong"
"""What the reason says where maps and prior contradict each other; no prior decides there alone."""

_CONFLICT_CELLS = 20
"""Wall cells in the other's free floor from which the maps contradict a prior."""


def candidate_of(prior: Prior, a: Prepared, b: Prepared, config: MergeConfig) -> Candidate:
    """Return the pose that fits best near the prior, level frame of b to that of a."""
    T = _planar(level_frames(prior.T, a.map.T_level_input, b.map.T_level_input))
    return Candidate(refine(a.fields, b.fields, T, config.search.scoring), "prior", 0.0)


def decide_by_prior(
    judged: Sequence[Judged],
    decision: Decision,
    prior: Prior,
    a: Prepared,
    b: Prepared,
    config: MergeConfig,
) -> tuple[list[Judged], Decision]:
    """Decide among the poses that a prior allows.

    Parameters
    ----------
    judged : all candidates with their evidence
    decision : what would be decided without the prior

    Returns
    -------
    the allowed candidates and the decision among them; where the maps alone speak clearly for a
    pose that is not allowed, that decision, rejected, and all candidates
    """
    allowed = [j for j in judged if prior.allows(_of_input(j[0].T_a_b, a, b))]
    if decision.status is AlignmentStatus.ACCEPTED and decision.best is not None:
        T = _of_input(judged[decision.best][0].T_a_b, a, b)
        if not prior.allows(T):
            reason = f"the maps fit {prior.told(T)}: {_CONTRADICTION} ({decision.reason})"
            refused = replace(decision, status=AlignmentStatus.REJECTED, reason=reason)
            return list(judged), replace(refused, confidence=0.0)
    spread = np.sqrt(np.diag(prior.covariance))
    limits = config.verification
    if max(spread[:2]) <= _NEAR[0] and spread[5] <= _NEAR[1]:
        # Identical flats and repeated rooms lie farther off than that.
        limits = replace(limits, twin_share=2.0, repeated_floor=0.0)
    among = decide(allowed, limits)
    if among.status is AlignmentStatus.ACCEPTED:
        among = replace(among, reason=f"{among.reason}, among the poses that the prior allows")
    return allowed, among


def with_prior(
    alignment: Alignment, prior: Prior, a: Prepared, b: Prepared, config: MergeConfig
) -> Alignment:
    """Return an alignment that does not contradict the prior, by the prior alone where it may be.

    Parameters
    ----------
    alignment : of the input frames of a and b
    """
    if alignment.accepted and alignment.T_a_b is not None:
        if prior.allows(alignment.T_a_b):
            return alignment
        told = f"the maps fit {prior.told(alignment.T_a_b)}: {_CONTRADICTION}"
        return Alignment(alignment.agents, AlignmentStatus.REJECTED, told)
    if not prior.alone or _CONTRADICTION in alignment.reason:
        return alignment
    T = _planar(level_frames(prior.T, a.map.T_level_input, b.map.T_level_input))
    evidence = evaluate(a.fields, b.fields, T, config.search.scoring)
    allowed = config.verification.wall_conflict
    if evidence.wall_conflict_cells >= _CONFLICT_CELLS and evidence.wall_conflict > allowed:
        told = f"{evidence.wall_conflict:.1%} of the walls conflict at the {prior.name}"
        return replace(alignment, reason=f"{told}; {alignment.reason}")
    return replace(
        alignment,
        status=AlignmentStatus.ACCEPTED,
        reason=f"by the {prior.name} alone, nothing speaks against it ({alignment.reason})",
        T_a_b=prior.T,
        covariance=prior.covariance,
        confidence=0.5,
        score=evidence.value,
    )


def _planar(T: Transform) -> Transform:
    return yaw_pose(yaw_of(T), T[:3, 3])


def _of_input(T_level: Transform, a: Prepared, b: Prepared) -> Transform:
    return input_frames(T_level, a.map.T_level_input, b.map.T_level_input)
