"""Visibilities are sets of voxels and the Jaccard index compares them (eq. 29-33)."""

from __future__ import annotations

import numpy as np
import pytest

from test.helpers_voxels import grid_of, scattered, two_rooms_with_a_door
from topometric_ros.extraction.visibility import (
    Visibilities,
    VisibilityConfig,
    jaccard,
    visibilities,
)
from topometric_ros.voxels.index import VoxelIndex
from topometric_ros.voxels.raycast import visible


def sets_of(members: list[list[int]], voxels: int) -> Visibilities:
    """Return visibilities that hold the given rows."""
    bits = np.zeros((len(members), (voxels + 63) // 64 * 64), np.uint8)
    for row, member in zip(bits, members, strict=True):
        row[member] = 1
    return Visibilities(np.packbits(bits, axis=1, bitorder="little").view("<u8"), voxels)


def random_sets(seed: int, count: int, voxels: int) -> list[list[int]]:
    rng = np.random.default_rng(seed)
    members = []
    for _ in range(count):
        start, size = rng.integers(0, voxels), rng.integers(0, voxels // 3)
        inside = np.arange(start, min(start + size, voxels))
        members.append(inside[rng.random(len(inside)) < 0.5].tolist())
    return members


def test_the_bits_of_a_visibility_are_the_voxels_seen() -> None:
    grid = grid_of(scattered(21, 800, 8))
    points = np.array([[0.0, 0.0, 0.0], [0.31, -0.2, 0.44]])
    seen = visibilities(grid, points, VisibilityConfig(radius=0.7))
    index = VoxelIndex(grid.coords)
    for view in range(2):
        expected = visible(index, points[view] / 0.1, 7.0, grid.coords)
        assert seen.rows(view).tolist() == expected.tolist()
    assert seen.sizes().tolist() == [len(seen.rows(0)), len(seen.rows(1))]


def test_two_rooms_see_each_other_through_the_door_only() -> None:
    grid = two_rooms_with_a_door()
    points = np.array([[2.0, 1.5, 1.5], [6.0, 1.5, 1.5], [6.0, 0.5, 1.5]])
    similarity = jaccard(visibilities(grid, points, VisibilityConfig(radius=10.0)))
    assert similarity[1, 2] > 0.5
    assert 0 < similarity[0, 1] < 0.3
    centres = grid.centres()
    seen = visibilities(grid, points[:1], VisibilityConfig(radius=10.0)).rows(0)
    far = centres[seen][centres[seen][:, 0] > 7.9]
    assert len(far) > 0
    # From 2 m before a door of 0.9 m a stripe of 2.7 m of a wall 6 m away is all there is to see.
    assert np.ptp(far[:, 1]) < 2.8


def test_nothing_beyond_the_radius_is_seen() -> None:
    grid = two_rooms_with_a_door()
    point = np.array([[2.0, 1.5, 1.5]])
    seen = visibilities(grid, point, VisibilityConfig(radius=1.8)).rows(0)
    assert np.linalg.norm(grid.centres()[seen] - point, axis=1).max() <= 1.8 + 1e-9


@pytest.mark.parametrize("voxels", [50, 64, 5000])
def test_the_jaccard_index_is_that_of_sets(voxels: int) -> None:
    members = random_sets(voxels, 12, voxels)
    similarity = jaccard(sets_of(members, voxels))
    for a, first in enumerate(map(set, members)):
        for b, second in enumerate(map(set, members)):
            union = len(first | second)
            assert similarity[a, b] == (len(first & second) / union if union else 1.0)


def test_the_jaccard_index_is_symmetric_and_1_with_itself() -> None:
    similarity = jaccard(sets_of(random_sets(9, 20, 3000), 3000))
    assert (similarity == similarity.T).all()  # eq. 32
    assert (np.diag(similarity) == 1).all()  # eq. 33
    assert similarity.min() >= 0
    assert similarity.max() <= 1


def test_no_viewpoints_see_nothing() -> None:
    seen = visibilities(grid_of(np.zeros((1, 3), int)), np.zeros((0, 3)), VisibilityConfig())
    assert len(seen) == 0
    assert jaccard(seen).shape == (0, 0)
