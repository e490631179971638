"""Votes, label propagation and the split make rooms of clusters of views (§4.2.8)."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from test.helpers_voxels import block, quarter_turn, scattered
from test.test_visibility import sets_of
from topometric_ros.extraction.propagation import (
    PropagationConfig,
    propagate_labels,
    split_rooms,
    vote,
)
from topometric_ros.topometric_map import NO_ROOM
from topometric_ros.voxels.grid import in_morton_order

CONFIG = PropagationConfig()


def test_a_voxel_belongs_to_the_cluster_with_most_views_of_it() -> None:
    sets = sets_of([[0, 1, 70], [0, 2], [0, 1, 2], [2, 70]], 100)
    label = vote(sets, np.array([0, 1, 1, 2], np.int32))
    # Voxel 1 and 70 are seen once by each of two clusters: the lowest wins.
    assert label[[0, 1, 2, 70, 99]].tolist() == [1, 0, 1, 0, NO_ROOM]


def step_by_step(coords: np.ndarray, labels: np.ndarray) -> np.ndarray:
    """One round of Algorithm 6 with plain dictionaries, ties to the lowest label."""
    at = dict(zip(map(tuple, coords.tolist()), labels.tolist(), strict=True))
    near = [c for c in block((-2, -2, -2), (2, 2, 2)).tolist() if np.dot(c, c) <= 4]
    result = []
    for cell, own in at.items():
        around = (tuple(np.add(cell, n)) for n in near)
        count = Counter(at[a] for a in around if at.get(a, NO_ROOM) != NO_ROOM)
        most = max(count.values(), default=0)
        best = min((k for k, v in count.items() if v == most), default=own)
        result.append(best if most > count[own] else own)
    return np.array(result)


@pytest.mark.parametrize("seed", [1, 2])
def test_each_step_is_that_of_algorithm_6(seed: int) -> None:
    coords = scattered(seed, 400, 5)
    labels = np.random.default_rng(seed).integers(-1, 4, len(coords)).astype(np.int32)
    expected = labels
    for steps in range(1, 4):
        expected = step_by_step(coords, expected)
        found = propagate_labels(coords, labels, PropagationConfig(iterations=steps))
        assert found.tolist() == expected.tolist()


def test_an_island_is_absorbed_and_a_straight_border_stays() -> None:
    coords = in_morton_order(block((0, 0, 0), (19, 19, 0)))
    labels = (coords[:, 0] >= 10).astype(np.int32)
    clean = propagate_labels(coords, labels, CONFIG)
    assert clean.tolist() == labels.tolist()
    noisy = np.where((coords[:, 0] == 4) & (coords[:, 1] == 9), 7, labels).astype(np.int32)
    assert propagate_labels(coords, noisy, CONFIG).tolist() == labels.tolist()


def test_a_checkerboard_that_would_flip_for_ever_ends() -> None:
    coords = in_morton_order(block((0, 0, 0), (1, 1, 0)))
    labels = ((coords[:, 0] + coords[:, 1]) % 2).astype(np.int32)
    adjacent = PropagationConfig(radius=1.0, iterations=1000)
    once = propagate_labels(coords, labels, PropagationConfig(radius=1.0, iterations=1))
    assert once.tolist() == (1 - labels).tolist()
    assert propagate_labels(coords, labels, adjacent).tolist() == [0, 0, 0, 0]


def test_voxels_without_a_label_take_what_is_next_to_them() -> None:
    coords = in_morton_order(block((0, 0, 0), (30, 0, 0)))
    labels = np.where(coords[:, 0] < 3, 5, NO_ROOM).astype(np.int32)
    found = propagate_labels(coords, labels, PropagationConfig(iterations=3))
    assert (found == 5).tolist() == (coords[:, 0] < 9).tolist()


def test_propagation_turns_and_moves_with_the_map() -> None:
    coords = scattered(6, 500, 6)
    labels = np.random.default_rng(6).integers(-1, 5, len(coords)).astype(np.int32)
    expected = propagate_labels(coords, labels, CONFIG)
    turned = propagate_labels(quarter_turn(coords) + np.int32(40), labels, CONFIG)
    assert turned.tolist() == expected.tolist()


def test_rooms_are_connected_parts_numbered_by_size() -> None:
    coords = in_morton_order(block((0, 0, 0), (19, 0, 0)))
    x = coords[:, 0]
    labels = np.select([x < 4, x < 9, x < 12], [0, 1, 0], NO_ROOM).astype(np.int32)
    rooms = split_rooms(coords, labels, CONFIG)
    expected = np.select([x < 4, x < 9, x < 12], [1, 0, 2], NO_ROOM)
    assert rooms.tolist() == expected.tolist()
    large = split_rooms(coords, labels, PropagationConfig(smallest_room=4))
    assert large.tolist() == np.where(expected == 2, NO_ROOM, expected).tolist()
