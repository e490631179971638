"""The octree finds exactly what a look at every voxel finds, and sums up coarser levels."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from test.helpers_voxels import scattered
from topometric_ros.errors import TopometricError
from topometric_ros.voxels.morton import morton_encode
from topometric_ros.voxels.octree import Octree

cells = st.lists(st.tuples(*[st.integers(-40, 40)] * 3), unique=True, max_size=80)
place = st.tuples(*[st.floats(-45, 45)] * 3)


def array(found: list[tuple[int, int, int]]) -> np.ndarray:
    return np.array(found, np.int32).reshape(-1, 3)


@settings(max_examples=60)
@given(cells, place, st.floats(0, 60))
def test_a_radius_query_returns_all_centres_within_the_distance(found, position, radius) -> None:
    coords = array(found)
    square = ((coords - np.array(position)) ** 2).sum(1)
    sure = np.abs(np.sqrt(square) - radius) > 1e-9  # rounding may decide on the sphere itself
    rows = np.zeros(len(coords), bool)
    rows[Octree(coords).radius(np.array(position), radius)] = True
    assert (rows == (square <= radius**2))[sure].all()


@settings(max_examples=60)
@given(cells, st.tuples(*[st.integers(-45, 45)] * 6))
def test_a_box_query_returns_all_cells_inside(found, corners) -> None:
    coords, low, high = array(found), np.array(corners[:3]), np.array(corners[3:])
    inside = ((coords >= low) & (coords <= high)).all(1)
    assert Octree(coords).box(low, high).tolist() == np.flatnonzero(inside).tolist()


@settings(max_examples=40)
@given(cells, st.integers(0, 2**62), st.integers(0, 2**62))
def test_an_interval_is_a_run_of_the_morton_order(found, first, last) -> None:
    coords = array(found)
    codes = morton_encode(coords)
    middle = int(morton_encode(np.zeros((1, 3), np.int64))[0])
    for begin, end in ((first, last), (middle, middle + 512)):
        rows = Octree(coords).interval(begin, end)
        expected = [c for c in sorted(codes.tolist()) if begin <= c < end]
        assert codes[rows].tolist() == expected


@settings(max_examples=40)
@given(cells, st.integers(0, 8))
def test_a_level_holds_each_voxel_once_in_the_cell_above_it(found, level) -> None:
    coords = array(found)
    detail = Octree(coords).level(level)
    expected: dict[tuple[int, ...], list[np.ndarray]] = {}
    for cell in coords:
        expected.setdefault(tuple((cell >> level).tolist()), []).append(cell)
    assert {tuple(c) for c in detail.coords.tolist()} == set(expected)
    assert (np.diff(morton_encode(detail.coords).astype(np.int64)) > 0).all()
    for cell, count, mean in zip(detail.coords, detail.counts, detail.means, strict=True):
        members = expected[tuple(cell.tolist())]
        assert count == len(members)
        assert mean == pytest.approx(np.mean(members, axis=0))


def test_cells_at_the_limits_and_a_dense_cloud_are_found() -> None:
    limit = 1 << 20
    corners = np.array([[-limit] * 3, [limit - 1] * 3, [0, 0, 0]], np.int32)
    assert Octree(corners).box([-limit] * 3, [limit - 1] * 3).tolist() == [0, 1, 2]
    assert Octree(corners).radius(np.array([1.0, 0.0, 0.0]), 1.0).tolist() == [2]
    coords = scattered(5, 3000, 9)
    distance = np.linalg.norm(coords - (0.5, 0.0, 2.0), axis=1)
    found = Octree(coords).radius(np.array([0.5, 0.0, 2.0]), 5.2)
    assert found.tolist() == np.flatnonzero(distance <= 5.2).tolist()


def test_an_octree_has_no_cell_twice_and_its_levels_an_end() -> None:
    with pytest.raises(TopometricError, match="2 cells of which 1 differ"):
        Octree(np.zeros((2, 3), np.int32))
    with pytest.raises(TopometricError, match="expected 0 to 20, got 21"):
        Octree(np.zeros((1, 3), np.int32)).level(21)
    assert len(Octree(np.zeros((0, 3), np.int32)).radius(np.zeros(3), 5.0)) == 0
