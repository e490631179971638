"""The smallest eigenvalues of a graph's Laplacian by shifted, inverted Lanczos iteration.

ARPACK does the same, but restarts, which costs solutions, and hands small matrices to threads that
wait for each other: five times the CPU seconds here. The few dozen vectors of a room fit into
memory, so this iteration keeps them all, orthogonalises fully and never restarts (Parlett 1998,
chapter 13).
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.linalg import eigh_tridiagonal
from scipy.sparse import csr_array, diags_array
from scipy.sparse.linalg import splu

_SHIFT = 1e-3
"""The Laplacian is singular; with this on its diagonal it can be factored."""

_TOLERANCE = 1e-3
"""Residual, relative, of a vector that counts as found; its eigenvalue is then good to 1e-6."""

_FIRST_CHECK, _CHECK_EVERY = 24, 8
"""Steps beyond the number wanted before the first look at what was found, and between looks."""

_MOST_STEPS = 8
"""Steps for each eigenvalue that is wanted."""


def smallest_laplacian_eigenvalues(adjacency: csr_array, count: int) -> NDArray[np.float64]:
    """Return the smallest non-zero eigenvalues of the Laplacian of a connected graph.

    Parameters
    ----------
    adjacency : (n, n), symmetric, no loops, n > count
    count : how many are wanted

    Returns
    -------
    (count,) float64, rising; copies of one that an exactly symmetric graph has several times may
    be missing
    """
    n = adjacency.shape[0]
    shifted = diags_array(adjacency.sum(axis=1) + _SHIFT).tocsc() - adjacency.tocsc()
    factor = splu(
        shifted,
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    most = min(n - 1, _MOST_STEPS * count)
    basis = np.zeros((most + 1, n))
    start = np.random.default_rng(0).standard_normal(n)  # the same iteration every time
    start -= start.mean()
    basis[0] = start / np.sqrt((start**2).sum())
    diagonal, beside = np.zeros(most), np.zeros(most)
    inverse = np.zeros(0)
    for step in range(most):
        image = factor.solve(basis[step])
        diagonal[step], beside[step] = _orthogonalised(basis, step, image)
        size = step + 1
        look = size >= count + _FIRST_CHECK and (size - count) % _CHECK_EVERY == 0
        if look or size == most or beside[step] == 0.0:
            values, vectors = eigh_tridiagonal(diagonal[:size], beside[:step])
            inverse = values[::-1][:count]
            residual = beside[step] * np.abs(vectors[-1, ::-1][:count])
            if (residual <= _TOLERANCE * inverse).all():
                break
    return np.maximum(1.0 / inverse - _SHIFT, 0.0)


# Sums may be reordered, which lets the processor add several numbers at once.
@njit(cache=True, nogil=True, fastmath={"reassoc", "nsz", "contract"})
def _orthogonalised(basis, step, image):  # type: ignore[no-untyped-def]
    """Make the next vector of the basis from the last one's image; return T's two new numbers.

    The constant vector, of eigenvalue 0, is taken out each time, or rounding would bring it back.
    """
    image -= image.mean()
    along = 0.0
    for row in range(step, -1, -1):
        vector = basis[row]
        part = 0.0
        for i in range(len(image)):
            part += vector[i] * image[i]
        for i in range(len(image)):
            image[i] -= part * vector[i]
        if row == step:
            along = part
    square = 0.0
    for i in range(len(image)):
        square += image[i] * image[i]
    length = np.sqrt(square)
    if length > 0.0:
        basis[step + 1] = image / length
    return along, length
