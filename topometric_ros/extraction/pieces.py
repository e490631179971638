"""Cutting a storey's floor at every narrowing: a watershed of the distance from the walls."""

from __future__ import annotations

import heapq

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

_EIGHT = np.ones((3, 3), bool)


def markers(
    distance: NDArray[np.float64], domain: NDArray[np.bool_], least: float
) -> NDArray[np.int32]:
    """Number the 3 x 3 maxima of a distance field above `least`: (nx, ny) int32, 0 elsewhere.

    A plateau is one maximum; numbers follow the lowest (x, y) of each.
    """
    highest = ndimage.maximum_filter(distance, footprint=_EIGHT, mode="constant")
    peaks = (distance == highest) & (distance > least) & domain
    return np.asarray(ndimage.label(peaks, _EIGHT)[0], dtype=np.int32)


def watershed(
    distance: NDArray[np.float64], domain: NDArray[np.bool_], seeds: NDArray[np.int32]
) -> NDArray[np.int32]:
    """Flood the domain from the seeds, the widest cells first (Meyer 1991).

    Parameters
    ----------
    distance : (nx, ny) float64
    domain : (nx, ny) bool, False on the border of the raster
    seeds : (nx, ny) int32, numbers from 1, 0 where there is none

    Returns
    -------
    (nx, ny) int32, the seed whose flood reached each cell first, 0 outside the domain and where
    no seed can reach. Cells touch by their edges; equal distances in the order of arrival.
    """
    labels: NDArray[np.int32] = _flood(distance, domain, seeds.copy())
    return labels


@njit(cache=True, nogil=True)
def _flood(distance, domain, labels):  # type: ignore[no-untyped-def]
    ny = labels.shape[1]
    queue = [(0.0, 0, 0)]
    queue.pop()
    arrival = 0
    for i in range(labels.shape[0]):
        for j in range(ny):
            if labels[i, j] > 0:
                heapq.heappush(queue, (-distance[i, j], arrival, i * ny + j))
                arrival += 1
    while len(queue) > 0:
        _, _, cell = heapq.heappop(queue)
        i, j = cell // ny, cell % ny
        for di, dj in ((-1, 0), (0, -1), (0, 1), (1, 0)):
            a, b = i + di, j + dj
            if domain[a, b] and labels[a, b] == 0:
                labels[a, b] = labels[i, j]
                heapq.heappush(queue, (-distance[a, b], arrival, a * ny + b))
                arrival += 1
    return labels
