"""Masks of a plan: beside what SciPy says of the same."""

import numpy as np
import pytest
from scipy import ndimage

from topometric_ros.extraction.masks import BESIDE, closed, depth, dilated, nearest_unset

_RNG = np.random.default_rng(3)
_MASKS = [
    _RNG.random(shape) < full
    for shape in ((1, 1), (1, 9), (23, 1), (30, 41))
    for full in (0.1, 0.6, 0.95)
]


@pytest.mark.parametrize("mask", _MASKS)
def test_depth_is_the_exact_distance_from_what_is_not_set(mask) -> None:
    mask[0, 0] = False
    assert np.array_equal(depth(mask), ndimage.distance_transform_edt(mask))


@pytest.mark.parametrize("mask", _MASKS)
def test_of_equally_near_cells_the_same_is_taken_as_by_scipy(mask) -> None:
    mask[0, 0] = False
    expected = ndimage.distance_transform_edt(mask, return_distances=False, return_indices=True)
    cells = np.argwhere(np.ones(mask.shape, bool))
    assert np.array_equal(nearest_unset(mask, cells), expected.reshape(2, -1).T)


@pytest.mark.parametrize("mask", _MASKS)
def test_masks_grow_and_close_as_with_the_structures_of_their_disks(mask) -> None:
    padded = np.pad(mask, 4)
    for radius, disk in ((1.0, None), (BESIDE, np.ones((3, 3)))):
        assert np.array_equal(dilated(mask, radius), ndimage.binary_dilation(mask, disk))
        assert np.array_equal(closed(padded, radius), ndimage.binary_closing(padded, disk))
