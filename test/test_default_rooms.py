"""Preset `default` splits floors at doors, keeps corridors whole and does not see furniture."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from test.helpers import box_room, moved, yaw_transform
from topometric_ros.extraction.assemble import majority
from topometric_ros.extraction.columns import sort_columns
from topometric_ros.extraction.default_rooms import NarrowingsConfig, segment
from topometric_ros.extraction.pair_features import extended, pair_features
from topometric_ros.extraction.pieces import markers, watershed
from topometric_ros.extraction.room_labels import label_points
from topometric_ros.extraction.storeys import (
    RASTER,
    StoreyConfig,
    StoreyHeights,
    assign_storeys,
    find_storeys,
)
from topometric_ros.extraction.walls import MARGIN, StoreyRaster, WallsConfig, storey_raster
from topometric_ros.voxels.grid import VoxelGrid, voxelise

_WALL = 0.12


def _labels(points: NDArray[np.float64]) -> tuple[VoxelGrid, NDArray[np.int32]]:
    grid, labels, _ = _segmented(points)
    return grid, labels


def _segmented(
    points: NDArray[np.float64],
) -> tuple[VoxelGrid, NDArray[np.int32], NDArray[np.int64]]:
    """Return the voxels, their labels and the voxel of each point."""
    grid, cell_of_point = voxelise(points, RASTER, np.zeros(3))
    labels = _point_labels(points, grid, cell_of_point)
    return grid, majority(cell_of_point, labels), cell_of_point


def _point_labels(
    points: NDArray[np.float64], grid: VoxelGrid, cell_of_point: NDArray[np.int64]
) -> NDArray[np.int32]:
    heights = np.bincount(cell_of_point, weights=points[:, 2]) / np.bincount(cell_of_point)
    columns = sort_columns(grid.coords)
    storeys = find_storeys(columns, heights, 0.0, StoreyConfig())
    storey = assign_storeys(columns, heights, storeys)
    places = points[:, :2] / RASTER
    return segment(columns, heights, storeys, storey, places, cell_of_point, NarrowingsConfig())


def _label_at(
    grid: VoxelGrid, labels: NDArray[np.int32], points: list[tuple[float, float]]
) -> list[int]:
    """Return the label of the floor voxel at each position."""
    rows = []
    for x, y in points:
        there = np.abs(grid.centres() - (x, y, 0.0)).max(1) < 0.06
        rows.append(int(labels[np.flatnonzero(there)[0]]))
    return rows


def _two_rooms() -> NDArray[np.float64]:
    left = box_room((0, 0, 0), (5, 4, 2.6), (("x+", 2.0),))
    return np.concatenate([left, box_room((5 + _WALL, 0, 0), (4, 4, 2.6), (("x-", 2.0),))])


def _offices(count: int = 4) -> NDArray[np.float64]:
    """A corridor of 14 m with offices of 3.4 m along one side, a door each."""
    middles = [1.7 + 3.52 * i for i in range(count)]
    parts = [box_room((0, 0, 0), (14, 1.8, 2.6), tuple(("y+", m) for m in middles))]
    for i in range(count):
        corner = (3.52 * i, 1.8 + _WALL, 0)
        parts.append(box_room(corner, (3.4, 4.5, 2.6), (("y-", 1.7),)))
    return np.concatenate(parts)


def _agreement(one: NDArray[np.int32], other: NDArray[np.int32]) -> float:
    """Adjusted Rand index of two labellings (Hubert & Arabie 1985)."""
    table = np.zeros((one.max() + 1, other.max() + 1))
    np.add.at(table, (one, other), 1)

    def pairs(counts: NDArray[np.float64]) -> float:
        return float((counts * (counts - 1) / 2).sum())

    rows, columns = pairs(table.sum(1)), pairs(table.sum(0))
    expected = rows * columns / pairs(table.sum(keepdims=True))
    return (pairs(table) - expected) / ((rows + columns) / 2 - expected)


def test_two_rooms_with_a_door_are_two() -> None:
    grid, labels = _labels(_two_rooms())
    assert labels.max() == 1
    left, right = _label_at(grid, labels, [(1.0, 1.0), (8.0, 1.0)])
    assert left != right
    assert _label_at(grid, labels, [(4.5, 3.5), (5.5, 3.5)]) == [left, right]


def test_a_corridor_and_its_offices_are_one_room_each() -> None:
    grid, labels = _labels(_offices())
    doors = [(1.7 + 3.52 * i, 4.0) for i in range(4)]
    found = _label_at(grid, labels, [(7.0, 0.9), *doors])
    assert len(set(found)) == 5
    assert labels.max() == 4
    assert set(_label_at(grid, labels, [(0.5, 0.9), (3.0, 0.9), (13.5, 0.9)])) == {found[0]}


def test_furniture_does_not_split_a_room() -> None:
    room = box_room((0, 0, 0), (7, 5, 2.6))
    shelf = box_room((3.4, 0.0, 0.0), (0.4, 3.6, 1.6))
    _, labels = _labels(np.concatenate([room, shelf]))
    assert labels.max() == 0


def test_a_row_of_pillars_does_not_divide_a_hall() -> None:
    hall = [box_room((0, 0, 0), (14, 10, 2.6))]
    hall += [box_room((2 + 2.4 * i, 5.0, 0), (0.4, 0.4, 2.6)) for i in range(5)]
    _, labels = _labels(np.concatenate(hall))
    assert labels.max() == 0


def test_the_rim_of_what_was_seen_divides_no_room() -> None:
    room = box_room((0, 0, 0), (9, 5, 2.6))
    # A scanner near one end saw the floor of the other end in rings that touch nowhere.
    ring = np.floor(room[:, 0] / 0.8) % 2 == 0
    seen = (room[:, 0] < 3.0) | (room[:, 2] > 0.3) & (room[:, 2] < 2.5) | ring
    _, labels = _labels(room[seen])
    assert labels.max() == 0


def test_a_low_room_still_has_walls() -> None:
    points = _two_rooms()
    _, labels = _labels(points * (1.0, 1.0, 2.15 / 2.6))
    assert labels.max() == 1


@pytest.mark.parametrize("yaw", [0.5236, 1.0])
def test_rooms_do_not_depend_on_the_yaw(yaw: float) -> None:
    points = _offices()
    _, labels, cell = _segmented(points)
    _, turned, turned_cell = _segmented(moved(points, yaw_transform(yaw, (3.3, -7.7, 0.0))))
    assert _agreement(labels[cell], turned[turned_cell]) >= 0.9


def test_rooms_do_not_depend_on_a_translation_by_whole_voxels() -> None:
    points = np.round(_offices(2) / 0.01) * 0.01 + 0.005
    grid, labels = _labels(points)
    shift = np.array([128, -384, 0])
    moved_grid, moved_labels = _labels(points + shift * RASTER)
    order = np.lexsort(grid.coords.T)
    moved_order = np.lexsort(moved_grid.coords.T)
    assert np.array_equal(grid.coords[order] + shift, moved_grid.coords[moved_order])
    assert np.array_equal(labels[order], moved_labels[moved_order])


def test_a_sloped_roof_is_no_wall() -> None:
    points = box_room((0, 0, 0), (8, 5, 2.6))
    side = points[points[:, 2] < 2.0]
    u, v = np.meshgrid(np.arange(0, 3.5, 0.04), np.arange(0, 5, 0.04))
    roof = np.stack([u.ravel(), v.ravel(), 1.2 + 0.4 * u.ravel()], -1)
    flat = points[(points[:, 2] > 2.59) & (points[:, 0] > 3.5)]
    cloud = np.concatenate([side, roof, flat])
    walls = []
    for sloped in (True, False):
        grid, cell_of_point = voxelise(cloud, RASTER, np.zeros(3))
        heights = np.bincount(cell_of_point, weights=cloud[:, 2]) / np.bincount(cell_of_point)
        everything = np.ones(len(grid), bool)
        raster = storey_raster(
            sort_columns(grid.coords),
            heights,
            everything,
            StoreyHeights(0.0, 2.6, True),
            WallsConfig(smallest_count=1, sloped_roofs=sloped),
        )
        inside = np.s_[MARGIN + 15 : MARGIN + 30, MARGIN + 8 : MARGIN + 42]
        walls.append(raster.wall[inside].mean())
    assert walls[0] < 0.05
    assert walls[1] > 0.3


def _staircase() -> NDArray[np.float64]:
    """A room of 6 m x 4 m; a flight climbs through its ceiling, a wall of 1.2 m stands beside."""
    room = box_room((0, 0, 0), (6, 4, 2.6))
    x, y = (g.ravel() for g in np.meshgrid(np.arange(1, 5, 0.04), np.arange(1.4, 2.6, 0.04)))
    open_ = (room[:, 2] > 2.5) & (np.abs(room[:, 0] - 3) < 2) & (np.abs(room[:, 1] - 2) < 0.6)
    rise = 0.2 * np.floor((x - 1) / 0.25)
    parts = [
        np.stack([x, y, z], -1) for z in (rise, np.maximum(rise - 0.2, 0), np.full(len(x), 5.6))
    ]
    v, h = (g.ravel() for g in np.meshgrid(np.arange(3, 4.2, 0.04), np.arange(0, 2.6, 0.04)))
    parts += [np.stack([v, np.full(len(v), side), h], -1) for side in (2.7, 2.8)]
    return np.concatenate([room[~open_], *parts])


def test_a_flight_of_stairs_is_no_wall_nor_is_what_stands_alone_beside_it() -> None:
    cloud = _staircase()
    grid, cell_of_point = voxelise(cloud, RASTER, np.zeros(3))
    heights = np.bincount(cell_of_point, weights=cloud[:, 2]) / np.bincount(cell_of_point)
    columns = sort_columns(grid.coords)
    storey, members = StoreyHeights(0.0, 2.6, True), heights < 2.7
    inside = np.s_[MARGIN + 5 : MARGIN + 55, MARGIN + 5 : MARGIN + 35]
    for config, expected in (
        (WallsConfig(), 0),
        (WallsConfig(beside_stairs=0.0), 12 * 2),
        (WallsConfig(beside_stairs=0.0, sloped_roofs=False), 12 * 2 + 3 * 12),
    ):
        wall = storey_raster(columns, heights, members, storey, config).wall[inside]
        assert expected <= np.count_nonzero(wall) <= 1.6 * expected


def test_an_attic_under_a_pitched_roof_is_one_room() -> None:
    x, y = (g.ravel() for g in np.meshgrid(np.arange(0, 8, 0.04), np.arange(0, 9, 0.04)))
    height = 0.5 + np.minimum(y, 9 - y) * 0.7
    floor = np.stack([x, y, np.zeros(x.size)], -1)
    roof = np.stack([x, y, height], -1)
    gables = []
    for side in (0.0, 8.0):
        v, h = (g.ravel() for g in np.meshgrid(np.arange(0, 9, 0.04), np.arange(0, 4.5, 0.04)))
        under = h < 0.5 + np.minimum(v, 9 - v) * 0.7
        gables.append(np.stack([np.full(v.size, side), v, h], -1)[under])
    grid, labels = _labels(moved(np.concatenate([floor, roof, *gables]), yaw_transform(0.3)))
    assert np.bincount(labels + 1).max() > 0.97 * len(grid)


def test_what_lies_far_from_every_room_belongs_to_none() -> None:
    wall = np.stack(np.meshgrid([12.0], np.arange(0, 3, 0.05), np.arange(0, 2.6, 0.05)), -1)
    room = box_room((0, 0, 0), (5, 4, 2.6))
    grid, labels = _labels(np.concatenate([room, wall.reshape(-1, 3)]))
    outside = grid.centres()[:, 0] > 11
    assert (labels[outside] == -1).all()
    assert (labels[~outside] == 0).all()


def test_a_watershed_meets_at_the_narrowing() -> None:
    distance = np.minimum(np.abs(np.arange(30) - 15) + 1.0, 4.0)[:, None] * np.ones((1, 9))
    domain = np.zeros((30, 9), bool)
    domain[2:-2, 2:-2] = True
    seeds = np.zeros((30, 9), np.int32)
    seeds[5, 4], seeds[25, 4] = 1, 2
    labels = watershed(distance, domain, seeds)
    assert (labels[2:15, 4] == 1).all()
    assert (labels[16:28, 4] == 2).all()
    assert not labels[~domain].any()


def test_a_plateau_is_one_marker() -> None:
    distance = np.zeros((12, 20))
    distance[3:9, 3:17] = 2.0
    distance[5:7, 4:16] = 5.0
    assert markers(distance, distance > 0, 3.0).max() == 1


def test_a_doorway_has_wall_beyond_its_ends_and_little_to_see_through() -> None:
    wall = np.zeros((70, 50), bool)
    wall[MARGIN, :], wall[-MARGIN, :], wall[:, MARGIN], wall[:, -MARGIN] = True, True, True, True
    wall[35, :20], wall[35, 29:] = True, True
    inside = np.zeros_like(wall)
    inside[MARGIN:-MARGIN, MARGIN:-MARGIN] = True
    pieces = np.zeros(wall.shape, np.int32)
    pieces[MARGIN + 1 : 35, MARGIN + 1 : -MARGIN] = 1
    pieces[35:-MARGIN, MARGIN + 1 : -MARGIN] = 2
    pieces[wall] = 0
    x, y = np.nonzero(wall)
    grid = np.stack(np.meshgrid(np.arange(70), np.arange(50), indexing="ij"), -1)
    distance = np.sqrt(((grid[:, :, None] - np.stack([x, y], -1)) ** 2).sum(-1).min(-1))
    raster = StoreyRaster(np.zeros(2, np.int64), inside, wall, inside & ~wall, distance, distance)
    features = pair_features(raster, pieces, 7, 120.0)
    assert (features.a.tolist(), features.b.tolist()) == ([0], [1])
    assert features.saddle[0] == pytest.approx(4.5, abs=0.6)
    assert features.line[0] == 1.0
    assert features.seen[0, 0] == features.pairs[0, 0]
    assert 0 < features.seen[0, 1] < 0.7 * features.pairs[0, 1]
    assert (features.seen == features.seen.T).all()


def test_labels_reach_no_farther_than_asked() -> None:
    labels = np.zeros((1, 20), np.int32)
    labels[0, 0] = 7
    assert extended(labels, 5.0).sum() == 6 * 7


@pytest.mark.parametrize("yaw", [0.0, 0.4, 0.7])
def test_each_face_of_a_thin_wall_belongs_to_the_room_it_bounds(yaw: float) -> None:
    left = box_room((0, 0, 0), (4, 3, 2.6), (("x+", 1.5),))
    right = box_room((4.1, 0, 0), (3, 3, 2.6), (("x-", 1.5),))
    points = moved(np.concatenate([left, right]), yaw_transform(yaw, (0.03, 0.04, 0.0)))
    grid, cell_of_point = voxelise(points, RASTER, np.zeros(3))
    labels = _point_labels(points, grid, cell_of_point)
    ours, theirs = labels[: len(left)], labels[len(left) :]
    wall = np.abs(left[:, 0] - 4.0) < 0.01
    assert labels.max() == 1
    assert np.mean(ours[wall] == np.bincount(ours).argmax()) > 0.93
    assert np.mean(theirs == np.bincount(theirs).argmax()) > 0.97


def test_what_was_seen_behind_a_wall_belongs_to_a_room_in_sight_or_to_none() -> None:
    regions, wall = np.zeros((20, 20), np.int32), np.zeros((20, 20), bool)
    regions[2:8], regions[16:18, 5:15] = 1, 2
    wall[8] = True
    # On the wall's far side, at it, and nearer to the room beyond it than to that on its own side.
    places = np.array([(9.0, 10.0), (8.0, 10.0), (11.5, 10.0), (11.5, 1.0)])
    upright = np.ones(len(places), bool)
    assert label_points(regions, wall, places, upright, 20.0).tolist() == [1, 1, 2, 2]
    assert label_points(regions, wall, places, upright, 5.0).tolist() == [1, 1, 2, 0]
