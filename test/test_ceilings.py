"""A storey under a ceiling and one that is open above are not the same, plans alike or not."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from test.helpers_search import FLAT, building, map_of
from topometric_ros.fusion.ceilings import open_above
from topometric_ros.matching.search_fields import ScoringConfig, prepare
from topometric_ros.topometric_map import Storey, TopometricMap

CEILING = 2.5


def storeys_of(m: TopometricMap, ceilings: tuple[float | None, float | None]) -> TopometricMap:
    """Return a map with a second storey of the same plan 3 m up, and ceilings where wanted."""
    (floor,) = m.storeys
    lower = dataclasses.replace(floor, ceiling_z=ceilings[0])
    upper = Storey(floor.id + 1, floor.floor_z + 3.0, ceilings[1], floor.layers)
    ij = np.argwhere(floor.layers.free)
    plan = np.asarray(floor.layers.origin) + ij * floor.layers.cell
    covers = [
        np.column_stack([plan, np.full(len(plan), height)])
        for height in ceilings
        if height is not None
    ]
    cells = np.floor(np.concatenate(covers) / m.voxel_size).astype(np.int32)
    cells = np.unique(cells - np.floor(np.asarray(m.origin) / m.voxel_size).astype(int), axis=0)
    return dataclasses.replace(
        m,
        voxels=cells.astype(np.int32),
        offsets=np.zeros((len(cells), 3), np.int8),
        room=np.full(len(cells), -1, np.int32),
        storeys=(lower, upper),
        rooms=(),
        passages=(),
        navigable=np.zeros((0, 3), np.int32),
        descriptors=(),
    )


@pytest.fixture(scope="module")
def plan():
    return map_of(building(FLAT))


def compared(a: TopometricMap, b: TopometricMap, height: float):
    T = np.eye(4)
    T[2, 3] = height
    fields = tuple(prepare(m, ScoringConfig()) for m in (a, b))
    return open_above(a, b, fields, T)


def test_a_storey_that_is_open_above_is_not_the_one_below_it(plan):
    floor = plan.storeys[0].floor_z
    tower = storeys_of(plan, (floor + CEILING, None))
    assert compared(tower, tower, 0.0) is None
    wrong = compared(tower, tower, 3.0)
    assert wrong is not None
    assert wrong.covered > 0.9
    assert wrong.open < 0.1
    assert "another storey" in wrong.reason()


def test_a_map_without_any_ceiling_contradicts_nothing(plan):
    floor = plan.storeys[0].floor_z
    tower = storeys_of(plan, (floor + CEILING, floor + 3.0 + CEILING))
    blind = dataclasses.replace(
        tower,
        voxels=tower.voxels[:1],
        offsets=tower.offsets[:1],
        room=tower.room[:1],
        storeys=tuple(dataclasses.replace(s, ceiling_z=None) for s in tower.storeys),
    )
    assert compared(tower, blind, 0.0) is None
