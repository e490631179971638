"""A pose is believed only where much was seen in common, little conflicts and no rival is near."""

from __future__ import annotations

import re

import numpy as np
import pytest

from test.helpers import yaw_transform
from test.helpers_evidence import GOOD, at, good
from test.helpers_search import FLAT, OTHER, TWIN, building, map_of
from topometric_ros.alignment import AlignmentStatus
from topometric_ros.fusion.gates import VerificationConfig, missed_gate, objection
from topometric_ros.fusion.verification import confidence, decide, doubt_repeated
from topometric_ros.matching.candidate import Candidate
from topometric_ros.matching.evidence import evaluate
from topometric_ros.matching.search import SearchConfig, search_poses

SEARCH = SearchConfig()
CONFIG = VerificationConfig()


def judged(map_a, map_b):
    candidates = search_poses(map_a, map_b, SEARCH)
    return [(c, evaluate(map_a, map_b, c.T_a_b, SEARCH.scoring)) for c in candidates]


def test_two_maps_of_one_building_are_accepted():
    flat = building(FLAT)
    map_a = map_of(flat[flat[:, 0] < 11.3])
    map_b = map_of(flat[flat[:, 1] < 5.5], T=yaw_transform(1.0, (2.0, 1.0, 0.3)))
    decision = decide(judged(map_a, map_b), CONFIG)
    assert decision.status is AlignmentStatus.ACCEPTED, decision.reason
    assert decision.confidence > 0.5
    assert decision.best is not None
    assert "m of wall" in decision.reason


def test_a_map_that_half_a_turn_carries_onto_itself_is_ambiguous():
    twin = building(TWIN)
    decision = decide(judged(map_of(twin), map_of(twin, T=yaw_transform(0.5))), CONFIG)
    assert decision.status is AlignmentStatus.AMBIGUOUS, decision.reason
    assert decision.confidence < 0.5
    assert decision.ratio > 0.8
    assert "180° away" in decision.reason
    assert len(decision.alternatives) >= 2


def test_two_buildings_are_not_merged():
    decision = decide(judged(map_of(building(FLAT)), map_of(building(OTHER))), CONFIG)
    assert decision.status is not AlignmentStatus.ACCEPTED
    assert decision.confidence < 0.5


def test_maps_laid_back_to_back_are_rejected_with_a_reason():
    a = map_of(building(FLAT))
    b = map_of(building([((0.0, -4.0, 0.0), (9.0, 4.0, 2.6), ())]))
    evidence = evaluate(a, b, np.eye(4), SEARCH.scoring)
    decision = decide([(Candidate(np.eye(4), "search", 1.0), evidence)], CONFIG)
    assert evidence.wall_conflict == 0.0
    assert decision.status is AlignmentStatus.REJECTED
    assert "too little in common" in decision.reason
    assert "at least 6 m² are needed" in decision.reason


def test_without_candidates_there_is_no_alignment():
    decision = decide([], CONFIG)
    assert decision.status is AlignmentStatus.NONE
    assert decision.best is None
    assert "no pose" in decision.reason


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"storeys": 0}, "no floor of one map"),
        ({"free_floor": 5.9}, r"5.9 m² of the same free floor, at least 6 m²"),
        ({"agreed_wall": 4.0}, r"4.0 m of wall from the same side, at least 5 m"),
        (
            {"smallest_eigenvalue": 1.2, "fixed": 0.25},
            r"all run one way.* 1.2 m of wall run across",
        ),
        (
            {"wall_conflict": 0.042, "wall_conflict_cells": 34},
            r"seen-free floor of the other: 4.2% of 810 wall cells conflict, at most 1.5% allowed",
        ),
        (
            {"furniture_judged": 40, "furniture_conflict": 0.5},
            r"bare floor: 50% of 40 furniture cells conflict, at most 15% allowed",
        ),
    ],
)
def test_each_gate_refuses_and_says_why(changes, words):
    decision = decide([at(0.0, good(**changes))], CONFIG)
    assert decision.status is AlignmentStatus.REJECTED
    assert decision.confidence == 0.0
    assert re.search(words, decision.reason), decision.reason


def test_few_furniture_cells_do_not_count():
    assert missed_gate(good(furniture_judged=14, furniture_conflict=1.0), CONFIG) is None


def test_a_copy_of_the_best_pose_is_no_rival():
    near = at(0.3, good(value=880.0), yaw=np.radians(3.0))
    decision = decide([at(0.0), near], CONFIG)
    assert decision.status is AlignmentStatus.ACCEPTED
    assert decision.ratio == 0.0
    far = at(3.0, good(value=880.0))
    assert decide([at(0.0), far], CONFIG).status is AlignmentStatus.AMBIGUOUS


def test_the_order_of_candidates_does_not_matter():
    rows = [at(3.0, good(value=100.0)), at(0.0), at(9.0, good(value=200.0))]
    decision = decide(rows, CONFIG)
    assert decision.best == 1
    assert [x.score for x in decision.alternatives] == [900.0, 200.0, 100.0]
    assert decide(rows[::-1], CONFIG).reason == decision.reason


def test_a_near_rival_needs_a_wide_lead():
    rival = at(5.0, good(value=1200.0))
    assert decide([at(0.0, good(value=1650.0)), rival], CONFIG).status == "ambiguous"
    assert decide([at(0.0, good(value=1750.0)), rival], CONFIG).status == "accepted"


def test_a_small_lead_is_not_enough():
    decision = decide([at(0.0, good(value=80.0))], CONFIG)
    assert decision.status is AlignmentStatus.AMBIGUOUS
    assert "leads by only 80, at least 90" in decision.reason


def test_confidence_rises_with_the_gap_and_falls_with_the_ratio():
    gaps = [confidence(gap, 0.2, CONFIG) for gap in (0.0, 50.0, 150.0, 400.0, 5000.0)]
    ratios = [confidence(1000.0, ratio, CONFIG) for ratio in (0.0, 0.1, 0.3, 0.7, 0.76, 1.0)]
    assert gaps == sorted(gaps)
    assert ratios == sorted(ratios, reverse=True)
    assert all(0.0 <= value < 1.0 for value in gaps + ratios)
    assert confidence(90.0, 0.3, CONFIG) == pytest.approx(2 / 3)
    assert confidence(500.0, 0.75, CONFIG) == pytest.approx(2 / 3)
    assert confidence(89.0, 0.0, CONFIG) < 0.5


def test_a_shut_door_is_forgiven_where_the_furniture_vouches_for_the_place():
    door = {"wall_conflict": 0.03, "wall_conflict_cells": 25}
    assert decide([at(0.0, good(**door))], CONFIG).status is AlignmentStatus.REJECTED
    vouched = good(**door, furniture_judged=150, furniture_conflict=0.02)
    assert decide([at(0.0, vouched)], CONFIG).status is AlignmentStatus.ACCEPTED
    rival = at(8.0, good(value=300.0))
    assert decide([at(0.0, vouched), rival], CONFIG).status is AlignmentStatus.REJECTED


def test_moved_furniture_is_forgiven_where_the_walls_of_several_rooms_vouch():
    moved = {"furniture_judged": 150, "furniture_conflict": 0.25, "free_share": 0.3}
    assert decide([at(0.0, good(**moved))], CONFIG).status is AlignmentStatus.ACCEPTED
    one_room = good(**moved, free_floor=12.0)
    assert decide([at(0.0, one_room)], CONFIG).status is AlignmentStatus.REJECTED
    rival = at(8.0, good(value=300.0))
    assert decide([at(0.0, good(**moved)), rival], CONFIG).status is AlignmentStatus.REJECTED


def test_a_small_part_that_repeats_in_the_maps_is_ambiguous():
    decision = decide([at(0.0)], CONFIG)
    assert doubt_repeated(decision, GOOD, 0.2, CONFIG) == decision
    doubted = doubt_repeated(decision, GOOD, 0.7, CONFIG)
    assert doubted.status is AlignmentStatus.AMBIGUOUS
    assert doubted.confidence < 0.5
    assert "which fits 70% as well" in doubted.reason


def test_few_cells_in_conflict_do_not_disprove_a_pose():
    few = good(wall_conflict=7 / 382, wall_conflict_cells=7, free_floor=12.0)
    many = good(wall_conflict=0.03, wall_conflict_cells=60, free_floor=12.0)
    assert missed_gate(few, CONFIG) is None
    assert missed_gate(many, CONFIG) is not None


def test_a_corridor_does_not_fix_its_own_length():
    corridor = good(agreed_wall=30.0, smallest_eigenvalue=2.0, fixed=0.2)
    assert "at least 2.5 m are needed" in str(missed_gate(corridor, CONFIG))
    assert missed_gate(good(agreed_wall=8.0, smallest_eigenvalue=1.6), CONFIG) is None


def test_ends_of_walls_and_doors_fix_a_corridor_that_cannot_slide():
    held = good(agreed_wall=30.0, smallest_eigenvalue=1.2, fixed=0.7)
    assert missed_gate(held, CONFIG) is None
    assert missed_gate(good(agreed_wall=30.0, smallest_eigenvalue=0.8, fixed=0.9), CONFIG)
    never = VerificationConfig(slide_cost=2.0)
    assert "sliding along costs 70% of the score" in str(missed_gate(held, never))


@pytest.mark.parametrize(
    ("value", "share", "status"),
    [
        (300.0, 0.33, AlignmentStatus.ACCEPTED),
        (300.0, 0.60, AlignmentStatus.AMBIGUOUS),
        (120.0, 0.33, AlignmentStatus.AMBIGUOUS),
        (900.0, 0.40, AlignmentStatus.ACCEPTED),
    ],
)
def test_the_nearer_a_rival_the_larger_the_lead_that_is_asked_for(value, share, status):
    best = good(value=value, score=value)
    rival = good(value=share * value, score=share * value)
    decision = decide([at(0.0, best), at(20.0, rival)], CONFIG)
    assert decision.status is status, decision.reason


def test_changed_furniture_is_forgiven_only_on_demand_and_without_a_rival():
    walls = {"wall_conflict": 0.03, "wall_conflict_cells": 25}
    other_day = good(**walls, furniture_judged=150, furniture_conflict=0.25)
    lenient = VerificationConfig(changed_furniture=True)
    assert objection(other_day, 900.0, 0.0, CONFIG) is not None
    assert objection(other_day, 900.0, 0.0, lenient) is None
    assert objection(other_day, 900.0, 0.2, lenient) is not None
    assert (
        objection(good(wall_conflict=0.07, wall_conflict_cells=60), 900.0, 0.0, lenient) is not None
    )


def test_a_look_alike_that_lacks_walls_does_not_block_a_clean_pose():
    lacking = good(value=700.0, score=700.0, wall_absent=0.05)
    decision = decide([at(0.0), at(30.0, lacking, yaw=np.pi)], CONFIG)
    assert decision.status is AlignmentStatus.ACCEPTED
    assert "lacks 5.0% of the walls in view" in decision.reason
    assert decision.confidence < 0.7


@pytest.mark.parametrize(
    ("best", "rival"),
    [
        ({}, {"wall_absent": 0.029}),
        ({"wall_absent": 0.03}, {"wall_absent": 0.09}),
        ({"wall_in_view": 200}, {"wall_absent": 0.05}),
        ({"wall_conflict": 0.008}, {"wall_absent": 0.05}),
        ({"value": 780.0, "score": 780.0}, {"wall_absent": 0.05}),
    ],
)
def test_a_look_alike_still_blocks_a_pose_that_is_not_clean_or_not_ahead(best, rival):
    rival = {"value": 700.0, "score": 700.0} | rival
    decision = decide([at(0.0, good(**best)), at(30.0, good(**rival), yaw=np.pi)], CONFIG)
    assert decision.status is AlignmentStatus.AMBIGUOUS


def test_one_look_alike_with_all_its_walls_is_enough_to_block():
    lacking = good(value=700.0, score=700.0, wall_absent=0.05)
    twin = good(value=690.0, score=690.0)
    decision = decide([at(0.0), at(30.0, lacking), at(60.0, twin)], CONFIG)
    assert decision.status is AlignmentStatus.AMBIGUOUS
