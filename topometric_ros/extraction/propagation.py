"""From clusters of views to rooms: vote, label propagation, split (thesis §4.2.8, Algorithm 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.extraction.visibility import Visibilities
from topometric_ros.topometric_map import NO_ROOM
from topometric_ros.voxels.components import connected_components
from topometric_ros.voxels.index import VoxelIndex, row_at
from topometric_ros.voxels.kernels import ball


@dataclass(frozen=True)
class PropagationConfig:
    """How rooms' outlines are smoothed; the defaults are the thesis' values."""

    radius: float = parameter(
        2.0, "Neighbourhood whose labels are counted.", unit="voxels", minimum=1.0, maximum=10.0
    )
    iterations: int = parameter(10, "Most steps of label propagation.", minimum=0, maximum=1000)
    smallest_room: int = parameter(
        1, "Connected parts with fewer voxels are no room.", unit="voxels", minimum=1
    )


def vote(sets: Visibilities, cluster: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return for every voxel the cluster with most visibilities that hold it (eq. 35-36).

    Parameters
    ----------
    sets : K visibilities over N voxels
    cluster : (K,) int32, the cluster of each

    Returns
    -------
    (N,) int32; the lowest of equal clusters, NO_ROOM for a voxel that no view holds
    """
    return _vote(sets.words, np.asarray(cluster, dtype=np.int32), sets.voxels)


@njit(cache=True, nogil=True)
def _vote(words, cluster, voxels):  # type: ignore[no-untyped-def]
    label = np.full(voxels, NO_ROOM, np.int32)
    most = np.zeros(voxels, np.int32)
    votes = np.zeros(voxels, np.int32)
    for c in range(cluster.max() + 1 if len(cluster) else 0):
        votes[:] = 0
        for view in np.flatnonzero(cluster == c):
            for w in range(words.shape[1]):
                word = words[view, w]
                bit = 0
                while word != np.uint64(0):
                    if word & np.uint64(1):
                        votes[w * 64 + bit] += 1
                    word >>= np.uint64(1)
                    bit += 1
        for i in range(voxels):
            if votes[i] > most[i]:
                most[i] = votes[i]
                label[i] = c
    return label


def propagate_labels(
    coords: NDArray[np.int32],
    labels: NDArray[np.int32],
    config: PropagationConfig,
    index: VoxelIndex | None = None,
) -> NDArray[np.int32]:
    """Return labels after each voxel has taken the commonest of its neighbourhood (Algorithm 6).

    A voxel changes only where another label is more common than its own, as in the draft; among
    equally common labels it takes the lowest. Voxels without a label do not vote and take what
    their neighbours have, so gaps close by two voxels a step. All voxels change at once. Such
    rounds end in a fixed point or alternate between two labellings (Goles & Olivos 1980); on the
    latter, where the draft's listing never ends, each voxel keeps the lower of its two labels.

    Parameters
    ----------
    coords : (N, 3) int32, distinct cells
    labels : (N,) int32, NO_ROOM for none
    config : radius of the neighbourhood (the voxel itself included) and the most steps
    index : of `coords`, if the caller has one

    Returns
    -------
    (N,) int32
    """
    index = VoxelIndex(coords) if index is None else index
    offsets = ball(config.radius).offsets()
    before = label = np.asarray(labels, dtype=np.int32)
    active = np.ones(len(coords), np.bool_)
    for _ in range(config.iterations):
        after, active = _step(index.table, coords, label, active, offsets)
        if np.array_equal(after, label):
            break
        if np.array_equal(after, before):
            return np.minimum(after, label)
        before, label = label, after
    return label.copy()


@njit(cache=True, nogil=True)
def _step(table, coords, label, active, offsets):  # type: ignore[no-untyped-def]
    """One round over the voxels with a change nearby, and where the next round has to look."""
    after = label.copy()
    nearby = np.zeros(len(label), np.bool_)
    names = np.empty(len(offsets), np.int32)
    counts = np.empty(len(offsets), np.int32)
    neighbours = np.empty(len(offsets), np.int64)
    for i in range(len(label)):
        if not active[i]:
            continue
        found = 0
        kinds = 0
        for k in range(len(offsets)):
            j = row_at(
                table,
                coords[i, 0] + offsets[k, 0],
                coords[i, 1] + offsets[k, 1],
                coords[i, 2] + offsets[k, 2],
            )
            if j < 0:
                continue
            neighbours[found] = j
            found += 1
            if label[j] < 0:
                continue
            place = 0
            while place < kinds and names[place] != label[j]:
                place += 1
            if place == kinds:
                names[kinds] = label[j]
                counts[kinds] = 0
                kinds += 1
            counts[place] += 1
        after[i] = _commonest(names[:kinds], counts[:kinds], label[i])
        if after[i] != label[i]:
            nearby[neighbours[:found]] = True
    return after, nearby


@njit(cache=True, nogil=True)
def _commonest(names, counts, current):  # type: ignore[no-untyped-def]
    """The current label unless another is more common; the lowest of equally common others."""
    best = current
    most = 0
    for place in range(len(names)):
        if names[place] == current:
            most = counts[place]
    for place in range(len(names)):
        if counts[place] > most or (
            counts[place] == most and best != current and names[place] < best
        ):
            best = names[place]
            most = counts[place]
    return best


def split_rooms(
    coords: NDArray[np.int32],
    labels: NDArray[np.int32],
    config: PropagationConfig,
    index: VoxelIndex | None = None,
) -> NDArray[np.int32]:
    """Return rooms: connected parts of equal labels under the same neighbourhood.

    Returns
    -------
    (N,) int32, 0 for the room with most voxels and so on, NO_ROOM for voxels without a label and
    for parts smaller than the smallest room
    """
    rooms = connected_components(coords, ball(config.radius), labels, index)
    sizes = np.bincount(rooms[rooms >= 0], minlength=1)
    # Rooms are numbered by size, so the small ones have the highest numbers.
    rooms[rooms >= np.count_nonzero(sizes >= config.smallest_room)] = NO_ROOM
    return rooms
