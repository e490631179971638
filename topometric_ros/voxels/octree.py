"""Octree: a sparse voxel octree over the Morton order (thesis §4.1.2, eq. 9-10).

The Morton codes, sorted, are the leaves; a node is a run of them with a common prefix. Eight cells
that share `code >> 3` form a node, eight of those share `code >> 6`, and so on up to one root, so
the tree is no more than a list of prefixes and first rows for each level. Queries walk it down and
leave out what lies outside; a run that lies wholly inside is taken without looking at its cells.

`VoxelIndex` is faster where single cells or small balls are asked for (`docs/benchmarks.md` has the
figures); what only the tree gives are boxes, Morton intervals and levels of detail.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import ArrayLike, NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.voxels.morton import morton_decode, morton_encode

LEVELS = 21
"""Most levels above the leaves: Morton codes have 21 bits an axis."""


@dataclass(frozen=True)
class Level:
    """One level of detail: the cells of edge 2**level that hold voxels, in Morton order.

    `coords` (n, 3) int32 are on the lattice of that level (cell c spans the voxels from
    c * 2**level up to, not including, (c + 1) * 2**level), `counts` (n,) int64 the voxels in each
    cell and `means` (n, 3) float64 the mean of their coordinates, in voxels.
    """

    coords: NDArray[np.int32]
    counts: NDArray[np.int64]
    means: NDArray[np.float64]


class Octree:
    """Sparse voxel octree of a set of cells.

    Parameters
    ----------
    coords : (N, 3) integers, distinct cells; the rows that queries return are theirs

    Attributes
    ----------
    codes : (N,) uint64, the Morton order (eq. 9)
    order : (N,) int64, the row of each code

    Raises
    ------
    TopometricError
        Two rows hold the same cell.
    """

    def __init__(self, coords: NDArray[np.integer]) -> None:
        coords = np.asarray(coords).reshape(-1, 3)
        codes = morton_encode(coords)
        self.order = np.argsort(codes, kind="stable")
        self.codes = codes[self.order]
        distinct = np.count_nonzero(self.codes[1:] != self.codes[:-1]) + 1
        if distinct < len(codes):
            raise TopometricError(f"{len(codes)} cells of which {distinct} differ")
        self._tree = _nodes(self.codes)

    def __len__(self) -> int:
        return len(self.codes)

    @property
    def nbytes(self) -> int:
        """Memory of the tree and its leaves, bytes."""
        return self.codes.nbytes + self.order.nbytes + sum(part.nbytes for part in self._tree)

    def interval(self, first: int, last: int) -> NDArray[np.int64]:
        """Return the rows (K,) of the voxels with first <= Morton code < last, in Morton order."""
        begin, end = np.searchsorted(self.codes, np.array([first, last], np.uint64))
        return self.order[begin:end]

    def box(self, low: ArrayLike, high: ArrayLike) -> NDArray[np.int64]:
        """Return the rows of the voxels with low <= coordinates <= high, each (3,), sorted."""
        return self._within(np.asarray(low, np.float64), np.asarray(high, np.float64), 0.0)

    def radius(self, position: ArrayLike, radius: float) -> NDArray[np.int64]:
        """Return the rows of the voxels whose centre lies within a distance (eq. 10), sorted.

        `position` (3,) and `radius` are in cells, on the lattice of the coordinates.
        """
        position = np.asarray(position, np.float64)
        return self._within(position, position, float(radius))

    def level(self, level: int) -> Level:
        """Return the voxels seen `level` halvings of the resolution coarser (0: as they are).

        Raises
        ------
        TopometricError
            The level is not one of 0 to 20.
        """
        if not 0 <= level < LEVELS:
            raise TopometricError(f"level: expected 0 to {LEVELS - 1}, got {level}")
        shift = np.uint64(3 * level)
        prefix = self.codes >> shift
        first = np.flatnonzero(np.append(True, prefix[1:] != prefix[:-1])[: len(prefix)])
        counts = np.diff(np.append(first, len(prefix)))
        coords = morton_decode(self.codes)
        sums = np.add.reduceat(coords.astype(np.float64), first) if len(first) else coords * 1.0
        return Level(coords[first] >> level, counts, sums / counts[:, None])

    def _within(
        self, low: NDArray[np.float64], high: NDArray[np.float64], radius: float
    ) -> NDArray[np.int64]:
        """Return the rows of the voxels within a distance of a box, sorted."""
        if len(self.codes) == 0:
            return self.order
        return np.sort(self.order[_leaves_within(*self._tree, low, high, radius)])


_Tree = tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64], NDArray[np.int64]]


def _nodes(codes: NDArray[np.uint64]) -> _Tree:
    """Return the nodes level by level from the leaves up, the root second to last.

    Of each node the lowest cell (M, 3) int32, the edge less one in cells (M,) int32, the number of
    its first child and that of its first leaf (M,) int64. Children and leaves end where those of
    the next node begin; a level ends with an entry that only says this.
    """
    corner, reach, child, leaf = [], [], [], []
    prefix, starts, level, offset = codes, np.arange(len(codes) + 1), 0, 0
    first = np.zeros(len(codes) + 1, np.int64)
    while True:
        cells = morton_decode(prefix << np.uint64(3 * level))
        corner.append(np.concatenate([cells, np.zeros((1, 3), np.int32)]))
        reach.append(np.full(len(prefix) + 1, (1 << level) - 1, np.int32))
        child.append(first)
        leaf.append(starts)
        if len(prefix) <= 1:
            break
        parent = prefix >> np.uint64(3)
        begins = np.flatnonzero(np.append(True, parent[1:] != parent[:-1]))
        first = np.append(begins, len(prefix)) + offset
        starts = starts[np.append(begins, len(prefix))]
        offset += len(prefix) + 1
        prefix, level = parent[begins], level + 1
    return tuple(np.concatenate(part) for part in (corner, reach, child, leaf))  # type: ignore


@njit(cache=True, nogil=True)
def _leaves_within(corner, reach, child, leaf, low, high, radius):  # type: ignore[no-untyped-def]
    """Numbers of the leaves whose cells lie within a distance of a box, in Morton order."""
    found = np.empty(1024, np.int64)
    count = 0
    stack = [len(reach) - 2]
    while len(stack) > 0:
        node = stack.pop()
        nearest, farthest = 0.0, 0.0
        for axis in range(3):
            begin = float(corner[node, axis])
            end = begin + reach[node]
            nearest += max(low[axis] - end, begin - high[axis], 0.0) ** 2
            farthest += max(low[axis] - begin, end - high[axis], 0.0) ** 2
        if nearest > radius * radius:
            continue
        if farthest > radius * radius:
            for below in range(child[node + 1] - 1, child[node] - 1, -1):
                stack.append(below)
            continue
        begin_leaf, end_leaf = leaf[node], leaf[node + 1]
        while count + end_leaf - begin_leaf > len(found):
            found = np.append(found, np.empty(len(found), np.int64))
        for number in range(begin_leaf, end_leaf):
            found[count] = number
            count += 1
    return found[:count].copy()
