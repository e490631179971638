"""Kernels and convolution follow equations 11-16 and the stick of §4.2.2."""

from __future__ import annotations

import numpy as np
import pytest

from test.helpers_voxels import as_set, block, scattered
from topometric_ros.voxels.kernels import (
    Kernel,
    KernelError,
    ball,
    circle,
    column,
    connectivity,
    convolve,
    dilate,
    kernel_of,
    moore,
    stick_kernel,
    von_neumann,
)


def test_named_neighbourhoods_have_the_sizes_of_the_literature() -> None:
    sizes = [len(k) for k in (von_neumann(), moore(), ball(1), ball(2), circle(1), circle(2))]
    assert sizes == [6, 26, 7, 33, 5, 13]
    assert set(circle(5).coords[:, 2].tolist()) == {0}
    assert column(2).coords.tolist() == [[0, 0, 0], [0, 0, 1], [0, 0, 2]]
    with pytest.raises(KernelError, match="18"):
        connectivity("18")


def test_a_kernel_is_laid_with_its_origin_on_the_voxel() -> None:
    # eq. 14: K_v = v_K + (v - o_K)
    kernel = Kernel(np.array([[3, 1, 0]], np.int32), np.ones(1), np.array([2, 1, 0], np.int32))
    coords = np.array([[0, 0, 0], [1, 0, 0]], np.int32)
    assert convolve(coords, np.array([5.0, 7.0]), kernel).tolist() == [7.0, 0.0]


def test_a_kernel_with_parts_of_different_length_is_refused() -> None:
    with pytest.raises(KernelError, match=r"\(2,\)"):
        Kernel(np.zeros((1, 3), np.int32), np.ones(2), np.zeros(3, np.int32))


@pytest.mark.parametrize(
    ("function", "make"),
    [
        ("sum", sum),
        ("max", max),
        ("min", min),
        ("count", len),
        ("any", lambda v: float(any(x != 0 for x in v))),
    ],
)
def test_convolution_applies_its_function_to_the_weighted_neighbours(function, make) -> None:
    coords = scattered(1, 60, 2)
    rng = np.random.default_rng(2)
    values = rng.normal(size=len(coords))
    kernel = Kernel(moore().coords, rng.normal(size=26), np.zeros(3, np.int32))
    value_at = dict(zip(map(tuple, coords.tolist()), values, strict=True))
    expected = []
    for cell in coords.tolist():
        near = [tuple(np.add(cell, k)) for k in kernel.coords.tolist()]
        found = [
            w * value_at[n] for n, w in zip(near, kernel.weights, strict=True) if n in value_at
        ]
        expected.append(make(found) if found else 0.0)
    np.testing.assert_allclose(convolve(coords, values, kernel, function), expected)


def test_any_function_can_be_convolved() -> None:
    coords = scattered(3, 200, 5)
    values = np.random.default_rng(4).uniform(0.0, 1.0, len(coords))
    for name, function in {
        "sum": lambda v, w: float(v @ w),
        "max": lambda v, w: float((v * w).max()),
        "count": lambda v, w: len(v),
    }.items():
        expected = convolve(coords, values, moore(), name)
        assert convolve(coords, values, moore(), function) == pytest.approx(expected)
    alone = np.zeros((1, 3), np.int32)
    assert convolve(alone, None, moore(), lambda v, w: float(np.median(v))).tolist() == [0.0]


def test_a_property_left_out_is_occupancy() -> None:
    assert convolve(block((0, 0, 0), (2, 2, 2)), None, von_neumann()).max() == 6


def test_an_unknown_function_is_refused() -> None:
    with pytest.raises(KernelError, match="median"):
        convolve(np.zeros((1, 3), np.int32), None, moore(), "median")


@pytest.mark.parametrize(("voxel_size", "tall"), [(0.05, 20), (0.1, 10), (0.2, 5)])
def test_the_stick_is_a_metre_high_at_every_voxel_size(voxel_size: float, tall: int) -> None:
    stick = stick_kernel(voxel_size)
    assert stick.coords[:, 2].max() == tall
    assert stick.weights[0] == 0
    assert stick.weights[1:].min() == 1
    assert stick.coords[0].tolist() == [0, 0, 0]


def test_the_stick_is_thin_near_the_floor_and_wide_above() -> None:
    stick = stick_kernel(0.05).coords
    width = [(np.ptp(stick[stick[:, 2] == z, 0]) + 1) * 0.05 for z in range(1, 21)]
    assert width[:5] == pytest.approx([0.05] * 5)
    assert width[5:] == pytest.approx([0.35] * 15)  # seven cells whose centres span 0.3 m


def test_dilation_covers_what_the_kernel_covers() -> None:
    cells = scattered(3, 20, 5)
    expected = {tuple(np.add(c, k)) for c in cells.tolist() for k in ball(2).coords.tolist()}
    assert as_set(dilate(cells, ball(2))) == expected
    assert dilate(np.zeros((0, 3), np.int32), ball(2)).shape == (0, 3)


def test_a_kernel_of_offsets_weighs_one_each() -> None:
    assert kernel_of([(0, 0, 1)]).weights.tolist() == [1.0]
