"""The voxel lattice: eq. 2-8, growing without renumbering, surfaces finer than a voxel."""

import numpy as np
import pytest

from topometric_ros.voxels.grid import VoxelError, surface_offsets, thin, voxelise
from topometric_ros.voxels.morton import morton_encode


def cloud(seed=0, n=2000):
    return np.random.default_rng(seed).uniform(-3, 5, (n, 3))


def test_every_point_lies_in_its_cell():
    points = cloud()
    grid, cell = voxelise(points, 0.1, np.array([0.02, -0.3, 0.05]))
    assert np.abs(points - grid.centres()[cell]).max() <= 0.05 + 1e-9


def test_voxels_are_distinct_and_in_morton_order():
    grid, _ = voxelise(cloud(), 0.5, np.zeros(3))
    codes = morton_encode(grid.coords)
    assert (codes[1:] > codes[:-1]).all()


def test_a_growing_cloud_renumbers_nothing():
    first, more = cloud(1), cloud(2)
    small, _ = voxelise(first, 0.2, np.zeros(3))
    large, _ = voxelise(np.concatenate([first, more]), 0.2, np.zeros(3))
    assert {tuple(c) for c in small.coords} <= {tuple(c) for c in large.coords}


def test_points_in_another_order_give_the_same_grid():
    points = cloud()
    a, _ = voxelise(points, 0.3, np.zeros(3))
    b, _ = voxelise(points[::-1], 0.3, np.zeros(3))
    assert np.array_equal(a.coords, b.coords)


def test_moving_by_whole_voxels_moves_the_coordinates():
    points = cloud()
    a, _ = voxelise(points, 0.25, np.zeros(3))
    b, _ = voxelise(points + np.array([1.0, -2.0, 0.5]), 0.25, np.zeros(3))
    shifted = {tuple(c) for c in a.coords + np.array([4, -8, 2])}
    assert shifted == {tuple(c) for c in b.coords}


def test_a_wall_inside_a_voxel_is_kept_to_a_quarter_of_its_edge():
    points = cloud()
    points[:, 0] = 1.033
    grid, cell = voxelise(points, 0.1, np.zeros(3))
    offsets = surface_offsets(points, grid, cell)
    x = (grid.coords[:, 0] + (offsets[:, 0] + 0.5) / 4) * 0.1
    assert np.abs(x - 1.033).max() <= 0.1 / 8 + 1e-9


def test_thinning_keeps_one_mean_a_cell():
    points = np.array([[0.01, 0.0, 0.0], [0.02, 0.0, 0.0], [0.30, 0.0, 0.0]])
    assert np.allclose(thin(points, 0.05), [[0.015, 0, 0], [0.30, 0, 0]])


@pytest.mark.parametrize(("points", "size"), [(np.zeros((0, 3)), 0.1), (np.zeros((1, 3)), 0.0)])
def test_nothing_to_voxelise_is_an_error_with_the_value(points, size):
    with pytest.raises(VoxelError):
        voxelise(points, size, np.zeros(3))
