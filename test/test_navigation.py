"""The navigable volume is where an agent could stand (§4.2.1-4.2.4)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from test.helpers import box_room
from test.helpers_voxels import as_set, block, grid_of, quarter_turn, two_rooms_with_a_door
from topometric_ros.extraction.navigation import (
    NavigationConfig,
    navigable_volume,
    on_storeys,
    unobstructed,
)
from topometric_ros.extraction.storeys import StoreyHeights
from topometric_ros.voxels.grid import voxelise
from topometric_ros.voxels.index import VoxelIndex
from topometric_ros.voxels.kernels import convolve, stick_kernel

CONFIG = NavigationConfig()


def room_with(*things) -> np.ndarray:
    """Return the cells of an empty room of 4 m x 3 m x 2.6 m and of what stands in it."""
    cells = voxelise(box_room((0, 0, 0), (4.0, 3.0, 2.6)), 0.1, np.zeros(3))[0].coords
    return np.concatenate([cells, *things])


def test_the_floor_is_navigable_but_for_the_agents_radius_along_the_walls() -> None:
    navigable = navigable_volume(grid_of(room_with()), CONFIG)
    assert as_set(navigable) == as_set(block((2, 2, 0), (38, 28, 0)))


def test_a_voxel_is_obstructed_by_anything_within_the_stick_and_by_nothing_else() -> None:
    floor = block((-5, -5, 0), (5, 5, 0))
    for height, blocked in ((1, 1), (3, 1), (4, 9), (10, 9), (11, 0)):
        grid = grid_of(np.concatenate([floor, [[0, 0, height]]]))
        free = unobstructed(grid, CONFIG)[grid.coords[:, 2] == 0]
        assert np.count_nonzero(~free) == blocked, height


def test_the_stick_fits_where_the_sum_over_its_kernel_is_zero() -> None:
    cells = np.random.default_rng(3).integers(0, 12, (400, 3))
    grid = grid_of(np.unique(cells * (1, 1, 3), axis=0).astype(np.int32))
    stick = stick_kernel(grid.voxel_size, CONFIG.thin_height, CONFIG.wide_height, CONFIG.diameter)
    free = unobstructed(grid, CONFIG)
    assert 0 < np.count_nonzero(free) < len(grid)
    np.testing.assert_array_equal(free, convolve(grid.coords, None, stick) == 0)


def test_the_space_below_a_low_table_is_not_navigable_and_its_top_is_apart() -> None:
    table = block((15, 10, 7), (22, 17, 7))
    navigable = navigable_volume(grid_of(room_with(table)), CONFIG)
    cells = as_set(navigable)
    assert not cells & as_set(block((15, 10, 0), (22, 17, 7)))
    assert (10, 10, 0) in cells


def test_stairs_join_two_floors() -> None:
    treads = [block((10 + 3 * k, 0, 2 * k), (12 + 3 * k, 9, 2 * k)) for k in range(5)]
    low, high = block((0, 0, 0), (9, 9, 0)), block((25, 0, 10), (34, 9, 10))
    navigable = navigable_volume(grid_of(np.concatenate([low, *treads, high])), CONFIG)
    assert {0, 2, 4, 6, 8, 10} <= set(navigable[:, 2].tolist())
    apart = replace(CONFIG, dilation=0.0)
    levels = navigable_volume(grid_of(np.concatenate([low, *treads, high])), apart)
    assert len(set(levels[:, 2].tolist())) == 1


def test_a_ceiling_is_no_floor_however_large() -> None:
    beam = block((20, 5, 1), (20, 25, 8))  # the floor is cut, the upper side of the ceiling is not
    grid = grid_of(room_with(beam))
    assert navigable_volume(grid, CONFIG)[:, 2].max() == 0
    as_drafted = navigable_volume(grid, replace(CONFIG, smallest_enclosure=0.0))
    assert set(as_drafted[:, 2].tolist()) == {26}


def test_a_floor_without_any_wall_is_still_a_floor() -> None:
    floor = block((0, 0, 0), (20, 20, 0))
    assert len(navigable_volume(grid_of(floor), CONFIG)) == len(floor)


def test_all_floors_of_some_size_can_be_kept() -> None:
    wall = block((20, 0, 0), (20, 30, 26))
    grid = grid_of(room_with(wall))
    largest = navigable_volume(grid, CONFIG)
    every = navigable_volume(grid, replace(CONFIG, keep="all"))
    assert as_set(largest) < as_set(every)
    assert every[:, 0].min() == 2
    assert every[:, 0].max() == 38
    big = replace(CONFIG, keep="all", smallest_area=len(largest) * 0.01 - 0.05)
    assert as_set(largest) <= as_set(navigable_volume(grid, big))


@pytest.mark.parametrize("voxel_size", [0.05, 0.1, 0.2])
def test_navigable_voxels_are_voxels_of_the_grid_in_morton_order(voxel_size: float) -> None:
    grid = two_rooms_with_a_door(voxel_size)
    navigable = navigable_volume(grid, CONFIG)
    rows = VoxelIndex(grid.coords).rows(navigable)
    assert (np.diff(rows) > 0).all()
    assert rows[0] >= 0
    assert len(rows) * voxel_size**2 == pytest.approx(24.0, rel=0.2)


def test_a_turned_and_moved_map_has_the_turned_and_moved_navigable_volume() -> None:
    coords = two_rooms_with_a_door().coords
    shift = np.array([-13, 57, 5], np.int32)
    expected = as_set(quarter_turn(navigable_volume(grid_of(coords), CONFIG)) + shift)
    assert as_set(navigable_volume(grid_of(quarter_turn(coords) + shift), CONFIG)) == expected


def test_where_nothing_can_be_stood_on_the_volume_is_empty() -> None:
    config = replace(CONFIG, keep="all", smallest_area=100.0)
    assert navigable_volume(grid_of(block((0, 0, 0), (3, 3, 0))), config).shape == (0, 3)
    assert navigable_volume(grid_of(np.zeros((0, 3), np.int32)), CONFIG).shape == (0, 3)


def test_a_ceiling_and_a_bed_are_no_floor_but_stairs_through_a_ceiling_are() -> None:
    """At 0.1 m: floors at 0 and 3.0, a ceiling at 2.5, a bed at 0.5, stairs from floor to floor."""
    low, high = block((0, 0, 0), (39, 39, 0)), block((0, 60, 30), (39, 99, 30))
    ceiling, bed = block((0, 0, 25), (39, 39, 25)), block((5, 5, 5), (19, 18, 5))
    treads = [block((0, 40 + 2 * i // 3, i), (9, 40 + 2 * i // 3, i)) for i in range(1, 30)]
    grid = grid_of(np.concatenate([low, high, ceiling, bed, *treads]))
    storeys = (StoreyHeights(0.0, 2.5, True), StoreyHeights(3.0, 5.7, False))
    config = NavigationConfig(keep="all", largest_off_floor=4.0)
    kept = as_set(on_storeys(grid.coords, grid, storeys, config))
    assert kept == as_set(grid.coords) - as_set(ceiling) - as_set(bed)
    drafted = on_storeys(grid.coords, grid, storeys, NavigationConfig())
    assert len(drafted) == len(grid)


def test_a_floor_that_is_no_storey_is_kept_where_it_is_large() -> None:
    low, stage = block((0, 0, 0), (39, 39, 0)), block((60, 0, 8), (99, 39, 8))
    grid = grid_of(np.concatenate([low, stage]))
    config = NavigationConfig(keep="all", largest_off_floor=4.0)
    storeys = (StoreyHeights(0.0, 2.5, True),)
    assert len(on_storeys(grid.coords, grid, storeys, config)) == len(grid)
