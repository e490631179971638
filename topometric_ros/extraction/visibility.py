"""Visibilities: the voxels seen from each viewpoint (thesis §4.2.7, Algorithm 4, eq. 29-30).

A visibility is a set of voxels, kept as one bit a voxel: the Jaccard index of two of them is then
a matter of counting bits.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.voxels.grid import VoxelGrid
from topometric_ros.voxels.index import bit_count
from topometric_ros.voxels.raycast import STEPS, seen_rows

_TOLERANCE = 1e-9
"""Cells; so that 0.7 m are seven voxels of 0.1 m, whatever the quotient's last digit."""


@dataclass(frozen=True)
class VisibilityConfig:
    """How far an agent sees; the default is the thesis' value."""

    radius: float = parameter(
        5.0, "How far a viewpoint sees.", unit="m", minimum=0.1, maximum=100.0
    )


@dataclass(frozen=True)
class Visibilities:
    """Sets of voxels, one a viewpoint: `words` (K, ceil(N / 64)) uint64, bit i % 64 of word
    i // 64 is voxel i; `voxels` is N."""

    words: NDArray[np.uint64]
    voxels: int

    def __len__(self) -> int:
        return len(self.words)

    def rows(self, viewpoint: int) -> NDArray[np.int64]:
        """Return the rows of the voxels that one viewpoint sees, sorted."""
        octets = self.words[viewpoint].astype("<u8").view(np.uint8)
        return np.flatnonzero(np.unpackbits(octets, bitorder="little")[: self.voxels])

    def sizes(self) -> NDArray[np.int64]:
        """Return how many voxels each viewpoint sees: (K,) int64."""
        return _sizes(self.words)


def visibilities(
    grid: VoxelGrid, viewpoints: NDArray[np.float64], config: VisibilityConfig
) -> Visibilities:
    """Return what is seen from every viewpoint (eq. 30).

    Parameters
    ----------
    grid : the occupied voxels
    viewpoints : (K, 3) float64, m, level frame
    config : how far is seen

    Returns
    -------
    Visibilities over the grid's rows
    """
    positions = (np.asarray(viewpoints, np.float64).reshape(-1, 3) - grid.origin) / grid.voxel_size
    starts = np.floor(positions * STEPS + 0.5).astype(np.int64)
    words = _views(
        grid.index.table,
        grid.coords,
        starts,
        config.radius / grid.voxel_size + _TOLERANCE,
        (len(grid) + 63) // 64,
    )
    return Visibilities(words, len(grid))


@njit(cache=True, nogil=True)
def _views(table, coords, starts, radius, words):  # type: ignore[no-untyped-def]
    result = np.zeros((len(starts), words), np.uint64)
    for view in range(len(starts)):
        for row in seen_rows(table, coords, starts[view], radius):
            result[view, row >> 6] |= np.uint64(1) << np.uint64(row & 63)
    return result


@njit(cache=True, nogil=True)
def _sizes(words):  # type: ignore[no-untyped-def]
    sizes = np.zeros(len(words), np.int64)
    for view in range(len(words)):
        for word in words[view]:
            if word != np.uint64(0):
                sizes[view] += bit_count(word)
    return sizes


def jaccard(sets: Visibilities) -> NDArray[np.float64]:
    """Return the Jaccard index of every two visibilities (eq. 31-33).

    Returns
    -------
    (K, K) float64 in 0..1, symmetric, 1 on the diagonal; two empty sets are the same set
    """
    return _jaccard(sets.words, sets.sizes())


@njit(cache=True, nogil=True)
def _summaries(words):  # type: ignore[no-untyped-def]
    """Which words of each set are not empty, as bits: (K, ceil(W / 64)) uint64."""
    result = np.zeros((words.shape[0], (words.shape[1] + 63) // 64), np.uint64)
    for view in range(words.shape[0]):
        for w in range(words.shape[1]):
            if words[view, w] != np.uint64(0):
                result[view, w >> 6] |= np.uint64(1) << np.uint64(w & 63)
    return result


@njit(cache=True, nogil=True)
def _jaccard(words, sizes):  # type: ignore[no-untyped-def]
    summary = _summaries(words)
    result = np.eye(len(words))
    for a in range(len(words)):
        for b in range(a):
            shared = 0
            for s in range(summary.shape[1]):
                common = summary[a, s] & summary[b, s]
                while common != np.uint64(0):
                    lowest = common & (~common + np.uint64(1))
                    w = s * 64 + bit_count(lowest - np.uint64(1))
                    both = words[a, w] & words[b, w]
                    if both != np.uint64(0):
                        shared += bit_count(both)
                    common ^= lowest
            total = sizes[a] + sizes[b] - shared
            result[a, b] = result[b, a] = shared / total if total else 1.0
    return result
