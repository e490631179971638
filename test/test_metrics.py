"""Metrics on cases small enough to count by hand, and the laws that hold for all."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from test.helpers import yaw_transform
from topometric_ros.evaluation.metrics_fusion import (
    brier_score,
    reliability,
    transform_error,
    upper_bound,
)
from topometric_ros.evaluation.metrics_matching import (
    MatchCounts,
    match_counts,
    right_by_counterpart,
    right_by_overlap,
)
from topometric_ros.evaluation.metrics_rooms import (
    SMALLEST_TRUE_ROOM,
    counterparts,
    edge_counts,
    room_overlap,
    room_scores,
)

MANY = SMALLEST_TRUE_ROOM


def voxels(*parts: tuple[int, int, int]):
    """Return true and found rooms of voxels from (how many, true, found)."""
    true = np.concatenate([np.full(n * MANY, t) for n, t, _ in parts])
    found = np.concatenate([np.full(n * MANY, f) for n, _, f in parts])
    return true, found


def test_perfect_rooms_score_one_in_every_form():
    overlap = room_overlap(*voxels((3, 0, 5), (2, 1, 6)))
    scores = room_scores(overlap, [0, 1], {0: 3 * MANY, 1: 2 * MANY})
    assert (scores.miou_paper, scores.miou_whole, scores.miou_walked) == (1, 1, 1)
    assert (scores.precision, scores.recall, scores.left_over) == (1, 1, 0)


def test_a_split_room_costs_the_paper_s_form_once_and_its_leftovers_are_counted():
    # Room 0 in pieces of 3, 2 and 1; room 1 whole, with one part in five unlabelled.
    overlap = room_overlap(*voxels((3, 0, 0), (2, 0, 1), (1, 0, 2), (4, 1, 3), (1, -1, 3)))
    scores = room_scores(overlap, [0, 1])
    assert scores.miou_paper == pytest.approx((3 / 6 + 4 / 5) / 2)
    assert scores.left_over == 2
    # As score.py counts, voxels without a true room are left out.
    assert scores.miou_walked == pytest.approx((3 / 6 + 4 / 4) / 2)
    assert scores.precision == pytest.approx((1 + 1 + 1 + 4 / 5) / 4)
    assert scores.recall == pytest.approx((3 / 6 + 1) / 2)
    assert np.isnan(scores.miou_whole)


def test_a_room_walked_through_and_not_found_counts_in_the_walked_form_alone():
    overlap = room_overlap(*voxels((2, 0, 0), (2, 1, -1)))
    scores = room_scores(overlap, [0, 1])
    assert (scores.miou_paper, scores.miou_walked) == (1.0, 0.5)


def test_the_whole_form_counts_what_the_agent_did_not_see():
    overlap = room_overlap(*voxels((2, 0, 0)))
    assert room_scores(overlap, [0], {0: 8 * MANY}).miou_whole == pytest.approx(2 / 8)


def test_a_map_without_rooms_has_no_precision_and_no_recall():
    scores = room_scores(room_overlap(*voxels((2, 0, -1))), [0])
    assert np.isnan(scores.precision)
    assert (scores.recall, scores.miou_walked, scores.found) == (0.0, 0.0, 0)


@given(st.lists(st.tuples(st.integers(-1, 3), st.integers(-1, 3)), min_size=1, max_size=60))
def test_scores_lie_between_zero_and_one_and_names_do_not_matter(pairs):
    true, found = (np.array(column) for column in zip(*pairs, strict=True))
    true, found = np.repeat(true, MANY), np.repeat(found, MANY)
    one = room_scores(room_overlap(true, found), [0, 1, 2, 3])
    renamed = np.where(found >= 0, 17 - found, -1)
    other = room_scores(room_overlap(true, renamed), [0, 1, 2, 3])
    for name in ("miou_paper", "miou_walked", "precision", "recall"):
        value = getattr(one, name)
        assert np.isnan(value) or 0 <= value <= 1
        assert getattr(other, name) == pytest.approx(value, nan_ok=True)
    assert one.left_over == other.left_over


def test_edges_are_compared_through_the_true_rooms():
    # Found rooms 0 and 1 are pieces of true room 0; 2 is room 1, 3 is room 2.
    overlap = room_overlap(*voxels((3, 0, 0), (2, 0, 1), (3, 1, 2), (3, 2, 3)))
    links = [(0, 1), (1, 2), (2, 9)]
    counts = edge_counts(overlap, [(0, 1), (0, 2), (2, 1), (0, 3)], links)
    # Right: 0-2 and 1-2, both the link 0-1. Wrong: inside room 0, and 0-3. Room 9 is not held.
    assert (counts.found, counts.right, counts.true, counts.covered) == (4, 2, 2, 1)


def test_matches_are_right_through_the_counterparts_of_both_rooms():
    a = room_overlap(*voxels((3, 0, 0), (2, 0, 1), (3, 1, 2)))
    b = room_overlap(*voxels((4, 0, 7), (3, 1, 8), (3, 2, 9)))
    assert counterparts(a) == {0: 0, 2: 1}
    assert right_by_counterpart(a, b) == {(0, 7), (2, 8)}
    # The smaller piece lies in true room 0 too.
    assert right_by_overlap(a, b) == {(0, 7), (1, 7), (2, 8)}
    counts = match_counts([(0, 7), (1, 8)], right_by_counterpart(a, b), 3, 3)
    assert (counts.precision, counts.recall, counts.f1) == (0.5, 0.5, 0.5)
    # Wrong of nine pairs: the match 1-8 made and the match 2-8 missed.
    assert counts.accuracy == pytest.approx(7 / 9)


def test_nothing_matched_has_no_precision_and_counts_add_up():
    nothing = MatchCounts(possible=2, pairs=4)
    assert np.isnan(nothing.precision)
    assert nothing.recall == 0
    assert nothing + MatchCounts(1, 1, 1, 4) == MatchCounts(1, 1, 3, 8)


def test_displacement_is_of_the_points_not_of_the_frame_s_origin():
    points = np.array([[100.0, 0, 0], [101.0, 0, 0], [100.0, 1, 0]])
    T_true = yaw_transform(0.3, (5, 6, 7))
    middle = points.mean(axis=0)
    turn = yaw_transform(np.radians(1.0))
    # Turned by a degree about the points' middle: 1.7 m off at the origin, little where they are.
    about_middle = turn.copy()
    about_middle[:3, 3] = middle - turn[:3, :3] @ middle
    error = transform_error(T_true @ about_middle, T_true, points)
    assert error.angle == pytest.approx(1.0)
    assert error.displacement < 0.02
    assert error.nearest == pytest.approx(error.displacement)


def test_the_nearest_neighbour_distance_forgives_a_shift_along_a_wall():
    wall = np.column_stack([np.arange(0, 10, 0.1), np.zeros(100), np.zeros(100)])
    error = transform_error(yaw_transform(0, (1, 0, 0)), np.eye(4), wall)
    assert error.displacement == pytest.approx(1.0)
    assert error.nearest < 0.1


def test_bounds_of_rates_are_clopper_and_pearson_s():
    assert upper_bound(0, 12) == pytest.approx(1 - 0.05 ** (1 / 12))
    assert upper_bound(0, 300) == pytest.approx(3 / 300, rel=0.01)
    # From the binomial distribution: with this rate, one event or fewer of ten is 5 % likely.
    rate = upper_bound(1, 10)
    assert (1 - rate) ** 10 + 10 * rate * (1 - rate) ** 9 == pytest.approx(0.05)
    assert (upper_bound(0, 0), upper_bound(4, 4)) == (1.0, 1.0)


def test_calibration_of_a_small_set():
    forecasts, right = [0.95, 0.92, 0.55, 1.0], [True, True, False, True]
    expected = (0.05**2 + 0.08**2 + 0.55**2) / 4
    assert brier_score(forecasts, right) == pytest.approx(expected)
    low, high = reliability(forecasts, right)
    assert (low.low, low.count, low.right) == (0.5, 1, 0.0)
    assert (high.high, high.count, high.right) == (1.0, 3, 1.0)
    assert high.confidence == pytest.approx((0.95 + 0.92 + 1.0) / 3)
    assert np.isnan(brier_score([], []))
    assert reliability([], []) == []
