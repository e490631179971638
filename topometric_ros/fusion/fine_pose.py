"""The fine pose of a candidate: the surfaces of both maps registered as the configuration says."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from topometric_ros.alignment import RoomMatch
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.consensus import consensus
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.fusion.registration import Registration, register
from topometric_ros.matching.candidate import Candidate


def fine_pose(a: Prepared, b: Prepared, candidate: Candidate, config: MergeConfig) -> Registration:
    """Register the surfaces of both maps, or of each matched room first.

    Parameters
    ----------
    a, b : maps of one resolution
    candidate : pose, level frame of b to level frame of a, with the rooms matched if any
    config : `registration`, `refinement` and `consensus` are used

    Raises
    ------
    RegistrationError
        Too little of the surfaces lies together.
    """
    T = candidate.T_a_b
    if config.refinement == "consensus" and candidate.matches:
        agreed = consensus(
            a.map, b.map, a.surface, b.surface, T, candidate.matches, config.consensus
        )
        # The last word on error and covariance is the whole surface's, without moving the pose.
        still = replace(config.registration, steps=1, gates=config.registration.gates[:1])
        measured = register(b.surface, a.surface, agreed.T_a_b, still, a.tree)
        return replace(measured, T_target_source=agreed.T_a_b)
    return register(b.surface, a.surface, T, config.registration, a.tree)


def fine_poses(
    a: Prepared, b: Prepared, config: MergeConfig
) -> Callable[[Candidate], Registration]:
    """Return :func:`fine_pose` of two maps, which registers each pose once.

    Judging and accepting ask for the same ones, and for poses that were registered already.
    """
    made: dict[tuple[bytes, tuple[RoomMatch, ...]], Registration] = {}

    def of(candidate: Candidate) -> Registration:
        key = (candidate.T_a_b.tobytes(), candidate.matches)
        if key not in made:
            found = fine_pose(a, b, candidate, config)
            made[key] = made[found.T_target_source.tobytes(), candidate.matches] = found
        return made[key]

    return of
