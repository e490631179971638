"""Unbalanced assignment of rooms by their distance in feature space (thesis eq. 49-52)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial.distance import cdist


def cost_matrix(
    features_a: NDArray[np.float64], features_b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the Euclidean distance of every pair of rooms: (R_a, R_b) float64 (eq. 50-51)."""
    if len(features_a) == 0 or len(features_b) == 0:
        return np.zeros((len(features_a), len(features_b)))
    return cdist(features_a, features_b)


def assign(cost: NDArray[np.float64], alone: float = np.inf) -> list[tuple[int, int, float]]:
    """Return the one-to-one pairs of least total cost, by rising cost (eq. 52).

    As many pairs as the smaller side has rooms (Jonker & Volgenant 1987, rectangular form by
    Crouse 2016), or fewer: two rooms that cost `alone` or more are left without a partner, which
    costs that much.

    Examples
    --------
    >>> assign(np.array([[3.0, 1.0, 2.0], [1.0, 5.0, 4.0]]))
    [(0, 1, 1.0), (1, 0, 1.0)]
    >>> assign(np.array([[0.1, 3.0], [2.0, 9.0]]), alone=4.0)
    [(0, 0, 0.1)]
    """
    # To leave a pair costs nothing here, so to make it must gain.
    rows, columns = linear_sum_assignment(np.minimum(cost, alone))
    pairs = [
        (int(i), int(j), float(cost[i, j]))
        for i, j in zip(rows, columns, strict=True)
        if cost[i, j] < alone
    ]
    return sorted(pairs, key=lambda pair: (pair[2], pair[0], pair[1]))
