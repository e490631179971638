"""Whether a new alignment of two agents replaces the one that is in use."""

from __future__ import annotations

import dataclasses
import logging

import numpy as np

from topometric_ros.alignment import Alignment
from topometric_ros.fusion.align import Prepared
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.gates import missed_gate, objection
from topometric_ros.fusion.judge import furniture_at
from topometric_ros.fusion.poses import Transform, angle, apart, inverse, level_frames
from topometric_ros.fusion.priors import parse_priors, prior_between
from topometric_ros.matching.evidence import Evidence, evaluate

logger = logging.getLogger(__name__)

MARGIN = 0.1
"""Share by which the new score must exceed the old transform's score on the new maps."""

NEARBY = (0.3, np.deg2rad(3.0))
"""m and rad: two transforms this close are one answer, known more or less well."""

SAME = (0.02, np.deg2rad(0.2))
"""m and rad: transforms this close are one, and the newer counts: it moves nothing that a map could
show, and a fleet comes to one result however often its maps were sent."""

MORE_EVIDENCE = 1.2
"""Factor by which the voxels that both maps hold must have grown for a nearby transform to count
as better: it rests on more, although its score may be no higher."""


def support(alignment: Alignment, a: Prepared, b: Prepared) -> float:
    """Return how many voxels both maps hold under an alignment that was just made of them."""
    return alignment.overlap * min(len(a.map.voxels), len(b.map.voxels))


def standing(
    alignment: Alignment, a: Prepared, b: Prepared, config: MergeConfig
) -> tuple[Alignment, str | None]:
    """Return an accepted alignment as it stands on two maps, and what they say against it, if so.

    It gets the score that its transform has on them and loses the matches of rooms that are gone.
    What may conflict where no rival comes near, such as furniture that was moved, may do so here:
    for rivals the maps were searched when it was accepted, and will be again. A prior must allow
    it.
    """
    if not alignment.accepted or alignment.T_a_b is None:
        return alignment, None
    prior = prior_between(parse_priors(config.priors), *alignment.agents)
    if prior is not None and not prior.allows(alignment.T_a_b):
        return alignment, f"it lies {prior.told(alignment.T_a_b)}"
    evidence = _evidence_of(alignment.T_a_b, a, b, config)
    kept = _kept(alignment, evidence.value, a, b)
    if config.check == "none":
        return kept, None
    T_level = level_frames(alignment.T_a_b, a.map.T_level_input, b.map.T_level_input)
    return kept, objection(
        evidence, np.inf, 0.0, config.verification, lambda: furniture_at(a, b)(T_level)
    )


def _evidence_of(T_a_b: Transform, a: Prepared, b: Prepared, config: MergeConfig) -> Evidence:
    T_level = level_frames(T_a_b, a.map.T_level_input, b.map.T_level_input)
    return evaluate(a.fields, b.fields, T_level, config.search.scoring)


def steadier(
    old: Alignment,
    old_support: float,
    new: Alignment,
    a: Prepared,
    b: Prepared,
    config: MergeConfig,
) -> tuple[Alignment, float]:
    """Return the alignment to use: the new one where it is better by a margin, else the old one.

    Parameters
    ----------
    old : the accepted alignment in use, made from earlier versions of the maps
    old_support : its :func:`support` when it was made
    new : what aligning the present maps gave
    a, b : the present maps
    config : MergeConfig

    Returns
    -------
    The new alignment, or the old one with the score that its transform has on the present maps, and
    its support when it was made.
    """
    if old.T_a_b is None:
        return new, support(new, a, b)
    name = f"{old.agents[0]} and {old.agents[1]}"
    kept, against = standing(old, a, b, config)
    if against is None and not new.accepted and config.check != "none":
        # The new maps do not say that no rival comes near, so nothing may conflict.
        evidence = _evidence_of(old.T_a_b, a, b, config)
        against = missed_gate(evidence, config.verification)
    if against is not None:
        logger.info(
            "%s: the alignment in use no longer holds (%s); now %s, score %.3f after %.3f",
            *(name, against, new.status, new.score, kept.score),
        )
        return new, support(new, a, b)
    if not new.accepted or new.T_a_b is None:
        logger.info(
            "%s: the alignment in use is kept (score %.3f); the new maps alone are %s: %s",
            *(name, kept.score, new.status, new.reason),
        )
        return kept, old_support
    if _within(SAME, old, new, b):
        return new, support(new, a, b)
    better = new.score > kept.score * (1 + MARGIN)
    firmer = support(new, a, b) > MORE_EVIDENCE * old_support
    if better or (firmer and _within(NEARBY, old, new, b)):
        logger.info(
            "%s: the alignment changes, score %.3f after %.3f, overlap %.2f after %.2f",
            *(name, new.score, kept.score, new.overlap, old.overlap),
        )
        return new, support(new, a, b)
    logger.info(
        "%s: the alignment in use is kept, score %.3f against %.3f",
        *(name, kept.score, new.score),
    )
    return kept, old_support


def _kept(old: Alignment, score: float, a: Prepared, b: Prepared) -> Alignment:
    """Return the old alignment as it stands on the present maps, without rooms they have lost."""
    rooms_a = {room.id for room in a.map.rooms}
    rooms_b = {room.id for room in b.map.rooms}
    matches = tuple(m for m in old.matches if m.room_a in rooms_a and m.room_b in rooms_b)
    return dataclasses.replace(old, score=score, matches=matches)


def _within(limits: tuple[float, float], old: Alignment, new: Alignment, b: Prepared) -> bool:
    """Whether two transforms differ by less than limits (m, rad), at the middle of map b."""
    if old.T_a_b is None or new.T_a_b is None or len(b.map.voxels) == 0:
        return False
    T_input_level = inverse(b.map.T_level_input)
    middle = T_input_level[:3, :3] @ b.map.centres().mean(axis=0) + T_input_level[:3, 3]
    distance = apart(old.T_a_b, new.T_a_b, middle[None])
    return distance < limits[0] and angle(inverse(old.T_a_b) @ new.T_a_b) < limits[1]
