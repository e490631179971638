"""Contacts: where navigable voxels of two rooms are adjacent (thesis §4.2.9, Algorithm 7).

A contact becomes a passage. Two rooms may have several; they are told apart by what hangs together.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.voxels.components import connected_components
from topometric_ros.voxels.grid import VoxelGrid, in_morton_order
from topometric_ros.voxels.index import VoxelIndex, row_at
from topometric_ros.voxels.kernels import Kernel, connectivity, kernel_of

_TOUCH = 0.35
"""Contacts this near to each other, m, meet."""


@dataclass(frozen=True)
class Contact:
    """Where two rooms meet: `points` (C, 3), m, between the adjacent voxels of both."""

    rooms: tuple[int, int]
    points: NDArray[np.float64]

    def extent(self) -> float:
        """Return the horizontal extent along the contact's main direction, m."""
        flat = self.points[:, :2] - self.points[:, :2].mean(0)
        _, axes = np.linalg.eigh(flat.T @ flat)
        return float(np.ptp(flat @ axes[:, -1]))


def find_contacts(
    grid: VoxelGrid,
    navigable: NDArray[np.int32],
    label: NDArray[np.int32],
    neighbourhood: str,
    step: float,
    smallest: int,
) -> list[Contact]:
    """Return where navigable voxels of two rooms are adjacent, by rooms, the largest first.

    Parameters
    ----------
    grid : the lattice
    navigable : (M, 3) int32, cells
    label : (M,) int32, the room of each, -1 for none
    neighbourhood : "6" or "26"
    step : m, difference of height over which horizontal neighbours are adjacent
    smallest : fewest adjacent pairs of a contact
    """
    rise = math.floor(step / grid.voxel_size + 0.5)
    pairs = _adjacent(
        VoxelIndex(navigable).table, navigable, label, _half(steps(neighbourhood, rise))
    )
    if len(pairs) == 0:
        return []
    # A contact's voxels are told apart by doubling the lattice: a pair's middle is a cell there.
    middles = navigable[pairs[:, 0]] + navigable[pairs[:, 1]]
    rooms = np.sort(label[pairs], axis=1)
    found = []
    for pair in np.unique(rooms, axis=0):
        middle = in_morton_order(middles[(rooms == pair).all(1)])
        group = connected_components(middle, _middle_steps(rise))
        for g in range(group.max() + 1):
            own = middle[group == g]
            if len(own) >= smallest:
                points = grid.origin + own * (0.5 * grid.voxel_size)
                found.append(Contact((int(pair[0]), int(pair[1])), points))
    return found


def one_a_door(contacts: Sequence[Contact], door: float) -> list[Contact]:
    """Leave one contact of those that a room has in one door with rooms that meet there.

    A door that opens where two rooms beyond it meet makes a triangle of them (thesis §6.1). Of two
    contacts of one room that touch each other and span `door` (m) at most, the larger stays where
    the two rooms beyond also meet at that place.
    """
    ordered = sorted(contacts, key=lambda c: (-len(c.points), c.rooms))
    trees = [cKDTree(contact.points) for contact in ordered]
    gone: set[int] = set()

    def touch(i: int, j: int) -> bool:
        return bool(trees[i].query(ordered[j].points)[0].min() <= _TOUCH)

    def meet_there(rooms: set[int], i: int, j: int) -> bool:
        others = (k for k, c in enumerate(ordered) if set(c.rooms) == rooms and k not in gone)
        return any(touch(k, i) and touch(k, j) for k in others)

    middles = np.array([c.points.mean(axis=0) for c in ordered]).reshape(-1, 3)
    near = cKDTree(middles).query_pairs(door) if ordered else set()
    for i, j in sorted(near):
        rooms = set(ordered[i].rooms) ^ set(ordered[j].rooms)
        if len(rooms) != 2 or {i, j} & gone:
            continue
        points = np.concatenate([ordered[i].points, ordered[j].points])
        if Contact(ordered[i].rooms, points).extent() > door:
            continue
        if touch(i, j) and meet_there(rooms, i, j):
            gone.add(j)
    return [contact for i, contact in enumerate(ordered) if i not in gone]


def steps(name: str, rise: int) -> NDArray[np.int32]:
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
