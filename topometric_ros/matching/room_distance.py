"""How far two rooms lie apart in feature space, learned from rooms that two agents saw.

Standardised numbers (thesis eq. 50) weigh every bin of a histogram alike. But what one agent sees
of a room differs from what another sees of it, in some bins much and in neighbouring bins together.
So the differences of one room between two agents are measured, and what is compared is divided by
their covariance (a Mahalanobis distance), shrunk towards its diagonal (as Ledoit & Wolf 2004, but
by a fixed share). `scripts/fit_room_distance.py` learns it, and the level from which on a room is
better left alone, and tests both with one building left out at a time.
"""

from __future__ import annotations

from functools import cache
from importlib import resources

import numpy as np
from numpy.typing import NDArray

SHRINKAGE = 0.1
_LEAST = 1e-4
"""Variance of a share that no agent's view is surer of."""


def learned_features(shape: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the descriptor `shape` of rooms (R, D), percent, where distances are as learned.

    The distance of two agents' views of one room is 1 in the root of the mean square, no unit.
    """
    return root_shares(shape) @ _metric()


def root_shares(shape: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the square roots of shares in percent, whose noise is the same for all sizes."""
    return np.sqrt(np.maximum(shape.astype(np.float64), 0.0) / 100.0)


def fit_metric(differences: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return W^(-1/2) / √D of differences between two agents' views of one room.

    Parameters
    ----------
    differences : (n, D) float64, of :func:`root_shares`

    Returns
    -------
    (D, D) float64, symmetric
    """
    covariance = differences.T @ differences / len(differences)
    size = len(covariance)
    shrunk = (1.0 - SHRINKAGE) * covariance + SHRINKAGE * np.diag(np.diag(covariance))
    values, vectors = np.linalg.eigh(shrunk + _LEAST * np.eye(size))
    metric: NDArray[np.float64] = (vectors / np.sqrt(values)) @ vectors.T / np.sqrt(size)
    return metric


@cache
def _metric() -> NDArray[np.float64]:
    with (resources.files("topometric_ros.matching") / "shape_metric.npy").open("rb") as file:
        return np.load(file, allow_pickle=False).astype(np.float64)
