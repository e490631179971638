"""Candidate poses of two maps, from matched rooms (thesis §4.3) and from the global search."""

from __future__ import annotations

from dataclasses import replace

from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.matching.candidate import Candidate
from topometric_ros.matching.propose import propose_from_rooms
from topometric_ros.matching.search import search_poses
from topometric_ros.matching.search_poses import pose_of
from topometric_ros.matching.search_refine import fit_nearby
from topometric_ros.stopwatch import Stopwatch


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
    proposed: list[Candidate] = []
    found: list[Candidate] = []
    if "rooms" in config.sources:
        with watch.stage("matching"):
            proposed = propose_from_rooms(a.described, b.described, config.matching)
    if "search" in config.sources:
        with watch.stage("search"):
            found = search_poses(a.fields, b.fields, config.search)
    if config.check == "rivals":
        with watch.stage("refinement"):
            proposed = _fitted(a, b, proposed, found, config)
    return proposed + found


def _fitted(
    a: Prepared,
    b: Prepared,
    proposed: list[Candidate],
    found: list[Candidate],
    config: MergeConfig,
) -> list[Candidate]:
    """Return the most promising candidates from rooms where they fit best nearby."""
    poses = fit_nearby(
        a.fields,
        b.fields,
        [pose_of(candidate.T_a_b) for candidate in proposed],
        [pose_of(candidate.T_a_b) for candidate in found],
        config.search.scoring,
        replace(config.search.refine, keep=config.refined_rooms),
    )
    return [
        replace(candidate, T_a_b=pose.matrix())
        for candidate, pose in zip(proposed, poses, strict=True)
        if pose is not None
    ]
