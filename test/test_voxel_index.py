"""The voxel index finds exactly the voxels that are there, whatever their extent."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from test.helpers_voxels import scattered
from topometric_ros.errors import TopometricError
from topometric_ros.voxels.index import VoxelIndex, cells_to_next

cell = st.tuples(*[st.integers(-70, 70)] * 3)


@settings(max_examples=60)
@given(st.lists(cell, unique=True, max_size=60), st.lists(cell, max_size=30))
def test_rows_are_those_of_a_dictionary(cells, asked) -> None:
    coords = np.array(cells, np.int32).reshape(-1, 3)
    row = {c: i for i, c in enumerate(cells)}
    queries = cells + asked
    expected = [row.get(q, -1) for q in queries]
    assert VoxelIndex(coords).rows(np.array(queries).reshape(-1, 3)).tolist() == expected


@settings(max_examples=40, deadline=None)
@given(st.lists(st.integers(-12, 12), unique=True, max_size=6), st.integers(-9, 9))
def test_the_next_cell_of_a_column_is_found_up_and_down(heights, z) -> None:
    table = VoxelIndex(np.array([(3, -2, h) for h in heights], np.int32).reshape(-1, 3)).table
    for way in (1, -1):
        ahead = [way * (h - z) for h in heights if way * (h - z) > 0]
        nearest = min(ahead, default=21)
        assert cells_to_next(table, 3, -2, z, way, 20) == nearest
        assert cells_to_next(table, 3, -2, z, way, 2) == min(nearest, 3)


def test_coordinates_far_apart_and_at_the_limits_are_found() -> None:
    limit = 1 << 20
    coords = np.array([[-limit] * 3, [limit - 1] * 3, [0, 0, 0], [limit - 1, -limit, 0]], np.int32)
    index = VoxelIndex(coords)
    assert index.rows(coords).tolist() == [0, 1, 2, 3]
    assert index.rows(coords + np.array([1, 0, 0])).tolist() == [-1] * 4
    assert len(index) == 4
    assert (0, 0, 0) in index
    assert (0, 0, 1) not in index


def test_memory_grows_with_the_voxels_and_not_with_the_bounds() -> None:
    # 100 m x 100 m x 20 m at 0.05 m would be 1.6 thousand million cells.
    rng = np.random.default_rng(0)
    coords = np.unique(rng.integers(0, (2000, 2000, 400), (20_000, 3)), axis=0).astype(np.int32)
    assert sum(part.nbytes for part in VoxelIndex(coords).table) < 4_000_000


@pytest.mark.parametrize("radius", [0.0, 0.9, 1.0, 3.7, 6.0])
def test_the_radius_query_returns_all_centres_within_the_distance(radius: float) -> None:
    coords = scattered(5, 3000, 9)
    for position in ([0.0, 0.0, 0.0], [-3.3, 2.5, 7.25]):
        distance = np.linalg.norm(coords - np.array(position), axis=1)
        found = VoxelIndex(coords).radius(np.array(position), radius)
        assert found.tolist() == np.flatnonzero(distance <= radius).tolist()


def test_a_cell_given_twice_is_refused() -> None:
    with pytest.raises(TopometricError, match="2 cells of which 1 differ"):
        VoxelIndex(np.zeros((2, 3), np.int32))


def test_an_empty_index_finds_nothing() -> None:
    index = VoxelIndex(np.zeros((0, 3), np.int32))
    assert index.rows(np.zeros((1, 3), int)).tolist() == [-1]
    assert len(index.radius(np.zeros(3), 10.0)) == 0
