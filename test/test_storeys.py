"""Storeys are found by headroom, and the slab between two of them is shared out by what sees it."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from test.helpers import box_room
from topometric_ros.extraction.columns import NOTHING, sort_columns
from topometric_ros.extraction.storeys import (
    RASTER,
    StoreyConfig,
    StoreyHeights,
    assign_storeys,
    find_storeys,
)
from topometric_ros.voxels.grid import voxelise


def _storeys(
    points: NDArray[np.float64], origin_z: float = 0.0
) -> tuple[tuple[StoreyHeights, ...], NDArray[np.int32], NDArray[np.float64]]:
    grid, cell_of_point = voxelise(points, RASTER, np.array([0.0, 0.0, origin_z]))
    heights = np.bincount(cell_of_point, weights=points[:, 2]) / np.bincount(cell_of_point)
    columns = sort_columns(grid.coords)
    storeys = find_storeys(columns, heights, origin_z, StoreyConfig())
    return storeys, assign_storeys(columns, heights, storeys), heights


def _two_storeys(slab: float) -> NDArray[np.float64]:
    low = box_room((0, 0, 0), (6, 5, 2.6), (("x+", 2.5),))
    return np.concatenate([low, box_room((0, 0, 2.6 + slab), (6, 5, 2.5), (("x-", 2.5),))])


def test_columns_know_the_gaps_above_and_below_each_voxel() -> None:
    coords = np.array([[4, 2, 9], [4, 2, 1], [4, 3, 0], [4, 2, 4], [4, 2, 5]], np.int32)
    columns = sort_columns(coords)
    assert columns.above.tolist() == [NOTHING, 3, NOTHING, 1, 4]
    assert columns.below.tolist() == [4, NOTHING, NOTHING, 3, 1]
    assert columns.horizontal.tolist() == [False, False, True, False, False]
    assert columns.raster_cells().tolist() == [[0, 0], [0, 0], [0, 1], [0, 0], [0, 0]]


def test_one_storey_has_one_floor_and_its_ceiling() -> None:
    (storey,), of_voxel, _ = _storeys(box_room((0, 0, 0.33), (6, 5, 2.6)))
    assert storey.floor == pytest.approx(0.33, abs=0.02)
    assert storey.ceiling == pytest.approx(2.93, abs=0.02)
    assert storey.ceiling_seen
    assert not of_voxel.any()


@pytest.mark.parametrize("slab", [0.15, 0.2, 0.3, 0.5])
@pytest.mark.parametrize("origin_z", [0.0, 0.03, 0.07])
def test_a_slab_is_shared_out_between_the_storeys_that_see_its_faces(
    slab: float, origin_z: float
) -> None:
    storeys, of_voxel, heights = _storeys(_two_storeys(slab), origin_z)
    assert [s.floor for s in storeys] == pytest.approx([0.0, 2.6 + slab], abs=0.03)
    assert [s.ceiling for s in storeys] == pytest.approx([2.6, 5.1 + slab], abs=0.03)
    wrong = (heights < 2.62) & (of_voxel == 1) | (heights > 2.58 + slab) & (of_voxel == 0)
    assert wrong.mean() < 0.005


def test_a_table_is_no_floor() -> None:
    room = box_room((0, 0, 0), (6, 5, 2.7))
    x, y = np.meshgrid(np.arange(1, 4, 0.05), np.arange(1, 4, 0.05))
    table = np.stack([x.ravel(), y.ravel(), np.full(x.size, 0.75)], -1)
    storeys, _, _ = _storeys(np.concatenate([room, table]))
    assert [s.floor for s in storeys] == pytest.approx([0.0], abs=0.02)


def test_a_floor_without_a_ceiling_is_a_storey_of_the_usual_height() -> None:
    points = box_room((0, 0, 0), (6, 5, 2.7))
    (storey,), _, _ = _storeys(points[points[:, 2] < 2.6])
    assert storey.floor == pytest.approx(0.0, abs=0.02)
    assert storey.ceiling == pytest.approx(StoreyConfig().usual_height, abs=0.1)
    assert not storey.ceiling_seen


def test_a_wall_alone_has_no_storey() -> None:
    y, z = np.meshgrid(np.arange(0, 30, 0.05), np.arange(0, 3, 0.05))
    storeys, _, _ = _storeys(np.stack([np.zeros(y.size), y.ravel(), z.ravel()], -1))
    assert storeys == ()


def test_scattered_points_have_no_storey() -> None:
    points = np.random.default_rng(3).uniform(0, 10, (30_000, 3))
    storeys, _, _ = _storeys(points)
    assert storeys == ()


def test_the_faces_of_a_slab_seen_on_one_side_only_stay_apart() -> None:
    points = _two_storeys(0.15)
    x, z = points[:, 0], points[:, 2]
    upper_floor_unseen = (np.abs(z - 2.75) < 0.01) & (x > 1.5) & (x < 4.5)
    ceiling_unseen = (np.abs(z - 2.6) < 0.01) & (x < 1.0)
    storeys, of_voxel, heights = _storeys(points[~upper_floor_unseen & ~ceiling_unseen])
    assert storeys[0].ceiling == pytest.approx(2.6, abs=0.01)
    assert storeys[1].floor == pytest.approx(2.75, abs=0.01)
    wrong = (heights < 2.62) & (of_voxel == 1) | (heights > 2.73) & (of_voxel == 0)
    assert wrong.mean() < 0.001


@pytest.mark.parametrize(("bare", "floors"), [(False, [0.0, 2.9]), (True, [0.0])])
def test_a_small_upper_storey_needs_walls(bare: bool, floors: list[float]) -> None:
    hall = box_room((0, 0, 0), (20, 10, 2.6))
    landing = box_room((-4, 0, 2.9), (2.4, 2, 2.5))
    if bare:
        landing = landing[(landing[:, 2] < 2.95) | (landing[:, 2] > 5.35)]
    storeys, _, _ = _storeys(np.concatenate([hall, landing]))
    assert [s.floor for s in storeys] == pytest.approx(floors, abs=0.03)
