"""The global search finds where one map lies in another, and the evidence says how sure that is."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from test.helpers import moved, yaw_transform
from test.helpers_search import FLAT, building, map_of
from topometric_ros.matching.evidence import evaluate, refine
from topometric_ros.matching.likeness import likeness
from topometric_ros.matching.main_direction import main_direction
from topometric_ros.matching.search import SearchConfig, search_poses
from topometric_ros.matching.search_fields import (
    MapFields,
    SearchError,
    candidate_heights,
    prepare,
    storey_pairs,
)
from topometric_ros.matching.search_poses import compare, pose_of
from topometric_ros.matching.search_sweep import sweep

CONFIG = SearchConfig()
SCORING = CONFIG.scoring


@pytest.fixture(scope="module")
def flat():
    return building(FLAT)


@pytest.fixture(scope="module")
def map_a(flat):
    """What one agent saw: all but the last room."""
    return map_of(flat[flat[:, 1] < 4.05])


def seen_by_b(flat, yaw):
    """What another agent saw, in its own frame, and the true T_a_b."""
    T_b_a = yaw_transform(yaw, (3.0, -7.5, 0.6))
    return map_of(flat[flat[:, 0] > 3.0], T=T_b_a), np.linalg.inv(T_b_a)


def assert_same_pose(T, truth, points, metres, degrees):
    shift = np.linalg.norm(moved(points, T) - moved(points, truth), axis=1).mean()
    turn = np.degrees(abs(pose_of(np.linalg.inv(truth) @ T).yaw))
    assert shift < metres, f"{shift:.3f} m off"
    assert turn < degrees, f"{turn:.2f}° off"


@pytest.mark.parametrize("degrees", [0.0, 37.0, 91.3, 180.0, -114.7])
def test_a_map_is_found_in_another_at_any_yaw(flat, map_a, degrees):
    map_b, truth = seen_by_b(flat, np.radians(degrees))
    best = search_poses(map_a, map_b, CONFIG)[0]
    common = moved(flat[flat[:, 0] > 3.0], np.linalg.inv(truth))
    assert_same_pose(best.T_a_b, truth, common, 0.1, 0.5)


def test_the_yaws_that_are_swept_bring_main_direction_onto_main_direction(flat):
    # Long enough that half a step of yaw carries its ends a metre off.
    row = np.concatenate([flat + (14.2 * k, 0.0, 0.0) for k in range(4)])
    T_b_a = yaw_transform(np.radians(1.5), (3.0, -7.5, 0.0))
    fields_a, fields_b = (prepare(map_of(row, T=T), SCORING) for T in (None, T_b_a))
    turn = np.degrees(main_direction(fields_b) - main_direction(fields_a)) % 90.0
    assert turn == pytest.approx(1.5, abs=0.1)
    best = sweep(fields_a, fields_b, CONFIG.sweep)[0]
    assert np.degrees(abs(pose_of(T_b_a @ best.matrix()).yaw)) < 0.1


def test_samples_of_cells_stay_within_them(flat):
    fields = prepare(map_of(flat), SCORING)
    # 140,032 steps of 140,032 / 3000 end past the last cell.
    cells = np.zeros((140_032, 2))
    large = dataclasses.replace(fields.storeys[0], free=cells)
    taken = compare(fields, MapFields((large,)), 0.0, 3000).free[0]
    assert len(taken) == 3000


def test_a_map_without_walls_has_a_main_direction_too():
    assert main_direction(MapFields(())) == 0.0


def test_the_right_storey_is_found(flat):
    upper = building(FLAT[:2] + FLAT[4:]) * (-1.0, 1.0, 1.0) + (8.5, 0.0, 2.9)
    house = np.concatenate([flat, upper])
    T_b_a = yaw_transform(0.4, (1.0, 2.0, -1.2))
    map_b = map_of(upper, floors=(2.9,), T=T_b_a)
    best = search_poses(map_of(house, floors=(0.0, 2.9)), map_b, CONFIG)[0]
    assert_same_pose(best.T_a_b, np.linalg.inv(T_b_a), moved(upper, T_b_a), 0.1, 0.5)


def test_the_same_maps_give_the_same_candidates(flat, map_a):
    map_b, _ = seen_by_b(flat, 0.3)
    first, second = (search_poses(map_a, map_b, CONFIG) for _ in range(2))
    assert [c.score for c in first] == [c.score for c in second]
    assert all(np.array_equal(x.T_a_b, y.T_a_b) for x, y in zip(first, second, strict=True))


def test_candidates_are_distinct_and_ordered(flat, map_a):
    map_b, _ = seen_by_b(flat, 2.0)
    candidates = search_poses(map_a, map_b, CONFIG)
    assert 2 <= len(candidates) <= CONFIG.refine.keep
    assert all(c.source == "search" for c in candidates)
    scores = [c.score for c in candidates]
    assert scores == sorted(scores, reverse=True)


def test_maps_without_storeys_have_no_candidates(flat, map_a):
    empty = dataclasses.replace(map_a, storeys=())
    assert search_poses(map_a, empty, CONFIG) == []
    assert search_poses(empty, map_a, CONFIG) == []


def test_a_pose_and_its_inverse_have_the_same_evidence(flat, map_a):
    map_b, truth = seen_by_b(flat, 0.7)
    for wrong in (np.eye(4), yaw_transform(0.02, (0.15, -0.1, 0.0)), yaw_transform(3.1)):
        T = truth @ wrong
        there = evaluate(map_a, map_b, T, SCORING)
        back = evaluate(map_b, map_a, np.linalg.inv(T), SCORING)
        for name in ("score", "value", "free_floor", "agreed_wall", "smallest_eigenvalue"):
            assert getattr(there, name) == pytest.approx(getattr(back, name), rel=0.01, abs=1.0)
        assert there.wall_conflict == pytest.approx(back.wall_conflict, abs=0.005)


def test_the_right_pose_has_no_conflict_and_a_shifted_one_has(flat, map_a):
    map_b, truth = seen_by_b(flat, -1.1)
    right = evaluate(map_a, map_b, truth, SCORING)
    assert right.wall_conflict < 0.005
    assert right.free_floor > 15.0
    shifted = evaluate(map_a, map_b, yaw_transform(0.0, (1.0, 0.7, 0.0)) @ truth, SCORING)
    assert shifted.wall_conflict > 0.1
    assert shifted.value == 0.0


def test_a_wall_seen_from_the_other_side_does_not_agree():
    wall = building([((0.0, 0.0, 0.0), (6.0, 4.0, 2.6), ())])
    behind = building([((6.0, 0.0, 0.0), (6.0, 4.0, 2.6), ())])
    evidence = evaluate(map_of(wall), map_of(behind), np.eye(4), SCORING)
    assert evidence.wall_agree > 30, "the wall between them stands in both"
    assert evidence.agreed_wall < 1.5, "but each saw its own side"
    assert evidence.wall_conflict == 0.0, "and low conflict alone means nothing"


def test_refining_leads_a_rough_pose_to_the_right_one(flat, map_a):
    map_b, truth = seen_by_b(flat, 0.9)
    rough = yaw_transform(np.radians(2.0), (0.2, -0.15, 0.0)) @ truth
    common = moved(flat[flat[:, 0] > 3.0], np.linalg.inv(truth))
    assert_same_pose(refine(map_a, map_b, rough, SCORING), truth, common, 0.1, 0.5)


def test_floors_that_differ_by_the_same_height_are_one_candidate():
    rooms = building(FLAT[:2])
    house = np.concatenate([rooms, rooms + (0.0, 0.0, 3.0)])
    a = prepare(map_of(house, floors=(0.0, 3.0)), SCORING)
    b = prepare(map_of(house, floors=(0.0, 3.04)), SCORING)
    assert candidate_heights(a, b) == pytest.approx([-3.04, -0.02, 3.0], abs=0.011)
    assert storey_pairs(a, b, 0.0) == [(0, 0), (1, 1)]
    assert storey_pairs(a, b, 3.0) == [(1, 0)]
    assert evaluate(a, b, yaw_transform(0.0, (0.0, 0.0, 1.5)), SCORING).storeys == 0


def test_rasters_of_another_cell_size_are_refused(map_a):
    storey = map_a.storeys[0]
    coarse = dataclasses.replace(storey.layers, cell=0.2)
    odd = dataclasses.replace(map_a, storeys=(dataclasses.replace(storey, layers=coarse),))
    with pytest.raises(SearchError, match=r"cells of 0\.2 m"):
        prepare(odd, SCORING)


def test_a_room_of_which_there_are_more_is_like_another_part_of_the_map_and_a_flat_is_not(flat):
    rooms = [((4.1 * k, 0.0, 0.0), (4.0, 5.0, 2.6), (("x+", 1.0),)) for k in range(3)]
    row = prepare(map_of(building(rooms)), CONFIG.scoring)
    alone = prepare(map_of(flat), CONFIG.scoring)
    one = prepare(map_of(building(rooms[:1])), CONFIG.scoring)
    assert likeness(row, one, np.eye(4), CONFIG.scoring) > 0.8
    assert likeness(alone, alone, np.eye(4), CONFIG.scoring) < 0.4


def partition(start, end):
    """Return the points of a thin wall between two points of the plan."""
    along, z = np.meshgrid(np.linspace(0.0, 1.0, 100), np.arange(0.0, 2.6, 0.05))
    line = np.asarray(start) + along.ravel()[:, None] * np.subtract(end, start)
    return np.column_stack([line, z.ravel()])


@pytest.mark.parametrize("partitions", [1, 3])
def test_a_place_whose_walls_conflict_is_no_copy_however_much_of_it_fits(flat, partitions):
    walls = [((2.5, 0.0), (2.5, 3.0)), ((6.0, 3.8), (10.0, 3.8)), ((12.7, 2.0), (12.7, 6.0))]
    parted = np.concatenate([flat, *(partition(*ends) for ends in walls[:partitions])])
    both = np.concatenate([flat, parted + (np.ptp(flat[:, 0]) + 0.3, 0.0, 0.0)])
    maps = [prepare(map_of(points), SCORING) for points in (both, flat)]
    assert likeness(*maps, np.eye(4), SCORING) > 0.4
    assert (likeness(*maps, np.eye(4), SCORING, copies=True) > 0.4) == (partitions == 1)


@pytest.mark.parametrize(("length", "disproves"), [(0.9, False), (2.4, True)])
def test_a_door_s_leaf_in_the_way_disproves_nothing(flat, map_a, length, disproves):
    along = np.arange(0.0, length, 0.03)
    x, z = np.meshgrid(6.5 + along, np.arange(0.0, 2.0, 0.03))
    leaf = np.column_stack([x.ravel(), np.full(x.size, 3.8), z.ravel()])
    floor = flat[~((np.abs(flat[:, 1] - 3.8) < 0.1) & (flat[:, 2] < 0.05))]
    with_leaf = map_of(np.concatenate([floor, leaf]))
    evidence = evaluate(map_a, with_leaf, np.eye(4), SCORING)
    assert (evidence.wall_conflict_cells > 0) == disproves


def test_a_corridor_slides_and_a_flat_does_not(map_a):
    still = evaluate(map_a, map_a, np.eye(4), SCORING)
    assert still.fixed == 1.0
    pipe = map_of(building([((0.0, 0.0, 0.0), (12.0, 1.8, 2.6), ())]))
    slid = evaluate(pipe, pipe, yaw_transform(0.0, (3.0, 0.0, 0.0)), SCORING)
    assert slid.fixed < 0.5
