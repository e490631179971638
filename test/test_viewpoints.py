"""Viewpoints stand at the local maxima of the horizontal distance field (§4.2.5-4.2.6)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from test.helpers_voxels import as_set, block, grid_of, quarter_turn, scattered
from topometric_ros.extraction.viewpoints import (
    ViewpointConfig,
    horizontal_distance_field,
    local_maxima,
    viewpoints,
)
from topometric_ros.voxels.grid import in_morton_order
from topometric_ros.voxels.index import VoxelIndex
from topometric_ros.voxels.kernels import circle, convolve

CONFIG = ViewpointConfig()


def by_growing_circles(navigable: np.ndarray) -> list[int]:
    """Algorithm 2 as it is written: circles are grown until one is not full."""
    result = []
    for cell in navigable:
        radius = 1
        while convolve(cell[None], None, circle(radius), "sum", VoxelIndex(navigable))[0] == len(
            circle(radius)
        ):
            radius += 1
        result.append(radius)
    return result


def blob(seed: int) -> np.ndarray:
    """Return a floor with holes, in Morton order."""
    holes = as_set(scattered(seed, 25, 12) * (1, 1, 0))
    floor = block((-12, -9, 0), (12, 9, 0))
    upper = block((-6, -6, 4), (6, 6, 4))
    return in_morton_order(np.array([c for c in floor.tolist() if tuple(c) not in holes] +
                                    upper.tolist()))  # fmt: skip


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_distance_field_is_what_growing_circles_give(seed: int) -> None:
    navigable = blob(seed)
    assert horizontal_distance_field(navigable).tolist() == by_growing_circles(navigable)


def test_the_middle_of_a_square_is_as_far_as_its_half_edge() -> None:
    navigable = in_morton_order(block((-4, -4, 0), (4, 4, 0)))
    distance = horizontal_distance_field(navigable)
    at = dict(zip(map(tuple, navigable.tolist()), distance.tolist(), strict=True))
    assert (at[0, 0, 0], at[3, 0, 0], at[4, 0, 0]) == (5, 2, 1)


def test_the_distance_field_turns_and_moves_with_the_map() -> None:
    navigable = blob(4)
    for step in (0, 1):
        distance = horizontal_distance_field(navigable, step)
        field = dict(zip(map(tuple, quarter_turn(navigable).tolist()), distance, strict=True))
        turned = in_morton_order(quarter_turn(navigable) + (31, -7, 2))
        again = horizontal_distance_field(turned, step)
        back = map(tuple, (turned - (31, -7, 2)).tolist())
        assert all(field[c] == d for c, d in zip(back, again.tolist(), strict=True))


def test_a_step_of_height_is_a_boundary_only_where_none_is_allowed() -> None:
    cells = block((-8, -8, 0), (8, 8, 0))
    cells[:, 2] = cells[:, 0] // 2  # a ramp
    ramp = in_morton_order(cells)
    assert horizontal_distance_field(ramp).max() <= 2
    stepped = horizontal_distance_field(ramp, 1)
    flat = horizontal_distance_field(in_morton_order(block((-8, -8, 0), (8, 8, 0))))
    assert sorted(stepped.tolist()) == sorted(flat.tolist())


def test_a_maximum_is_exceeded_by_nothing_within_the_radius() -> None:
    navigable = blob(5)
    distance = horizontal_distance_field(navigable)
    peak = local_maxima(navigable, distance, 3.0)
    near = ((navigable[:, None] - navigable[None]) ** 2).sum(-1) <= 9
    expected = (np.where(near, distance[None], 0).max(1)) <= distance
    assert peak.tolist() == expected.tolist()


def room(width: int, depth: int) -> tuple[np.ndarray, np.ndarray]:
    """Return the occupied and the navigable cells of a bare floor."""
    floor = in_morton_order(block((0, 0, 0), (width - 1, depth - 1, 0)))
    return floor, floor


def test_a_square_room_is_seen_from_its_middle_at_eye_height() -> None:
    floor, navigable = room(21, 21)
    points = viewpoints(navigable, grid_of(floor), CONFIG)
    np.testing.assert_allclose(points, [[1.0, 1.0, 1.5]])


def test_viewpoints_keep_their_spacing_and_zero_keeps_the_whole_plateau() -> None:
    floor, navigable = room(60, 11)
    thinned = viewpoints(navigable, grid_of(floor), CONFIG)
    every = viewpoints(navigable, grid_of(floor), replace(CONFIG, spacing=0.0))
    assert len(every) > 4 * len(thinned) > 0
    assert as_set(np.round(thinned * 10)) <= as_set(np.round(every * 10))
    apart = np.linalg.norm(thinned[:, None] - thinned[None], axis=-1)
    assert apart[~np.eye(len(thinned), dtype=bool)].min() > 0.5
    nearest = np.linalg.norm(every[:, None] - thinned[None], axis=-1).min(1)
    assert nearest.max() <= 0.5 + 1e-9


def test_a_hall_has_viewpoints_near_all_of_its_floor() -> None:
    floor, navigable = room(241, 161)
    places = grid_of(navigable).centres()

    def farthest(cover: float) -> tuple[int, float]:
        eyes = viewpoints(navigable, grid_of(floor), replace(CONFIG, cover=cover))
        away = np.linalg.norm(places[:, None, :2] - eyes[None, :, :2], axis=-1).min(1)
        return len(eyes), float(away.max())

    few, far = farthest(0.0)
    more, near = farthest(4.0)
    assert far > 8.0
    assert near < 4.0 + 0.8
    assert few < more < 3 * few


def test_a_viewpoint_keeps_off_the_boundary() -> None:
    floor, navigable = room(2, 30)
    assert len(viewpoints(navigable, grid_of(floor), CONFIG)) == 0
    assert len(viewpoints(navigable, grid_of(floor), replace(CONFIG, boundary=0))) > 0


@pytest.mark.parametrize(("low", "high", "expected"), [(15, 15, 1.6), (15, 17, 1.8)])
def test_an_eye_inside_something_is_raised_out_of_it(low: int, high: int, expected: float) -> None:
    floor, navigable = room(21, 21)
    grid = grid_of(np.concatenate([floor, block((5, 5, low), (15, 15, high))]))
    points = viewpoints(navigable, grid, CONFIG)
    np.testing.assert_allclose(points, [[1.0, 1.0, expected]])


def test_an_eye_that_cannot_be_raised_out_sees_nothing() -> None:
    floor, navigable = room(21, 21)
    grid = grid_of(np.concatenate([floor, block((0, 0, 12), (20, 20, 19))]))
    assert viewpoints(navigable, grid, CONFIG).shape == (0, 3)


def test_no_navigable_volume_has_no_viewpoints() -> None:
    empty = np.zeros((0, 3), np.int32)
    assert viewpoints(empty, grid_of(block((0, 0, 0), (1, 1, 1))), CONFIG).shape == (0, 3)
    assert len(horizontal_distance_field(empty)) == 0
