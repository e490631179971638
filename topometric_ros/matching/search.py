"""Global search: where map b may lie in map a, from their storeys' rasters alone.

A sweep over all yaws, shifts and storeys finds rough poses; a shrinking grid refines them. What
comes out are *candidates*: whether one may be believed is for `evidence` and `verification`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from topometric_ros.matching.candidate import Candidate
from topometric_ros.matching.search_fields import MapFields, ScoringConfig, prepare
from topometric_ros.matching.search_refine import RefineConfig, refine_poses
from topometric_ros.matching.search_sweep import SweepConfig, sweep
from topometric_ros.topometric_map import TopometricMap


@dataclass(frozen=True)
class SearchConfig:
    """The global search: a coarse sweep, its refinement and the score that both follow."""

    sweep: SweepConfig = field(default_factory=SweepConfig)
    refine: RefineConfig = field(default_factory=RefineConfig)
    scoring: ScoringConfig = field(default_factory=ScoringConfig)


def search_poses(
    a: TopometricMap | MapFields, b: TopometricMap | MapFields, config: SearchConfig
) -> list[Candidate]:
    """Return the best distinct poses of b in a, best first; empty where no storey has content.

    Parameters
    ----------
    a, b : maps, or what :func:`search_fields.prepare` made of them
    config : SearchConfig

    Returns
    -------
    Candidates with `source` "search" and the score S of `search_poses.score_around`, between the
    level frames; their heights are differences of floors.
    """
    fields_a, fields_b = (prepare(m, config.scoring) for m in (a, b))
    rough = sweep(fields_a, fields_b, config.sweep)
    poses = refine_poses(fields_a, fields_b, rough, config.scoring, config.refine)
    return [Candidate(pose.matrix(), "search", pose.score) for pose in poses]
