"""Room ids that last: a room of a new version keeps the id of the old one it covers best."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from topometric_ros.topometric_map import NO_ROOM, TopometricMap
from topometric_ros.voxels.labels import joint_counts
from topometric_ros.voxels.morton import morton_encode

SAME_ROOM = 0.2
"""Least Jaccard index of the voxels that both versions know for two rooms to be the same one."""


def keep_room_ids(
    previous: TopometricMap, new: TopometricMap, next_id: int
) -> tuple[TopometricMap, int]:
    """Give the rooms of `new` the ids that the same rooms have in `previous`.

    Rooms are paired one to one so that the sum of their Jaccard indices is largest, counted on the
    voxels that both maps hold: what has only been seen since says nothing about identity. A room
    without a partner gets an id that was never used in this session.

    Parameters
    ----------
    previous, new : maps on one lattice
    next_id : lowest id not used yet

    Returns
    -------
    The new map with its rooms in the order of their ids, and the next id.
    """
    old_ids = np.array([room.id for room in previous.rooms], np.int64)
    new_ids = np.array([room.id for room in new.rooms], np.int64)
    jaccard = _jaccard(previous, new, old_ids, new_ids)
    kept: dict[int, int] = {}
    for row, column in zip(*linear_sum_assignment(-jaccard), strict=True):
        if jaccard[row, column] >= SAME_ROOM:
            kept[int(new_ids[column])] = int(old_ids[row])
    for room_id in new_ids.tolist():
        if room_id not in kept:
            kept[room_id] = next_id
            next_id += 1
    return renumbered(new, kept), next_id


def renumbered(m: TopometricMap, ids: dict[int, int]) -> TopometricMap:
    """Return a map with every room id replaced by `ids[id]`, rooms in the order of their ids.

    Descriptors follow their rooms.
    """
    order = sorted(range(len(m.rooms)), key=lambda i: ids[m.rooms[i].id])
    table = {NO_ROOM: NO_ROOM, **ids}
    values, which = np.unique(m.room, return_inverse=True)
    replaced = np.array([table[value] for value in values.tolist()], np.int32)
    return dataclasses.replace(
        m,
        room=replaced[which.reshape(-1)] if len(values) else m.room,
        rooms=tuple(dataclasses.replace(m.rooms[i], id=ids[m.rooms[i].id]) for i in order),
        passages=tuple(
            dataclasses.replace(p, rooms=(ids[p.rooms[0]], ids[p.rooms[1]])) for p in m.passages
        ),
        descriptors=tuple(
            dataclasses.replace(entry, values=entry.values[order]) for entry in m.descriptors
        ),
    )


def _jaccard(
    previous: TopometricMap,
    new: TopometricMap,
    old_ids: NDArray[np.int64],
    new_ids: NDArray[np.int64],
) -> NDArray[np.float64]:
    """Return the Jaccard index of every old and new room: (old, new)."""
    _, in_old, in_new = np.intersect1d(
        morton_encode(previous.voxels), morton_encode(new.voxels), return_indices=True
    )
    counts = joint_counts(previous.room[in_old], new.room[in_new], old_ids, new_ids)
    both = counts[:-1, :-1]
    either = counts[:-1].sum(axis=1)[:, None] + counts[:, :-1].sum(axis=0)[None] - both
    return both / np.maximum(either, 1)
