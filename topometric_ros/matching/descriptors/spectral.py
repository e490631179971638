"""The spectrum of a room's neighbourhood graph (thesis §4.3.3; ShapeDNA, Reuter et al. 2006).

The draft takes eigenvalues by singular value decomposition. Both matrices are symmetric, so their
singular values are the absolute eigenvalues, and Lanczos iteration finds the few that are kept
without the rest (`lanczos.py`): the smallest non-zero ones of the Laplacian, the largest of the
adjacency matrix.
Laplacian eigenvalues are divided by the squared edge of a cell (1/m²), which makes rooms comparable
that were described at different cell sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh

from topometric_ros.matching.descriptors.base import room_voxels
from topometric_ros.matching.descriptors.lanczos import smallest_laplacian_eigenvalues
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.grid import in_morton_order
from topometric_ros.voxels.index import VoxelIndex, row_at
from topometric_ros.voxels.kernels import moore, von_neumann

_DENSE = 100
"""Up to this many nodes the whole spectrum is cheaper than the iteration."""


@dataclass(frozen=True)
class SpectralDescriptor:
    """The first non-zero eigenvalues of each room's neighbourhood graph."""

    eigenvalues: int = 32
    matrix: str = "laplacian"
    neighbourhood: str = "moore"
    cell: float = 0.3
    nodes: int = 5000
    version: int = 1

    @property
    def name(self) -> str:
        """The name tells matrix and neighbourhood, which change the numbers."""
        return f"spectral_{self.matrix}_{self.neighbourhood}"

    @property
    def dimension(self) -> int:
        """Number of eigenvalues."""
        return self.eigenvalues

    @property
    def by_ratio(self) -> bool:
        """Whether values are compared by their logarithm."""
        return True

    def __call__(
        self, topometric_map: TopometricMap, members: Sequence[Sequence[int]] | None = None
    ) -> NDArray[np.float32]:
        """Describe every room, or each set of rooms in `members` merged: (R, D) float32."""
        rows = [
            self.spectrum(voxels, topometric_map.voxel_size)
            for voxels in room_voxels(topometric_map, members)
        ]
        return np.array(rows, dtype=np.float32).reshape(-1, self.dimension)

    def spectrum(self, voxels: NDArray[np.int32], voxel_size: float) -> NDArray[np.float64]:
        """Return the eigenvalues of one room's voxels (n, 3): (D,), the last repeated if few."""
        step = max(1, round(self.cell / voxel_size))
        coords = _coarsened(voxels, step)
        while len(coords) > self.nodes:
            step *= 2
            coords = _coarsened(voxels, step)
        adjacency = _largest_component(neighbourhood_graph(coords, self.neighbourhood))
        values = self._eigenvalues(adjacency)
        if self.matrix == "laplacian":
            values = values / (step * voxel_size) ** 2
        last = values[-1] if len(values) else 0.0
        return np.concatenate([values, np.full(self.eigenvalues - len(values), last)])

    def _eigenvalues(self, adjacency: csr_array) -> NDArray[np.float64]:
        """Return at most D sorted non-zero eigenvalues of a connected graph's matrix."""
        n = adjacency.shape[0]
        if n < 2:
            return np.zeros(0)
        wanted = min(self.eigenvalues, n - 1)
        dense = n <= max(_DENSE, 2 * wanted + 2)
        if self.matrix == "laplacian":
            if not dense:
                return smallest_laplacian_eigenvalues(adjacency, wanted)
            laplacian = np.diag(adjacency.sum(axis=1)) - adjacency.toarray()
            return np.maximum(np.linalg.eigvalsh(laplacian)[1 : wanted + 1], 0.0)
        if dense:
            values = np.linalg.eigvalsh(adjacency.toarray())
        else:
            start = np.random.default_rng(0).standard_normal(n)  # the same iteration every time
            values = eigsh(adjacency, k=wanted, which="LM", v0=start, tol=1e-6)[0]
        return np.sort(np.abs(values))[::-1][:wanted]


def _coarsened(voxels: NDArray[np.int32], step: int) -> NDArray[np.int32]:
    """Return the distinct cells of `step` voxels' edge that the voxels lie in."""
    return in_morton_order(np.floor_divide(voxels, step)) if len(voxels) else voxels


def neighbourhood_graph(coords: NDArray[np.int32], neighbourhood: str) -> csr_array:
    """Return the adjacency matrix (n, n) of cells (n, 3) under a kernel (eq. 17-19)."""
    kernel = von_neumann() if neighbourhood == "von_neumann" else moore()
    ends, neighbours = _neighbours(VoxelIndex(coords).table, coords, kernel.offsets())
    return csr_array((np.ones(len(neighbours)), neighbours, ends), shape=(len(coords),) * 2)


@njit(cache=True, nogil=True)
def _neighbours(table, coords, offsets):  # type: ignore[no-untyped-def]
    """Rows of each cell's neighbours (E,) and where those of the next cell begin (n + 1,)."""
    ends = np.zeros(len(coords) + 1, np.int32)
    rows = np.empty(len(coords) * len(offsets), np.int32)
    count = 0
    for i in range(len(coords)):
        for k in range(len(offsets)):
            x, y, z = coords[i, 0], coords[i, 1], coords[i, 2]
            row = row_at(table, x + offsets[k, 0], y + offsets[k, 1], z + offsets[k, 2])
            if row >= 0:
                rows[count] = row
                count += 1
        ends[i + 1] = count
    return ends, rows[:count].copy()


def _largest_component(adjacency: csr_array) -> csr_array:
    """Return the largest connected part; specks add zeros and nothing about the room's shape."""
    if adjacency.shape[0] == 0:
        return adjacency
    parts, label = connected_components(adjacency, directed=False)
    if parts == 1:
        return adjacency
    keep = np.flatnonzero(label == np.argmax(np.bincount(label)))
    return adjacency[keep][:, keep]
