"""Rooms of two aligned maps that are the same place, split ones included."""

from __future__ import annotations

import dataclasses

import numpy as np

from test.helpers_io import random_map
from topometric_ros.fusion.overlap import same_rooms, shared_voxels
from topometric_ros.topometric_map import TopometricMap


def with_rooms(m: TopometricMap, *sizes: int) -> TopometricMap:
    """Return the map with rooms 0, 1, ... of so many voxels each, in the voxels' order."""
    numbers = np.repeat(np.arange(len(sizes)), sizes)
    room = np.full(len(m.voxels), -1, np.int32)
    room[: len(numbers)] = numbers
    rooms = tuple(dataclasses.replace(m.rooms[0], id=number) for number in range(len(sizes)))
    return dataclasses.replace(m, room=room, rooms=rooms, passages=(), descriptors=())


def test_a_room_that_one_map_splits_is_matched_with_its_best_piece_then_the_others():
    m = random_map(voxels=500)
    a, b = with_rooms(m, 300, 100), with_rooms(m, 180, 110, 110)
    rows_a, rows_b, overlap = shared_voxels(a, b, np.eye(4))
    assert overlap == 1.0
    assert same_rooms(a, b, rows_a, rows_b, 0.5) == [(0, 0), (1, 2)]
    assert same_rooms(a, b, rows_a, rows_b, 0.5, 0.05) == [(0, 0), (1, 2), (0, 1)]


def test_a_piece_that_shares_little_of_the_smaller_room_is_not_the_same_place():
    m = random_map(voxels=500)
    a, b = with_rooms(m, 200, 200), with_rooms(m, 210, 190)
    rows_a, rows_b, _ = shared_voxels(a, b, np.eye(4))
    assert same_rooms(a, b, rows_a, rows_b, 0.5, 0.05) == [(0, 0), (1, 1)]


def test_a_shred_seen_through_a_door_is_no_piece():
    m = random_map(voxels=500)
    a, b = with_rooms(m, 300, 100), with_rooms(m, 285, 15, 100)
    rows_a, rows_b, _ = shared_voxels(a, b, np.eye(4))
    assert same_rooms(a, b, rows_a, rows_b, 0.5, 0.05) == [(0, 0), (1, 2)]
