"""Small voxel scenes that the tests of the voxel and extraction stages share."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from test.helpers import box_room
from topometric_ros.voxels.grid import VoxelGrid, in_morton_order, voxelise


def grid_of(coords: NDArray[np.integer], voxel_size: float = 0.1) -> VoxelGrid:
    """Return a grid of the given cells on a lattice whose origin is the frame's."""
    return VoxelGrid(in_morton_order(np.asarray(coords).reshape(-1, 3)), np.zeros(3), voxel_size)


def block(low: tuple[int, int, int], high: tuple[int, int, int]) -> NDArray[np.int32]:
    """Return all cells from `low` to `high`, both included: (N, 3) int32."""
    lines = [np.arange(a, b + 1, dtype=np.int32) for a, b in zip(low, high, strict=True)]
    return np.stack(np.meshgrid(*lines, indexing="ij"), -1).reshape(-1, 3)


def quarter_turn(coords: NDArray[np.integer]) -> NDArray[np.int32]:
    """Return cells turned by 90 degrees about z: (x, y, z) to (-y, x, z)."""
    coords = np.asarray(coords)
    return np.stack([-coords[:, 1], coords[:, 0], coords[:, 2]], 1).astype(np.int32)


def scattered(seed: int, count: int, reach: int) -> NDArray[np.int32]:
    """Return random distinct cells within `reach` of the origin, in Morton order."""
    rng = np.random.default_rng(seed)
    return in_morton_order(rng.integers(-reach, reach + 1, (count, 3)))


def as_set(coords: NDArray[np.integer]) -> set[tuple[int, ...]]:
    """Return cells as a set of tuples."""
    return {tuple(c) for c in np.asarray(coords).tolist()}


def two_rooms_with_a_door(voxel_size: float = 0.1) -> VoxelGrid:
    """Return two rooms side by side along x, joined by a 0.9 m door at (4.0, 1.5).

    Their walls stand a voxel apart, so that their floors touch.
    """
    points = np.concatenate(
        [
            box_room((0.0, 0.0, 0.0), (4.0, 3.0, 2.6), (("x+", 1.5),)),
            box_room((4.0 + voxel_size, 0.0, 0.0), (4.0, 3.0, 2.6), (("x-", 1.5),)),
        ]
    )
    return voxelise(points, voxel_size, np.zeros(3))[0]
