"""Planes through the neighbourhood of every point: normals and how rough the surface is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_AT_ONCE = 100_000
"""Points whose neighbourhoods are held in memory at a time: all of a large map's take gigabytes."""


def fit_planes(
    points: NDArray[np.float64], neighbours: int
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a plane through each point's nearest neighbours by principal components.

    Parameters
    ----------
    points : (N, 3) float64, m
    neighbours : how many nearest points, the point itself included, make a plane

    Returns
    -------
    normals : (N, 3) float64, unit length, sign arbitrary
    distances : (N,) float64, m, the summed distance of the neighbours to their plane

    Examples
    --------
    >>> flat = np.array([[x, y, 0.0] for x in range(4) for y in range(4)])
    >>> normals, distances = fit_planes(flat, 5)
    >>> bool(np.allclose(np.abs(normals[:, 2]), 1.0)), float(distances.max())
    (True, 0.0)
    """
    k = min(neighbours, len(points))
    if k < 3:
        return np.tile([0.0, 0.0, 1.0], (len(points), 1)), np.zeros(len(points))
    tree = cKDTree(points)
    normals, distances = np.empty((len(points), 3)), np.empty(len(points))
    for start in range(0, len(points), _AT_ONCE):
        block = slice(start, start + _AT_ONCE)
        patches = points[tree.query(points[block], k=k)[1]]
        patches -= patches.mean(axis=1, keepdims=True)
        scatter = np.einsum("nki,nkj->nij", patches, patches)
        across = np.linalg.eigh(scatter)[1][:, :, 0]
        normals[block] = across
        distances[block] = np.abs(np.einsum("nki,ni->nk", patches, across)).sum(axis=1)
    return normals, distances
