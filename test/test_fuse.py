"""What fusing does to the navigable volume."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from scipy import ndimage

from test.helpers import yaw_transform
from test.helpers_matching import A_ROOMS, T_BUILDING_A, agent_map
from topometric_ros.fusion.fuse import FuseConfig, fuse
from topometric_ros.voxels.grid import in_morton_order


@pytest.mark.parametrize("degrees", [30.0, 45.0])
def test_a_turned_floor_has_no_holes_and_does_not_grow(degrees: float) -> None:
    a = agent_map("a", A_ROOMS, T_BUILDING_A)
    square = np.stack(np.meshgrid(range(40), range(40), [0], indexing="ij"), axis=-1)
    floor = dataclasses.replace(a, navigable=in_morton_order(square.reshape(-1, 3)))
    nothing = dataclasses.replace(a, navigable=np.empty((0, 3), np.int32))
    T = yaw_transform(np.radians(degrees), (0.03, 0.07, 0.0))
    turned = fuse([nothing, floor], [np.eye(4), T], FuseConfig()).map.navigable
    filled = np.zeros(np.ptp(turned[:, :2], axis=0) + 1, dtype=bool)
    filled[tuple((turned[:, :2] - turned[:, :2].min(axis=0)).T)] = True
    np.testing.assert_array_equal(ndimage.binary_fill_holes(filled), filled)
    assert filled.sum() == pytest.approx(1600, rel=0.05)
