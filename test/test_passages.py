"""Passages lie where the navigable voxels of two rooms meet (§4.2.9)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from test.helpers_voxels import block, grid_of
from topometric_ros.extraction.passages import PassageConfig, find_passages
from topometric_ros.topometric_map import NO_ROOM
from topometric_ros.voxels.grid import VoxelGrid

CONFIG = PassageConfig()


def floor_in_two(*openings: tuple[int, int]) -> tuple[VoxelGrid, np.ndarray]:
    """Return a floor of two rooms that meet between x = 9 and x = 10 where `openings` say in y."""
    west, east = block((0, 0, 0), (8, 39, 0)), block((11, 0, 0), (19, 39, 0))
    doors = [block((9, low, 0), (10, high, 0)) for low, high in openings]
    grid = grid_of(np.concatenate([west, east, *doors]))
    return grid, (grid.coords[:, 0] >= 10).astype(np.int32)


def test_a_door_is_one_passage_in_its_middle_and_as_wide_as_it() -> None:
    grid, room = floor_in_two((10, 16))
    (passage,) = find_passages(grid, room, grid.coords, CONFIG)
    assert passage.rooms == (0, 1)
    assert passage.position == pytest.approx((0.95, 1.3, 0.0))
    # Seven navigable voxels and half of the agent, less half a voxel, on either side.
    assert passage.width == pytest.approx(0.9)


def test_two_doors_between_the_same_rooms_are_two_passages() -> None:
    grid, room = floor_in_two((3, 9), (20, 30))
    first, second = find_passages(grid, room, grid.coords, CONFIG)
    assert first.rooms == second.rooms == (0, 1)
    assert first.position[1] == pytest.approx(2.5)
    assert first.width == pytest.approx(1.3)
    assert second.position[1] == pytest.approx(0.6)


def test_rooms_that_touch_outside_the_navigable_volume_only_have_no_passage() -> None:
    grid, room = floor_in_two((10, 16))
    away = grid.coords[(grid.coords[:, 0] < 9) | (grid.coords[:, 0] > 10)]
    assert find_passages(grid, room, away, CONFIG) == ()


def test_voxels_in_no_room_make_no_passage() -> None:
    grid, room = floor_in_two((10, 16))
    assert find_passages(grid, np.full_like(room, NO_ROOM), grid.coords, CONFIG) == ()
    assert find_passages(grid, room - 1, grid.coords, CONFIG) == ()


@pytest.mark.parametrize(("rise", "step", "passages"), [(2, 0.2, 1), (2, 0.1, 0), (1, 0.0, 0)])
def test_a_step_is_a_passage_as_high_as_an_agent_climbs(
    rise: int, step: float, passages: int
) -> None:
    low, high = block((0, 0, 0), (9, 9, 0)), block((10, 0, rise), (19, 9, rise))
    grid = grid_of(np.concatenate([low, high]))
    room = (grid.coords[:, 0] >= 10).astype(np.int32)
    found = find_passages(grid, room, grid.coords, replace(CONFIG, step=step))
    assert len(found) == passages


def test_rooms_that_meet_at_a_corner_are_joined_by_26_neighbours_only() -> None:
    grid = grid_of(np.concatenate([block((0, 0, 0), (4, 4, 0)), block((5, 5, 0), (9, 9, 0))]))
    room = (grid.coords[:, 0] >= 5).astype(np.int32)
    assert find_passages(grid, room, grid.coords, CONFIG) == ()
    (passage,) = find_passages(grid, room, grid.coords, replace(CONFIG, connectivity="26"))
    assert passage.position == pytest.approx((0.45, 0.45, 0.0))
    assert passage.width == pytest.approx(0.3)


def test_small_contacts_can_be_left_out() -> None:
    grid, room = floor_in_two((3, 3), (20, 30))
    assert len(find_passages(grid, room, grid.coords, CONFIG)) == 2
    (wide,) = find_passages(grid, room, grid.coords, replace(CONFIG, smallest_contact=2))
    assert wide.position[1] == pytest.approx(2.5)


def test_an_oblique_passage_is_measured_along_itself() -> None:
    floor = block((0, 0, 0), (29, 29, 0))
    grid = grid_of(floor)
    room = (grid.coords[:, 0] > grid.coords[:, 1]).astype(np.int32)
    (passage,) = find_passages(grid, room, grid.coords, CONFIG)
    assert passage.width == pytest.approx(29 * np.sqrt(2) * 0.1 + 0.3, abs=0.15)
    assert passage.position == pytest.approx((1.45, 1.45, 0.0), abs=0.06)


def test_passages_of_many_rooms_are_in_the_order_of_their_rooms() -> None:
    grid = grid_of(block((0, 0, 0), (29, 9, 0)))
    room = np.array([2, 0, 1], np.int32)[grid.coords[:, 0] // 10]
    passages = find_passages(grid, room, grid.coords, CONFIG)
    assert [p.rooms for p in passages] == [(0, 1), (0, 2)]
    assert find_passages(grid, room, grid.coords[:0], CONFIG) == ()
