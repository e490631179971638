"""One storey of a map seen from above: a raster of rooms, the walls, and where labels go."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.topometric_map import NO_ROOM, Storey, TopometricMap

UNSEEN = -2
"""Marks the cells of a plan in which the map holds no voxel."""


_WIDEST = 1_000_000


@dataclass(frozen=True)
class Plan:
    """A storey from above, in the map's level frame.

    `rooms` (nx, ny) int32: room id, `NO_ROOM` or `UNSEEN`; cell (i, j) is centred at
    `origin + cell * (i, j)`, m. `labels` says where a room's number reads best, by room id.
    """

    storey: Storey
    cell: float
    origin: tuple[float, float]
    rooms: NDArray[np.int32]
    labels: dict[int, tuple[float, float]]


def storey_plan(topometric_map: TopometricMap, storey: Storey) -> Plan:
    """Look at one storey of a map from above; each column shows the room most of it belongs to."""
    rows = _rows_of_storey(topometric_map, storey)
    size = topometric_map.voxel_size
    if not rows.any():
        empty = np.full((0, 0), UNSEEN, dtype=np.int32)
        return Plan(storey, size, topometric_map.origin[:2], empty, {})
    columns = topometric_map.voxels[rows, :2]
    low = columns.min(axis=0)
    shape = columns.max(axis=0) - low + 1
    raster = _majority(columns - low, topometric_map.room[rows], shape)
    raster = _fill_cracks(raster)
    origin = np.asarray(topometric_map.origin[:2]) + low * size
    labels = {
        room.id: _label_position(raster == room.id, origin, size)
        for room in topometric_map.rooms
        if room.storey == storey.id and (raster == room.id).any()
    }
    return Plan(storey, size, (float(origin[0]), float(origin[1])), raster, labels)


def storey_plans(topometric_map: TopometricMap) -> list[Plan]:
    """Return the plans of all storeys that hold voxels, lowest first."""
    storeys = sorted(topometric_map.storeys, key=lambda s: s.floor_z)
    plans = [storey_plan(topometric_map, storey) for storey in storeys]
    return [plan for plan in plans if plan.rooms.size]


def main_direction(topometric_map: TopometricMap) -> float:
    """Return the angle that most walls run along: rad in [0, pi/2), level frame.

    The walls are projected onto both axes of every half degree; where they are parallel to the
    axes they pile up, which the sum of squared counts tells.
    """
    cells = [
        np.argwhere(s.layers.wall) * s.layers.cell + s.layers.origin for s in topometric_map.storeys
    ]
    walls = np.concatenate([np.empty((0, 2)), *cells])
    angles = np.radians(np.arange(0.0, 90.0, 0.5))
    scores = []
    for angle in angles:
        axes = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]])
        bins = np.floor(walls @ axes / 0.1).astype(np.int64)
        scores.append(sum(int((_counts(bins[:, k]) ** 2).sum()) for k in (0, 1)))
    return float(angles[np.argmax(scores)])


def _counts(bins: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how often each number occurs, in no order."""
    low, high = (int(bins.min()), int(bins.max())) if len(bins) else (0, 0)
    if high - low > _WIDEST:  # Two walls far apart must not cost what lies between them.
        return np.unique(bins, return_counts=True)[1].astype(np.int64)
    return np.bincount(bins - low)


def _rows_of_storey(topometric_map: TopometricMap, storey: Storey) -> NDArray[np.bool_]:
    """Return which voxels lie on a storey: by their room, else by their height: (N,) bool."""
    storey_of_room = {room.id: room.storey for room in topometric_map.rooms}
    ids = np.unique(topometric_map.room)
    on_storey = [int(i) for i in ids if storey_of_room.get(int(i)) == storey.id]
    floors = sorted(s.floor_z for s in topometric_map.storeys)
    above = [z for z in floors if z > storey.floor_z]
    low = -np.inf if storey.floor_z == floors[0] else storey.floor_z - 0.3
    high = above[0] - 0.3 if above else np.inf
    z = topometric_map.origin[2] + topometric_map.voxels[:, 2] * topometric_map.voxel_size
    loose = (topometric_map.room == NO_ROOM) & (z >= low) & (z < high)
    return np.isin(topometric_map.room, on_storey) | loose


def _majority(
    columns: NDArray[np.int32], room: NDArray[np.int32], shape: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Return the most frequent room of each column, any room before none: (nx, ny) int32."""
    flat = columns[:, 0].astype(np.int64) * shape[1] + columns[:, 1]
    kinds = int(room.max()) + 2
    pairs, counts = np.unique(flat * kinds + room + 1, return_counts=True)
    column, winner = pairs // kinds, pairs % kinds - 1
    order = np.lexsort((-winner, counts, winner != NO_ROOM))
    raster = np.full(shape[0] * shape[1], UNSEEN, dtype=np.int32)
    raster[column[order]] = winner[order]
    return raster.reshape(shape[0], shape[1])


def _fill_cracks(raster: NDArray[np.int32]) -> NDArray[np.int32]:
    """Give unseen cells inside the plan, at most two cells from a seen one, their neighbour's."""
    seen = raster != UNSEEN
    inside = ndimage.binary_closing(np.pad(seen, 3), np.ones((3, 3)), iterations=2)[3:-3, 3:-3]
    nearest = ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True)
    filled = raster[tuple(nearest)]
    return np.where(inside & ~seen, filled, raster).astype(np.int32)


def _label_position(
    mask: NDArray[np.bool_], origin: NDArray[np.float64], cell: float
) -> tuple[float, float]:
    """Return where a room is widest, nearest to its middle where that is so in many places."""
    # A room covers a small part of a plan, and what lies outside its bounds is all the same.
    (part,) = ndimage.find_objects(mask.astype(np.int8))
    low = np.array([edge.start for edge in part])
    depth = ndimage.distance_transform_edt(np.pad(mask[part], 1))[1:-1, 1:-1]
    wide = np.argwhere(depth >= 0.9 * depth.max()) + low
    middle = np.argwhere(mask[part]).mean(axis=0) + low
    i, j = wide[int(np.argmin(((wide - middle) ** 2).sum(axis=1)))]
    return float(origin[0] + i * cell), float(origin[1] + j * cell)
