"""What a storey's bird's-eye rasters say of walls, furniture and free floor."""

from __future__ import annotations

import numpy as np
import pytest

from test.helpers import box_room, moved, yaw_transform
from topometric_ros.extraction.layers import (
    CELL,
    LayersConfig,
    LayersError,
    refine_floor,
    storey_layers,
)
from topometric_ros.voxels.grid import thin

CONFIG = LayersConfig()


def value_at(layers, mask, x, y):
    i, j = (round((v - o) / CELL) for v, o in zip((x, y), layers.origin, strict=True))
    return bool(mask[i, j])


@pytest.fixture
def furnished_room():
    room = box_room((0.0, 0.0, 0.0), (5.0, 4.0, 2.6), (("x+", 2.0),))
    x, y, z = np.meshgrid(*[np.arange(0.0, e, 0.05) for e in (0.8, 0.8, 0.75)], indexing="ij")
    table = np.stack([x, y, z], -1).reshape(-1, 3) + (2.0, 1.5, 0.05)
    return thin(np.concatenate([room, table]), 0.05)


def test_walls_furniture_and_floor_are_told_apart(furnished_room):
    (layers,) = storey_layers(furnished_room, [0.0], CONFIG)
    assert value_at(layers, layers.wall, 0.0, 2.0)
    assert not value_at(layers, layers.wall, 5.0, 2.0), "a doorway is no wall"
    assert value_at(layers, layers.furniture, 2.4, 1.9)
    assert value_at(layers, layers.free, 1.0, 1.0)
    assert value_at(layers, layers.bare, 1.0, 1.0)
    assert not value_at(layers, layers.bare, 2.4, 1.9), "a table stands there"


def test_no_free_cell_touches_a_wall(furnished_room):
    (layers,) = storey_layers(furnished_room, [0.0], CONFIG)
    x, y = np.nonzero(layers.wall)
    for dx in (-1, 0, 1):
        for dy in (-1, 0, 1):
            inside = (x + dx >= 0) & (y + dy >= 0)
            inside &= (x + dx < layers.wall.shape[0]) & (y + dy < layers.wall.shape[1])
            assert not layers.free[x[inside] + dx, y[inside] + dy].any()


def test_growing_the_map_keeps_its_cells_on_the_same_lattice(furnished_room):
    (before,) = storey_layers(furnished_room, [0.0], CONFIG)
    more = np.concatenate([furnished_room, box_room((-7.3, -3.1, 0.0), (4.0, 3.0, 2.6))])
    (after,) = storey_layers(more, [0.0], CONFIG)
    shift = (np.array(before.origin) - after.origin) / CELL
    assert np.allclose(shift, np.rint(shift), atol=1e-6)
    i, j = np.rint(shift).astype(int)
    nx, ny = before.wall.shape
    assert (after.wall[i : i + nx, j : j + ny] >= before.wall).all()


def test_the_floor_is_the_upper_face_of_its_slab(furnished_room):
    underside = furnished_room[np.abs(furnished_room[:, 2]) < 0.02] - (0.0, 0.0, 0.09)
    points = np.concatenate([furnished_room, underside, underside + (0.025, 0.0, 0.0)])
    assert refine_floor(points, -0.05, CONFIG) == pytest.approx(0.0, abs=0.02)


def test_storeys_do_not_see_each_other():
    below = box_room((0.0, 0.0, 0.0), (5.0, 4.0, 2.6))
    above = box_room((0.0, 0.0, 2.9), (3.0, 4.0, 2.6))
    layers = storey_layers(np.concatenate([below, above]), [0.0, 2.9], CONFIG)
    assert layers[0].wall.sum() > layers[1].wall.sum() * 1.15
    assert value_at(layers[0], layers[0].free, 4.0, 2.0)


def test_a_storey_without_points_has_empty_layers():
    points = moved(box_room((0.0, 0.0, 0.0), (5.0, 4.0, 2.6)), yaw_transform(0.3))
    (layers,) = storey_layers(points, [50.0], CONFIG)
    assert layers.wall.shape == (1, 1)
    assert not layers.free.any()


def test_a_point_far_outside_the_building_is_named():
    points = np.concatenate([box_room((0.0, 0.0, 0.0), (5.0, 4.0, 2.6)), [[9e3, 9e3, 0.0]]])
    with pytest.raises(LayersError, match=r"900. m x 900. m"):
        storey_layers(points, [0.0], CONFIG)


def test_a_sloping_floor_stays_free_floor_but_a_step_is_no_floor():
    hall = box_room((0.0, 0.0, 0.0), (12.0, 3.0, 2.6))
    sloping = hall + np.stack([np.zeros(len(hall))] * 2 + [hall[:, 0] * 0.025 - 0.03], -1)
    (layers,) = storey_layers(thin(sloping, 0.05), [0.0], CONFIG)
    assert value_at(layers, layers.bare, 0.5, 1.5)
    assert value_at(layers, layers.bare, 11.5, 1.5), "0.27 m higher than where it begins"
    podium = box_room((12.1, 0.0, 0.28), (4.0, 3.0, 2.3))
    (layers,) = storey_layers(thin(np.concatenate([hall, podium]), 0.05), [0.0], CONFIG)
    assert not value_at(layers, layers.free, 14.0, 1.5)
