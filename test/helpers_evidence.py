"""The evidence of a pose that nothing speaks against, to be made worse one number at a time."""

from __future__ import annotations

from test.helpers import yaw_transform
from topometric_ros.matching.candidate import Candidate
from topometric_ros.matching.evidence import Evidence

GOOD = Evidence(
    score=900.0,
    value=900.0,
    wall_agree=800,
    wall_conflict_cells=0,
    wall_conflict=0.0,
    free_floor=40.0,
    free_share=0.4,
    agreed_wall=60.0,
    smallest_eigenvalue=20.0,
    fixed=1.0,
    furniture_judged=0,
    furniture_conflict_cells=0,
    furniture_conflict=0.0,
    wall_in_view=1200,
    wall_absent=0.012,
    storeys=1,
    centre=(0.0, 0.0, 0.0),
)


def good(**changes):
    return Evidence(**{**GOOD.__dict__, **changes})


def at(x, evidence=GOOD, yaw=0.0):
    return Candidate(yaw_transform(yaw, (x, 0.0, 0.0)), "search", evidence.score), evidence
