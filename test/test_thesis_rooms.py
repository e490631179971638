"""The thesis' stages together find the rooms and the door between them."""

from __future__ import annotations

import numpy as np
import pytest

from test.helpers_voxels import grid_of, quarter_turn, two_rooms_with_a_door
from topometric_ros.configuration import flatten, parameters
from topometric_ros.extraction.navigation import NavigationConfig, navigable_volume
from topometric_ros.extraction.passages import PassageConfig, find_passages
from topometric_ros.extraction.thesis_rooms import ThesisRoomsConfig, segment
from topometric_ros.extraction.viewpoints import ViewpointConfig, viewpoints
from topometric_ros.topometric_map import NO_ROOM
from topometric_ros.voxels.grid import VoxelGrid


def rooms_and_passages(grid: VoxelGrid):
    navigable = navigable_volume(grid, NavigationConfig())
    views = viewpoints(navigable, grid, ViewpointConfig())
    room = segment(grid, navigable, views, ThesisRoomsConfig())
    return room, find_passages(grid, room, navigable, PassageConfig())


def share_in_own_room(grid: VoxelGrid, room: np.ndarray, side: np.ndarray) -> float:
    """Return the share of voxels that carry the label most common on their side of the door."""
    own = [np.bincount(room[side == s] + 1).argmax() - 1 for s in (0, 1)]
    assert own[0] != own[1]
    return float(np.mean(room == np.array(own)[side]))


@pytest.mark.parametrize("voxel_size", [0.1, 0.05])
def test_two_rooms_with_a_door_are_two_rooms_and_one_passage(voxel_size: float) -> None:
    grid = two_rooms_with_a_door(voxel_size)
    room, passages = rooms_and_passages(grid)
    large = np.flatnonzero(np.bincount(room[room >= 0]) * voxel_size**2 > 0.5)
    assert large.tolist() == [0, 1]
    between = 4.0 + voxel_size / 2
    side = (grid.centres()[:, 0] > between).astype(int)
    assert share_in_own_room(grid, room, side) > 0.97
    (door,) = passages
    assert door.rooms == (0, 1)
    assert door.position == pytest.approx((between, 1.5, 0.0), abs=2 * voxel_size)
    assert door.width == pytest.approx(0.9, abs=0.15)


def test_a_turned_and_moved_map_has_the_same_rooms() -> None:
    coords = two_rooms_with_a_door().coords
    turned = grid_of(quarter_turn(coords) + np.array([35, -128, 0], np.int32))
    room, passages = rooms_and_passages(turned)
    side = (turned.centres()[:, 1] > 4.05 - 12.8).astype(int)
    assert share_in_own_room(turned, room, side) > 0.97
    (door,) = passages
    assert door.position == pytest.approx((3.5 - 1.5, 4.05 - 12.8, 0.0), abs=0.25)


def test_the_same_map_gives_the_same_bytes() -> None:
    grid = two_rooms_with_a_door()
    assert rooms_and_passages(grid)[0].tobytes() == rooms_and_passages(grid)[0].tobytes()


def test_without_a_place_to_look_from_there_is_no_room() -> None:
    grid = two_rooms_with_a_door()
    for navigable in (grid.coords[:0], grid.coords):
        room = segment(grid, navigable, np.zeros((0, 3)), ThesisRoomsConfig())
        assert (room == NO_ROOM).all()


def test_the_defaults_are_the_values_of_the_thesis() -> None:
    values = flatten(ThesisRoomsConfig()) | flatten(NavigationConfig()) | flatten(PassageConfig())
    assert values["visibility.radius"] == 5.0
    assert (values["similarity.inflation_low"], values["similarity.inflation_high"]) == (1.2, 2.5)
    assert (values["propagation.radius"], values["propagation.iterations"]) == (2.0, 10)
    assert (values["thin_height"], values["wide_height"], values["diameter"]) == (0.25, 0.75, 0.3)
    assert (values["dilation"], values["connectivity"], values["keep"]) == (0.2, "6", "largest")
    assert (ViewpointConfig().radius, ViewpointConfig().step) == (0.5, 0)


@pytest.mark.parametrize(
    "config", [ThesisRoomsConfig(), NavigationConfig(), ViewpointConfig(), PassageConfig()]
)
def test_every_default_lies_within_its_own_limits(config) -> None:
    for info, value in parameters(config):
        assert info.check(value) == value
        assert info.description.endswith(".")
