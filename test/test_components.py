"""Connected components partition a voxel set as Algorithm 1 means it."""

from __future__ import annotations

import numpy as np
import pytest
import scipy.ndimage

from test.helpers_voxels import block, scattered
from topometric_ros.voxels.components import connected_components
from topometric_ros.voxels.kernels import ball, kernel_of, moore, von_neumann


@pytest.mark.parametrize(("kernel", "reach"), [(von_neumann(), 1), (moore(), 3)])
def test_components_are_those_of_an_image(kernel, reach: int) -> None:
    coords = scattered(7, 500, 5)
    image = np.zeros((11, 11, 11), bool)
    image[tuple((coords + 5).T)] = True
    structure = scipy.ndimage.generate_binary_structure(3, reach)
    expected, count = scipy.ndimage.label(image, structure)
    expected = expected[tuple((coords + 5).T)]
    component = connected_components(coords, kernel)
    pairs = set(zip(component.tolist(), expected.tolist(), strict=True))
    assert len(pairs) == count == component.max() + 1


def test_the_largest_comes_first_and_equal_ones_in_morton_order() -> None:
    coords = np.concatenate([block((9, 0, 0), (9, 0, 0)), block((4, 0, 0), (4, 0, 0)),
                             block((0, 6, 0), (2, 6, 0))])  # fmt: skip
    assert connected_components(coords, moore()).tolist() == [2, 1, 0, 0, 0]


def test_every_voxel_is_in_one_component_and_no_edge_crosses_two() -> None:
    coords = scattered(8, 400, 6)
    component = connected_components(coords, ball(2))
    assert component.min() == 0
    sizes = np.bincount(component)
    assert sizes.sum() == len(coords)
    assert (np.diff(sizes) <= 0).all()
    apart = component[:, None] != component[None, :]
    square = ((coords[:, None] - coords[None]) ** 2).sum(-1)
    assert square[apart].min() > 4


def test_an_edge_in_either_direction_joins() -> None:
    coords = np.array([[0, 0, 0], [1, 0, 0]], np.int32)
    assert connected_components(coords, kernel_of([(1, 0, 0)])).tolist() == [0, 0]
    assert connected_components(coords, kernel_of([(-1, 0, 0)])).tolist() == [0, 0]


def test_only_equal_labels_join_and_negative_ones_are_left_out() -> None:
    coords = block((0, 0, 0), (5, 0, 0))
    labels = np.array([4, 4, 2, -1, 2, 2], np.int32)
    expected = [0, 0, 2, -1, 1, 1]
    assert connected_components(coords, moore(), labels).tolist() == expected


def test_no_voxels_have_no_components() -> None:
    assert len(connected_components(np.zeros((0, 3), np.int32), moore())) == 0
