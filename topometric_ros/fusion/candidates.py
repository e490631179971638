"""Candidate poses of two maps, from matched rooms (thesis §4.3) and from the global search."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np

from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.poses import Transform, apart
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.fusion.registration import RegistrationConfig, RegistrationError, register
from topometric_ros.matching.candidate import Candidate
from topometric_ros.matching.evidence import evaluate, refine
from topometric_ros.matching.propose import propose_from_rooms
from topometric_ros.matching.search import search_poses
from topometric_ros.stopwatch import Stopwatch

logger = logging.getLogger(__name__)

ROUGH = RegistrationConfig(gates=(1.2, 0.6, 0.3), points=800, steps=6)
"""Brings a pose read from rooms' centroids, a metre off at times, to where refining can start."""

SAME_POSE = 0.2
"""Mean displacement of b's rooms, m, below which two roughly registered poses are one."""


def find_candidates(
    a: Prepared, b: Prepared, config: MergeConfig, watch: Stopwatch
) -> list[Candidate]:
    """Return the candidates of all sources; those of rooms are refined where they get judged.

    Parameters
    ----------
    a, b : maps of one resolution
    config : MergeConfig
    watch : gathers the CPU seconds of the stages

    Returns
    -------
    Candidate, level frame of b to level frame of a
    """
    candidates: list[Candidate] = []
    if "rooms" in config.sources:
        with watch.stage("matching"):
            proposed = propose_from_rooms(a.described, b.described, config.matching)
        if config.check == "rivals":
            with watch.stage("refinement"):
                proposed = _refined(a, b, proposed, config)
        candidates += proposed
    if "search" in config.sources:
        with watch.stage("search"):
            candidates += search_poses(a.fields, b.fields, config.search)
    return candidates


def _refined(
    a: Prepared, b: Prepared, candidates: list[Candidate], config: MergeConfig
) -> list[Candidate]:
    """Return the most promising candidates from rooms where they fit best nearby.

    All are registered roughly. Many then end at one pose, of which the first, with most matches,
    goes on; and of the distinct ones those that score best, because refining costs most.
    """
    centroids = np.array([room.centroid for room in b.map.rooms])
    ended: list[Candidate] = []
    for candidate in candidates:
        T = _rough(a, b, candidate)
        if all(apart(T, other.T_a_b, centroids) >= SAME_POSE for other in ended):
            ended.append(replace(candidate, T_a_b=T))
    scores = [evaluate(a.fields, b.fields, c.T_a_b, config.search.scoring).score for c in ended]
    best = np.argsort(-np.array(scores), kind="stable")[: config.refined_rooms]
    return [
        replace(ended[k], T_a_b=refine(a.fields, b.fields, ended[k].T_a_b, config.search.scoring))
        for k in sorted(best.tolist())
    ]


def _rough(a: Prepared, b: Prepared, candidate: Candidate) -> Transform:
    """Register the matched rooms of b on all of a, which brings the pose to about a voxel."""
    rooms = [match.room_b for match in candidate.matches]
    part = b.surface.take(np.isin(b.map.room, rooms))
    try:
        return register(part, a.surface, candidate.T_a_b, ROUGH, a.tree).T_target_source
    except RegistrationError as error:
        logger.debug("a candidate from rooms was not registered: %s", error)
        return candidate.T_a_b
