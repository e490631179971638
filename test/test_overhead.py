"""Ceilings that were seen from below only are no floors of the storey above."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from test.helpers import box_room
from topometric_ros.extraction.config import extraction_preset
from topometric_ros.extraction.pipeline import extract
from topometric_ros.fusion.surface import surface_of

CONFIG = extraction_preset("default")
ROOMS = [((x, y, 0.0), (4.0, 3.5, 2.5)) for x in (0.0, 4.1, 8.2) for y in (0.0, 3.6)]
LANDING = ((12.3, 0.0, 2.55), (3.0, 3.0, 2.4))
UPPER = [((x, y, 2.7), (4.0, 3.5, 2.4)) for x in (0.0, 4.1, 8.2) for y in (0.0, 3.6)]

ON_TOP = [((x, y, 2.6), size) for (x, y, _), size in UPPER]


def walked(*rooms):
    """Return what was seen in some rooms: floors, walls and ceilings."""
    return np.concatenate([box_room(place, size) for place, size in rooms])


def free_floor(found):
    return [(round(s.floor_z, 1), float(s.layers.free.sum()) * 0.01) for s in found.storeys]


def test_a_ceiling_is_no_floor_where_only_a_landing_was_walked_upstairs():
    points = walked(*ROOMS, LANDING)
    found = extract(points, CONFIG).map
    (low, _), (high, area) = free_floor(found)
    assert (low, high) == pytest.approx((0.0, 2.55), abs=0.06)
    assert area < 12.0
    upstairs = found.origin[2] + found.navigable[:, 2] * found.voxel_size > 2.0
    assert np.count_nonzero(upstairs) * 0.01 < 12.0
    never = dataclasses.replace(CONFIG.storeys, overhead=0.0)
    before = extract(points, dataclasses.replace(CONFIG, storeys=never)).map
    assert free_floor(before)[1][1] > 60.0


@pytest.mark.parametrize("ceilings", [True, False])
def test_floors_over_walked_rooms_stay(ceilings):
    lower = walked(*ROOMS)
    if not ceilings:
        lower = lower[lower[:, 2] < 2.4]
    found = extract(np.concatenate([lower, walked(*UPPER)]), CONFIG).map
    (_, below), (high, above) = free_floor(found)
    assert high == 2.7
    assert above > 0.9 * below


def test_the_faces_of_a_thin_slab_point_away_from_each_other():
    both = np.concatenate([walked(*ROOMS), walked(*ON_TOP)])
    found = extract(both, CONFIG).map
    surface = surface_of(found)
    height = surface.points[:, 2] - found.storeys[0].floor_z
    flat = surface.sided & (np.abs(surface.normals[:, 2]) > 0.9)
    ceiling = flat & (np.abs(height - 2.5) < 0.03)
    floor = flat & (np.abs(height - 2.6) < 0.03)
    assert np.all(surface.normals[ceiling, 2] < 0.0)
    assert np.all(surface.normals[floor, 2] > 0.0)
    assert min(ceiling.sum(), floor.sum()) > 1000
