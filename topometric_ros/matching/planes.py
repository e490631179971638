"""Planes through the neighbourhood of every point: normals and how rough the surface is."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree


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
    _, nearest = cKDTree(points).query(points, k=k)
    patches = points[nearest]
    patches = patches - patches.mean(axis=1, keepdims=True)
    scatter = np.einsum("nki,nkj->nij", patches, patches)
    normals = np.linalg.eigh(scatter)[1][:, :, 0]
    distances = np.abs(np.einsum("nki,ni->nk", patches, normals)).sum(axis=1)
    return normals, distances
