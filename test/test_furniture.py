"""Furniture that stands where it stood, and furniture of the same sort."""

from __future__ import annotations

import numpy as np
import pytest

from test.helpers import box_room, moved, yaw_transform
from topometric_ros.extraction.config import extraction_preset
from topometric_ros.extraction.pipeline import extract
from topometric_ros.fusion.furniture import compare_furniture, furniture_of, laid_on
from topometric_ros.fusion.surface import surface_of

HALL = box_room((0.0, 0.0, 0.0), (12.0, 8.0, 2.6))
PLACES = [(x, y) for x in (1.5, 4.0, 6.5, 9.0) for y in (1.5, 5.0)]


def furnished(shifts, T=None):
    """Return the hall with one box at each place, moved by its shift, and its surface."""
    pieces = [
        box_room((x + dx, y + dy, 0.0), (1.2, 0.8, 0.9))
        for (x, y), (dx, dy) in zip(PLACES, shifts, strict=True)
    ]
    return seen(np.concatenate([HALL, *pieces]), T)


def seen(points, T=None):
    """Return the map of some points, in the frame that `T` leads to, and its surface."""
    made = extract(points if T is None else moved(points, T), extraction_preset("default")).map
    return made, surface_of(made)


@pytest.fixture(scope="module")
def here():
    return furnished([(0.0, 0.0)] * 8)


def laid(a, b, T_a_b):
    return laid_on(furniture_of(*a), furniture_of(*b), T_a_b)


def test_furniture_of_which_two_pieces_were_moved_stands_as_before(here):
    T_b_a = yaw_transform(0.7, (3.0, -1.0, 0.4))
    b = furnished([(0.0, 0.0)] * 6 + [(0.5, 0.3), (-0.4, 0.6)], T=T_b_a)
    T_a_b = np.linalg.inv(T_b_a)
    assert laid(here, b, T_a_b).kept == 6
    pieces = compare_furniture(here, b, T_a_b)
    assert pieces.same
    assert not pieces.displaced


def test_furniture_that_was_put_down_by_hand_does_not(here):
    rng = np.random.default_rng(3)
    b = furnished(rng.uniform(-0.15, 0.15, (8, 2)))
    found = laid(here, b, np.eye(4))
    assert found.fixed >= 7
    assert found.kept <= 2
    pieces = compare_furniture(here, b, np.eye(4))
    assert pieces.displaced
    assert not pieces.same


def test_a_few_pieces_say_nothing():
    one = seen(np.concatenate([HALL, box_room((4.0, 4.0, 0.0), (1.2, 0.8, 0.9))]))
    assert laid(one, one, np.eye(4)).kept == 1
    pieces = compare_furniture(one, one, np.eye(4))
    assert not pieces.same
    assert not pieces.displaced
    assert laid(one, seen(HALL), np.eye(4)).fixed == 0


def test_a_long_piece_is_not_fixed_along_itself():
    def with_screen(along):
        return seen(np.concatenate([HALL, box_room((4.0 + along, 4.0, 0.0), (3.5, 0.1, 0.9))]))

    here, slid = with_screen(0.0), with_screen(0.12)
    found = laid(here, slid, np.eye(4))
    assert (found.fixed, found.kept) == (1, 1)
    assert found.odds == pytest.approx(np.log(0.9 / 0.55))
    across = laid(
        here, seen(np.concatenate([HALL, box_room((4.0, 4.1, 0.0), (3.5, 0.1, 0.9))])), np.eye(4)
    )
    assert (across.fixed, across.kept) == (1, 0)


def test_only_pieces_whose_walls_are_in_place_speak_against_a_place(here):
    anew = laid(here, furnished([(0.12, 0.1)] * 8), np.eye(4))
    assert anew.kept == 0
    # Those in the middle of the hall see walls that run one way only.
    assert anew.odds < anew.placed < 0.0
    drifted = laid(here, here, yaw_transform(0.0, (0.1, 0.08, 0.0)))
    assert drifted.placed >= 0.0
