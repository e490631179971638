"""Passages: where the navigable parts of two rooms meet (thesis §4.2.9, Algorithm 7)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.topometric_map import NO_ROOM, Passage
from topometric_ros.voxels.components import connected_components
from topometric_ros.voxels.grid import VoxelGrid, in_morton_order
from topometric_ros.voxels.index import VoxelIndex, row_at
from topometric_ros.voxels.kernels import Kernel, connectivity, kernel_of


@dataclass(frozen=True)
class PassageConfig:
    """When two rooms count as connected; the defaults are the thesis' values."""

    connectivity: str = parameter(
        "6", "Neighbourhood in which navigable voxels of two rooms meet.", choices=("6", "26")
    )
    step: float = parameter(
        0.2,
        "Difference of height that an agent steps over; the dilation of the navigable volume.",
        unit="m",
        minimum=0.0,
        maximum=1.0,
    )
    smallest_contact: int = parameter(
        1, "Fewest adjacent pairs of voxels that make a passage.", unit="pairs", minimum=1
    )
    clearance: float = parameter(
        0.3,
        "Width of the agent: navigable voxels keep half of it from walls on either side.",
        unit="m",
        minimum=0.0,
        maximum=2.0,
    )


def find_passages(
    grid: VoxelGrid,
    room: NDArray[np.int32],
    navigable: NDArray[np.int32],
    config: PassageConfig,
) -> tuple[Passage, ...]:
    """Return one passage for every place where two rooms' navigable voxels are adjacent.

    Two rooms may share several passages: adjacent pairs of voxels form one passage as long as they
    hang together (26-neighbourhood, and `step` in height). Its position is the centroid of the
    middles of those pairs; its width is their horizontal extent along its main direction and the
    agent's width (at least a voxel), because navigable voxels keep away from door jambs.

    Parameters
    ----------
    grid : the occupied voxels
    room : (N,) int32, the room of each voxel, NO_ROOM for none
    navigable : (M, 3) int32, cells of the grid
    config : adjacency and the smallest contact

    Returns
    -------
    passages ordered by their rooms' ids, then the largest contact first; positions in m, level
    frame
    """
    rows = VoxelIndex(grid.coords).rows(navigable)
    label = np.where(rows >= 0, room[rows], NO_ROOM).astype(np.int32)
    rise = math.floor(config.step / grid.voxel_size + 0.5)
    pairs = _adjacent(
        VoxelIndex(navigable).table, navigable, label, _half(_steps(config.connectivity, rise))
    )
    if len(pairs) == 0:
        return ()
    # A contact's voxels are told apart by doubling the lattice: a pair's middle is a cell there.
    middles = navigable[pairs[:, 0]] + navigable[pairs[:, 1]]
    rooms = np.sort(label[pairs], axis=1)
    passages = []
    for pair in np.unique(rooms, axis=0):
        middle = in_morton_order(middles[(rooms == pair).all(1)])
        group = connected_components(middle, _middle_steps(rise))
        for g in range(group.max() + 1):
            contact = middle[group == g] * 0.5
            if len(contact) >= config.smallest_contact:
                passages.append(_passage(pair, contact, grid, config))
    return tuple(passages)


def _steps(name: str, rise: int) -> NDArray[np.int32]:
    """Return a neighbourhood whose horizontal neighbours may lie `rise` cells up or down."""
    offsets = connectivity(name).offsets()
    flat = np.unique(offsets[(offsets[:, :2] != 0).any(1)] * (1, 1, 0), axis=0)
    tall = [flat + (0, 0, z) for z in range(-rise, rise + 1)]
    return np.unique(np.concatenate([offsets, *tall]), axis=0).astype(np.int32)


def _half(offsets: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return one of each two opposite offsets, so that every pair is met once."""
    x, y, z = offsets.T
    return offsets[(x > 0) | ((x == 0) & (y > 0)) | ((x == 0) & (y == 0) & (z > 0))]


def _middle_steps(rise: int) -> Kernel:
    """Return the neighbourhood of pairs' middles: a cell is two wide on the doubled lattice."""
    high = 2 * max(rise, 1)
    flat, tall = np.arange(-2, 3), np.arange(-high, high + 1)
    offsets = np.stack(np.meshgrid(flat, flat, tall, indexing="ij"), -1).reshape(-1, 3)
    return kernel_of(offsets)


@njit(cache=True, nogil=True)
def _adjacent(table, coords, label, offsets):  # type: ignore[no-untyped-def]
    """Pairs of adjacent voxels in two different rooms: (P, 2) int64."""
    pairs = []
    for i in range(len(coords)):
        if label[i] < 0:
            continue
        for k in range(len(offsets)):
            j = row_at(
                table,
                coords[i, 0] + offsets[k, 0],
                coords[i, 1] + offsets[k, 1],
                coords[i, 2] + offsets[k, 2],
            )
            if j >= 0 and label[j] >= 0 and label[j] != label[i]:
                pairs.append((i, j))
    result = np.empty((len(pairs), 2), np.int64)
    for p in range(len(pairs)):
        result[p, 0], result[p, 1] = pairs[p]
    return result


def _passage(
    pair: NDArray[np.int32],
    contact: NDArray[np.float64],
    grid: VoxelGrid,
    config: PassageConfig,
) -> Passage:
    """Return the passage of a contact, (C, 3) float64 middles of voxel pairs in cells."""
    points = contact * grid.voxel_size
    centre = points.mean(0)
    flat = points[:, :2] - centre[:2]
    _, axes = np.linalg.eigh(flat.T @ flat)
    extent = float(np.ptp(flat @ axes[:, -1]))
    x, y, z = (grid.origin + centre).tolist()
    width = extent + max(config.clearance, grid.voxel_size)
    return Passage(rooms=(int(pair[0]), int(pair[1])), position=(x, y, z), width=width)
