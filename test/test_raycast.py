"""Rays enter exactly the cells that hold a stretch of them (Algorithm 5, mended)."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from test.helpers_voxels import block, quarter_turn, scattered
from topometric_ros.voxels import raycast
from topometric_ros.voxels.index import VoxelIndex
from topometric_ros.voxels.raycast import STEPS, RayError, first_hit, traversed, visible

# Halves put rays on faces, edges and corners; other multiples of 1/256 nearly anywhere.
halves = st.integers(-12, 12).map(lambda n: n / 2)
fine = st.integers(-6 * STEPS, 6 * STEPS).map(lambda n: n / STEPS)
coordinate = st.one_of(halves, fine)
point = st.tuples(coordinate, coordinate, coordinate)


def cells_by_slabs(origin, target) -> list[tuple[int, ...]]:
    """All cells that hold a stretch of a ray, by exact slabs of every cell nearby, in order.

    Along an axis on which the ray does not move, cells are half open.
    """
    o, t = ([Fraction(v).limit_denominator(STEPS) for v in p] for p in (origin, target))
    spans = [range(int(min(a, b)) - 2, int(max(a, b)) + 3) for a, b in zip(o, t, strict=True)]
    half = Fraction(1, 2)
    found = []
    for cell in ((x, y, z) for x in spans[0] for y in spans[1] for z in spans[2]):
        enter, leave = Fraction(0), Fraction(1)
        for a, b, k in zip(o, t, cell, strict=True):
            if a == b:
                if not k - half <= a < k + half:
                    leave = Fraction(-1)
                continue
            times = sorted([(k - half - a) / (b - a), (k + half - a) / (b - a)])
            enter, leave = max(enter, times[0]), min(leave, times[1])
        if enter < leave:
            found.append((enter, cell))
    return [cell for _, cell in sorted(found)]


@settings(max_examples=150)
@given(point, point)
def test_the_cells_of_a_ray_are_those_of_exact_slabs(origin, target) -> None:
    cells = [tuple(c) for c in traversed(np.array(origin), np.array(target)).tolist()]
    own = tuple(int(np.floor(v + 0.5)) for v in origin)
    assert cells[0] == own
    expected = cells_by_slabs(origin, target)
    # A ray that starts on a face and leaves at once holds no stretch of its own cell.
    assert cells == expected or cells == [own, *expected]


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("sign", [-1, 1])
def test_an_axis_parallel_ray_runs_straight_in_both_directions(axis: int, sign: int) -> None:
    target = np.zeros(3)
    target[axis] = 4.0 * sign
    cells = traversed(np.zeros(3), target)
    assert cells[:, axis].tolist() == [0, sign, 2 * sign, 3 * sign, 4 * sign]
    assert (np.delete(cells, axis, 1) == 0).all()


def test_a_ray_through_a_corner_enters_the_opposite_cell_only() -> None:
    assert traversed(np.zeros(3), np.array([2.0, -2.0, 2.0])).tolist() == [
        [0, 0, 0],
        [1, -1, 1],
        [2, -2, 2],
    ]


def test_the_traversal_is_the_same_in_every_direction() -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        # Odd multiples of 1/256 never lie on a face between cells, whichever way they are turned.
        a, b = (rng.integers(-1000, 1000, (2, 3)) * 2 + 1) / STEPS
        cells = traversed(a, b)
        assert traversed(b, a).tolist() == cells[::-1].tolist()
        turned = traversed(np.array([-a[1], a[0], a[2]]), np.array([-b[1], b[0], b[2]]))
        assert turned.tolist() == quarter_turn(cells).tolist()


def test_the_first_hit_is_the_first_occupied_cell_of_the_traversal() -> None:
    coords = scattered(11, 150, 6)
    index = VoxelIndex(coords)
    rng = np.random.default_rng(12)
    origins, targets = rng.uniform(-7, 7, (2, 300, 3))
    hits = first_hit(index, origins, targets)
    for origin, target, hit in zip(origins, targets, hits, strict=True):
        rows = index.rows(traversed(origin, target)[1:])
        assert hit == (rows[rows >= 0][0] if (rows >= 0).any() else -1)
    assert (hits >= 0).any()
    assert (hits < 0).any()


def test_a_ray_that_leaves_the_grid_hits_nothing() -> None:
    index = VoxelIndex(np.array([[0, 0, 0], [5, 0, 0]], np.int32))
    ends = np.array([[-9.0, 0.0, 0.0], [9.0, 0.0, 0.0], [9.0, 9.0, 0.0]])
    assert first_hit(index, np.zeros((1, 3)), ends).tolist() == [-1, 1, -1]


@pytest.mark.parametrize("largest_box", [None, 0])
def test_a_voxel_is_seen_when_the_first_hit_towards_its_centre_is_itself(
    largest_box, monkeypatch
) -> None:
    coords = scattered(13, 900, 7)
    index = VoxelIndex(coords)
    position = np.array([0.3, -0.2, 0.1])
    rows = index.radius(np.round(position * STEPS) / STEPS, 6.0)
    hit = first_hit(index, position[None], coords[rows].astype(float))
    own = (coords[rows] == 0).all(1)
    if largest_box is not None:
        # Compiled code froze the limit, so the path without a box is run uncompiled.
        monkeypatch.setattr(raycast, "_LARGEST_BOX", largest_box)
        monkeypatch.setattr(raycast, "seen_rows", raycast.seen_rows.py_func)
    seen = visible(index, position, 6.0, coords)
    assert seen.tolist() == rows[(hit == rows) | own].tolist()


def test_a_wall_hides_what_stands_behind_it() -> None:
    wall = block((3, -5, -5), (3, 5, 5))
    coords = np.concatenate([wall, [[6, 0, 0], [6, 5, 5]]]).astype(np.int32)
    seen = visible(VoxelIndex(coords), np.zeros(3), 20.0, coords)
    assert seen.max() < len(wall)
    straight_ahead = np.flatnonzero((np.abs(wall[:, 1:]) <= 1).all(1))
    assert np.isin(straight_ahead, seen).all()


def test_a_ray_too_long_for_exact_numbers_is_refused() -> None:
    index = VoxelIndex(np.zeros((1, 3), np.int32))
    with pytest.raises(RayError, match="5000"):
        first_hit(index, np.zeros((1, 3)), np.array([[5000.0, 0.0, 0.0]]))
    with pytest.raises(RayError, match="nan"):
        first_hit(index, np.zeros((1, 3)), np.array([[np.nan, 0.0, 0.0]]))
