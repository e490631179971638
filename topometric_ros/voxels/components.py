"""Connected components of a voxel set under any neighbourhood (thesis §4.2.4, Algorithm 1).

The draft grows one region after another by breadth-first search (its listing tests the visited set
where the unvisited one is meant). Joining neighbours in a union-find forest gives the same
components in one pass and does not depend on where the search starts.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.voxels.index import VoxelIndex, row_at
from topometric_ros.voxels.kernels import Kernel
from topometric_ros.voxels.morton import morton_encode


def connected_components(
    coords: NDArray[np.int32],
    kernel: Kernel,
    labels: NDArray[np.int32] | None = None,
    index: VoxelIndex | None = None,
) -> NDArray[np.int32]:
    """Return the component of every voxel of the neighbourhood graph (eq. 23-25).

    Parameters
    ----------
    coords : (N, 3) int32, distinct cells
    kernel : the neighbourhood; an edge joins two voxels when either is in the other's
    labels : (N,) int32, optional; only voxels of the same label are joined, and voxels with a
        negative label belong to no component
    index : of `coords`, if the caller has one

    Returns
    -------
    (N,) int32, 0 for the largest component, 1 for the next, and so on; equal sizes in the order of
    their lowest Morton codes; -1 for voxels with a negative label
    """
    n = len(coords)
    if n == 0:
        return np.zeros(0, np.int32)
    index = VoxelIndex(coords) if index is None else index
    labels = np.zeros(n, np.int32) if labels is None else np.asarray(labels, dtype=np.int32)
    root = _join(index.table, coords, _once(kernel.offsets()), labels)
    component, size, lowest = _numbered(root, labels, morton_encode(coords))
    rank = np.empty(len(size) + 1, np.int32)
    rank[np.lexsort((lowest, -size))] = np.arange(len(size), dtype=np.int32)
    rank[-1] = -1
    return rank[component]


def _once(offsets: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return offsets of which one of each two opposite ones is left out."""
    x, y, z = offsets.T
    forth = (x > 0) | ((x == 0) & ((y > 0) | ((y == 0) & (z > 0))))
    return offsets[forth | ~np.isin(morton_encode(-offsets), morton_encode(offsets))]


@njit(cache=True, nogil=True)
def _root(parent, i):  # type: ignore[no-untyped-def]
    """Root of a voxel's tree; halves the path on the way."""
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True, nogil=True)
def _numbered(root, labels, codes):  # type: ignore[no-untyped-def]
    """Number the trees: that of every voxel, -1 for none, their sizes and lowest Morton codes."""
    number = np.full(len(root), -1, np.int64)
    count = 0
    for i in range(len(root)):
        if labels[i] >= 0 and root[i] == i:
            number[i] = count
            count += 1
    size = np.zeros(count, np.int64)
    lowest = np.full(count, np.uint64(0xFFFFFFFFFFFFFFFF), np.uint64)
    component = np.full(len(root), -1, np.int64)
    for i in range(len(root)):
        if labels[i] >= 0:
            component[i] = number[root[i]]
            size[component[i]] += 1
            lowest[component[i]] = min(lowest[component[i]], codes[i])
    return component, size, lowest


@njit(cache=True, nogil=True)
def _join(table, coords, offsets, labels):  # type: ignore[no-untyped-def]
    """Root of every voxel after joining all neighbours with the same label: (N,) int64."""
    parent = np.arange(len(coords))
    for i in range(len(coords)):
        if labels[i] < 0:
            continue
        a = _root(parent, i)
        for k in range(len(offsets)):
            j = row_at(
                table,
                coords[i, 0] + offsets[k, 0],
                coords[i, 1] + offsets[k, 1],
                coords[i, 2] + offsets[k, 2],
            )
            if j < 0 or labels[j] != labels[i] or parent[j] == a:
                continue
            b = _root(parent, j)
            parent[max(a, b)] = min(a, b)
            a = min(a, b)
    for i in range(len(coords)):
        parent[i] = _root(parent, i)
    return parent
