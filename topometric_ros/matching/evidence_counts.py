"""Counting cells of one storey that agree or conflict with another's at a pose; see `evidence`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.matching.search_fields import CELL, StoreyFields
from topometric_ros.matching.search_poses import Pose

_NEAR = 1.5
"""Cells within which a wall stands on a wall, or furniture on furniture."""

_LEAF = 1.1
"""Longest clump of conflicting wall (m) that may be a door's leaf, open in one map only."""

_AROUND = np.ones((3, 3), dtype=bool)

_IN_FRONT = (3, 4, 5)
"""Cells in front of a wall, on its free side: where two of them are free, it was in plain view."""

_THERE, _ABSENT = 2.0, 3.0
"""Cells to the nearest wall up to which a wall in plain view is there, and past which it is not."""


@dataclass(frozen=True)
class Counts:
    """Cells of one map judged in the other's tables."""

    smallest_eigenvalue: float
    agree: int
    conflict: int
    same_side: int
    free: int
    furniture_agree: int
    furniture_conflict: int
    in_view: int
    absent: int

    @property
    def furniture_judged(self) -> int:
        return self.furniture_agree + self.furniture_conflict


def count_cells(a: StoreyFields, b: StoreyFields, pose: Pose, depth: float) -> NDArray[np.float64]:
    """Return two storeys' counts in the order of `Counts`, then Σ n nᵀ (xx, xy, yy): (11,)."""
    c, s = np.cos(pose.yaw), np.sin(pose.yaw)
    start = (np.array([pose.x, pose.y]) - a.origin) / CELL
    walls = _count_walls(
        a.wall_distance, a.side, a.free_depth, b.walls, b.wall_sides, c, s, start, depth
    )
    agree, conflict, same_side, xx, xy, yy = walls
    free = _count_free(a.kind, b.free, c, s, start)
    placed, displaced = _count_furniture(
        a.furniture_distance, a.bare_depth, b.furniture, c, s, start, depth
    )
    in_view, absent = _count_in_view(
        a.kind, a.wall_distance, b.walls, b.wall_sides, c, s, start, np.array(_IN_FRONT)
    )
    return np.array(
        [agree, conflict, same_side, free, placed, displaced, in_view, absent, xx, xy, yy], float
    )


@njit(cache=True, nogil=True)
def _count_walls(  # type: ignore[no-untyped-def]
    wall_distance, side, free_depth, walls, wall_sides, c, s, start, depth
):
    """Wall cells that agree, conflict, agree from the same side, and Σ n nᵀ of the last."""
    agree, conflict, same = 0, 0, 0
    xx, xy, yy = 0.0, 0.0, 0.0
    for w in range(len(walls)):
        i = int(np.floor((c * walls[w, 0] - s * walls[w, 1]) / CELL + start[0] + 0.5))
        j = int(np.floor((s * walls[w, 0] + c * walls[w, 1]) / CELL + start[1] + 0.5))
        if i < 0 or j < 0 or i >= wall_distance.shape[0] or j >= wall_distance.shape[1]:
            continue
        if wall_distance[i, j] <= _NEAR:
            agree += 1
            x = c * wall_sides[w, 0] - s * wall_sides[w, 1]
            y = s * wall_sides[w, 0] + c * wall_sides[w, 1]
            if x * side[i, j, 0] + y * side[i, j, 1] > 0.5:
                same += 1
                xx += x * x
                xy += x * y
                yy += y * y
        elif free_depth[i, j] >= depth:
            conflict += 1
    return agree, conflict, same, xx, xy, yy


def largest_leaf(a: StoreyFields, b: StoreyFields, pose: Pose, depth: float) -> int:
    """Return the conflicting wall cells of the largest clump that a door's leaf may be, or 0."""
    c, s = np.cos(pose.yaw), np.sin(pose.yaw)
    start = (np.array([pose.x, pose.y]) - a.origin) / CELL
    cells = _conflicting(a.wall_distance, a.free_depth, b.walls, c, s, start, depth)
    cells = cells[cells[:, 0] >= 0]
    if len(cells) == 0:
        return 0
    low = cells.min(axis=0) - 1
    image = np.zeros(tuple(cells.max(axis=0) - low + 2), dtype=np.int64)
    np.add.at(image, tuple((cells - low).T), 1)
    labels, _ = ndimage.label(ndimage.binary_dilation(image > 0, _AROUND), _AROUND)
    sizes = np.bincount(labels.ravel(), image.ravel()).astype(int)
    leaves = [
        sizes[k + 1]
        for k, box in enumerate(ndimage.find_objects(labels))
        # Dilation adds a cell on either side.
        if np.hypot(*(extent.stop - extent.start - 2 for extent in box)) * CELL <= _LEAF
    ]
    return max(leaves, default=0)


@njit(cache=True, nogil=True)
def _conflicting(  # type: ignore[no-untyped-def]
    wall_distance, free_depth, walls, c, s, start, depth
):
    """Cells of a's table in which a wall of b conflicts: (K, 2), -1 where it does not."""
    cells = np.full((len(walls), 2), -1)
    for w in range(len(walls)):
        i = int(np.floor((c * walls[w, 0] - s * walls[w, 1]) / CELL + start[0] + 0.5))
        j = int(np.floor((s * walls[w, 0] + c * walls[w, 1]) / CELL + start[1] + 0.5))
        if i < 0 or j < 0 or i >= wall_distance.shape[0] or j >= wall_distance.shape[1]:
            continue
        if wall_distance[i, j] > _NEAR and free_depth[i, j] >= depth:
            cells[w, 0], cells[w, 1] = i, j
    return cells


@njit(cache=True, nogil=True)
def _count_in_view(  # type: ignore[no-untyped-def]
    kind, wall_distance, walls, wall_sides, c, s, start, in_front
):
    """Wall cells in front of which the other map saw free floor, and those it has no wall for."""
    in_view, absent = 0, 0
    for w in range(len(walls)):
        nx, ny = wall_sides[w]
        if nx * nx + ny * ny < 0.25:
            continue
        free = 0
        for cells in in_front:
            x = walls[w, 0] + cells * CELL * nx
            y = walls[w, 1] + cells * CELL * ny
            i = int(np.floor((c * x - s * y) / CELL + start[0] + 0.5))
            j = int(np.floor((s * x + c * y) / CELL + start[1] + 0.5))
            if i >= 0 and j >= 0 and i < kind.shape[0] and j < kind.shape[1]:
                free += kind[i, j] == 1
        i = int(np.floor((c * walls[w, 0] - s * walls[w, 1]) / CELL + start[0] + 0.5))
        j = int(np.floor((s * walls[w, 0] + c * walls[w, 1]) / CELL + start[1] + 0.5))
        outside = i < 0 or j < 0 or i >= kind.shape[0] or j >= kind.shape[1]
        if free < 2 or outside:
            continue
        if wall_distance[i, j] <= _THERE:
            in_view += 1
        elif wall_distance[i, j] > _ABSENT:
            in_view += 1
            absent += 1
    return in_view, absent


@njit(cache=True, nogil=True)
def _count_free(kind, free, c, s, start):  # type: ignore[no-untyped-def]
    """Free cells that are free in the other map too."""
    count = 0
    for f in range(len(free)):
        i = int(np.floor((c * free[f, 0] - s * free[f, 1]) / CELL + start[0] + 0.5))
        j = int(np.floor((s * free[f, 0] + c * free[f, 1]) / CELL + start[1] + 0.5))
        inside = i >= 0 and j >= 0 and i < kind.shape[0] and j < kind.shape[1]
        if inside and kind[i, j] == 1:
            count += 1
    return count


@njit(cache=True, nogil=True)
def _count_furniture(  # type: ignore[no-untyped-def]
    distance, bare_depth, cells, c, s, start, depth
):
    """Furniture cells on the other map's furniture, and on its bare floor."""
    placed, displaced = 0, 0
    for f in range(len(cells)):
        i = int(np.floor((c * cells[f, 0] - s * cells[f, 1]) / CELL + start[0] + 0.5))
        j = int(np.floor((s * cells[f, 0] + c * cells[f, 1]) / CELL + start[1] + 0.5))
        if i < 0 or j < 0 or i >= distance.shape[0] or j >= distance.shape[1]:
            continue
        if distance[i, j] <= _NEAR:
            placed += 1
        elif bare_depth[i, j] >= depth:
            displaced += 1
    return placed, displaced
