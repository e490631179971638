"""Stretches of one corridor are joined, and a corridor that was half seen is not taken for one."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.extraction import default_rooms
from topometric_ros.extraction.default_rooms import NarrowingsConfig, storey_regions
from topometric_ros.extraction.merging import MergingConfig
from topometric_ros.extraction.walls import MARGIN, StoreyRaster, clearance

_ONLY_CORRIDORS = NarrowingsConfig(merging=MergingConfig(threshold=100.0))


def _two_in_line(opening: int, seen: int) -> StoreyRaster:
    """A corridor of 12 m x 1.6 m and one of 14 m x 2.2 m, in line, with an opening between them.

    The opening is so many cells wide; of the second corridor a strip of `seen` cells was seen.
    """
    first, second, end = MARGIN + 1, MARGIN + 123, MARGIN + 263
    middle = MARGIN + 12
    free = np.zeros((end + MARGIN + 1, middle + MARGIN + 12), bool)
    free[first : second - 2, middle - 8 : middle + 8] = True
    free[second - 2 : second, middle - opening // 2 : middle + opening // 2] = True
    free[second:end, middle - 11 : middle + 11] = True
    wall = ndimage.binary_dilation(free, np.ones((3, 3))) & ~free
    domain = free.copy()
    domain[second:, : middle - seen // 2] = False
    domain[second:, middle + seen // 2 :] = False
    inside = (domain | ndimage.binary_dilation(wall, iterations=2)) & ~wall
    distance: NDArray[np.float64] = ndimage.distance_transform_edt(inside)
    return StoreyRaster(np.zeros(2, np.int64), domain, wall, domain, distance, clearance(wall))


def _rooms(raster: StoreyRaster) -> tuple[int, int]:
    """Return the regions of the middles of both corridors."""
    regions = storey_regions(raster, _ONLY_CORRIDORS)
    first, second = (int(regions[MARGIN + x, MARGIN + 12]) for x in (60, 190))
    assert min(first, second) > 0
    return first, second


def test_corridors_that_meet_without_a_narrowing_are_one() -> None:
    first, second = _rooms(_two_in_line(opening=16, seen=22))
    assert first == second


@pytest.mark.parametrize("seen", [22, 10])
def test_a_narrowing_divides_them_however_much_was_seen(seen: int) -> None:
    first, second = _rooms(_two_in_line(opening=12, seen=seen))
    assert first != second


def test_floor_that_was_half_seen_would_be_too_narrow(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(default_rooms, "_UNSEEN", 1.0)
    first, second = _rooms(_two_in_line(opening=12, seen=10))
    assert first == second
