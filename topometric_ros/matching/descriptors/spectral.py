"""The spectrum of a room's neighbourhood graph (thesis §4.3.3; ShapeDNA, Reuter et al. 2006).

The draft takes eigenvalues by singular value decomposition. Both matrices are symmetric, so their
singular values are the absolute eigenvalues, and Lanczos iteration finds the few that are kept
without the rest: the smallest non-zero ones of the Laplacian, the largest of the adjacency matrix.
Laplacian eigenvalues are divided by the squared edge of a cell (1/m²), which makes rooms comparable
that were described at different cell sizes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import eigsh

from topometric_ros.matching.descriptors.base import room_voxels
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.grid import in_morton_order
from topometric_ros.voxels.morton import morton_encode

_DENSE = 200
"""Up to this many nodes the whole spectrum is cheaper than the iteration."""

_SHIFT = -1e-3
"""The Laplacian is singular; shifted by this it can be factored, and the smallest come first."""


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
        start = np.random.default_rng(0).standard_normal(n)  # the same iteration every time
        if self.matrix == "laplacian":
            laplacian = diags_array(adjacency.sum(axis=1)).tocsc() - adjacency.tocsc()
            if n <= max(_DENSE, 2 * wanted + 2):
                values = np.linalg.eigvalsh(laplacian.toarray())[1 : wanted + 1]
            else:
                values = np.sort(
                    eigsh(laplacian, k=wanted + 1, sigma=_SHIFT, v0=start, tol=1e-6)[0]
                )[1:]
            return np.maximum(values, 0.0)
        if n <= max(_DENSE, 2 * wanted + 2):
            values = np.linalg.eigvalsh(adjacency.toarray())
        else:
            values = eigsh(adjacency, k=wanted, which="LM", v0=start, tol=1e-6)[0]
        return np.sort(np.abs(values))[::-1][:wanted]


def _coarsened(voxels: NDArray[np.int32], step: int) -> NDArray[np.int32]:
    """Return the distinct cells of `step` voxels' edge that the voxels lie in."""
    return in_morton_order(np.floor_divide(voxels, step)) if len(voxels) else voxels


def neighbourhood_graph(coords: NDArray[np.int32], neighbourhood: str) -> csr_array:
    """Return the adjacency matrix (n, n) of cells (n, 3) under a kernel (eq. 17-19)."""
    n = len(coords)
    span = range(-1, 2)
    offsets = [(x, y, z) for x in span for y in span for z in span if (z, y, x) > (0, 0, 0)]
    if neighbourhood == "von_neumann":
        offsets = [o for o in offsets if sum(map(abs, o)) == 1]
    codes = morton_encode(coords)
    rows, columns = [], []
    for offset in offsets:
        wanted = morton_encode(coords + np.array(offset, dtype=np.int32))
        found = np.minimum(np.searchsorted(codes, wanted), max(n - 1, 0))
        hits = np.flatnonzero(codes[found] == wanted) if n else np.zeros(0, dtype=np.int64)
        rows.append(hits)
        columns.append(found[hits])
    i, j = np.concatenate(rows), np.concatenate(columns)
    ones = np.ones(2 * len(i))
    pairs = (np.concatenate([i, j]), np.concatenate([j, i]))
    return coo_array((ones, pairs), shape=(n, n)).tocsr()


def _largest_component(adjacency: csr_array) -> csr_array:
    """Return the largest connected part; specks add zeros and nothing about the room's shape."""
    if adjacency.shape[0] == 0:
        return adjacency
    _, label = connected_components(adjacency, directed=False)
    keep = np.flatnonzero(label == np.argmax(np.bincount(label)))
    return adjacency[keep][:, keep]
