"""Planes through the neighbourhood of every point: normals and how rough the surface is."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy.spatial import cKDTree

_AT_ONCE = 100_000
"""Points whose neighbourhoods are held in memory at a time: all of a large map's take gigabytes."""

_SWEEPS, _EXACT = 12, 1e-14
"""Sweeps of Jacobi's method at most, and the share off the diagonal at which it ends."""


def fit_planes(
    points: NDArray[np.float64],
    neighbours: int,
    rows: NDArray[np.int64] | None = None,
    tree: cKDTree | None = None,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Fit a plane through each point's nearest neighbours by principal components.

    Parameters
    ----------
    points : (N, 3) float64, m
    neighbours : how many nearest points, the point itself included, make a plane
    rows : (n,) int64, points to fit a plane at; None: all
    tree : of the points, if the caller has one

    Returns
    -------
    normals : (n, 3) float64, unit length, sign arbitrary
    distances : (n,) float64, m, the summed distance of the neighbours to their plane

    Examples
    --------
    >>> flat = np.array([[x, y, 0.0] for x in range(4) for y in range(4)])
    >>> normals, distances = fit_planes(flat, 5)
    >>> bool(np.allclose(np.abs(normals[:, 2]), 1.0)), float(distances.max())
    (True, 0.0)
    """
    centres = points if rows is None else points[rows]
    k = min(neighbours, len(points))
    if k < 3:
        return np.tile([0.0, 0.0, 1.0], (len(centres), 1)), np.zeros(len(centres))
    tree = tree or cKDTree(points)
    normals, distances = np.empty((len(centres), 3)), np.empty(len(centres))
    for start in range(0, len(centres), _AT_ONCE):
        block = slice(start, start + _AT_ONCE)
        nearest = tree.query(centres[block], k=k)[1]
        normals[block], distances[block] = _planes(points, nearest)
    return normals, distances


@njit(cache=True, nogil=True)
def _planes(points, nearest):  # type: ignore[no-untyped-def]
    """Normals (n, 3) and summed distances (n,) of the planes through rows of neighbours (n, k)."""
    count, k = nearest.shape
    normals, distances = np.empty((count, 3)), np.empty(count)
    scatter, axes, centre = np.empty((3, 3)), np.empty((3, 3)), np.empty(3)
    for row in range(count):
        centre[:] = 0.0
        for j in range(k):
            for c in range(3):
                centre[c] += points[nearest[row, j], c] / k
        scatter[:] = 0.0
        for j in range(k):
            for c in range(3):
                for d in range(c + 1):
                    scatter[c, d] += (points[nearest[row, j], c] - centre[c]) * (
                        points[nearest[row, j], d] - centre[d]
                    )
        for c in range(3):
            for d in range(c):
                scatter[d, c] = scatter[c, d]
        _diagonalise(scatter, axes)
        thin = 0
        for c in range(1, 3):
            if scatter[c, c] < scatter[thin, thin]:
                thin = c
        total = 0.0
        for j in range(k):
            across = 0.0
            for c in range(3):
                across += (points[nearest[row, j], c] - centre[c]) * axes[c, thin]
            total += abs(across)
        normals[row], distances[row] = axes[:, thin], total
    return normals, distances


@njit(cache=True, nogil=True)
def _diagonalise(matrix, axes):  # type: ignore[no-untyped-def]
    """Turn a symmetric 3 x 3 matrix to its own axes, in place (Jacobi 1846)."""
    axes[:] = 0.0
    for c in range(3):
        axes[c, c] = 1.0
    size = matrix[0, 0] + matrix[1, 1] + matrix[2, 2]
    for _ in range(_SWEEPS):
        if abs(matrix[0, 1]) + abs(matrix[0, 2]) + abs(matrix[1, 2]) <= _EXACT * size:
            break
        for p in range(2):
            for q in range(p + 1, 3):
                if matrix[p, q] == 0.0:
                    continue
                ratio = (matrix[q, q] - matrix[p, p]) / (2.0 * matrix[p, q])
                tangent = 1.0 / (abs(ratio) + np.sqrt(ratio * ratio + 1.0))
                if ratio < 0.0:
                    tangent = -tangent
                cosine = 1.0 / np.sqrt(tangent * tangent + 1.0)
                sine = tangent * cosine
                for c in range(3):
                    one, other = matrix[c, p], matrix[c, q]
                    matrix[c, p] = cosine * one - sine * other
                    matrix[c, q] = sine * one + cosine * other
                for c in range(3):
                    one, other = matrix[p, c], matrix[q, c]
                    matrix[p, c] = cosine * one - sine * other
                    matrix[q, c] = sine * one + cosine * other
                for c in range(3):
                    one, other = axes[c, p], axes[c, q]
                    axes[c, p] = cosine * one - sine * other
                    axes[c, q] = sine * one + cosine * other
