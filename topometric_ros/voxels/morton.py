"""Morton order of voxel coordinates (thesis eq. 9): 3D locality kept in one sorted integer.

Coordinates may be negative: 2^20 is added to each before its 21 bits are interleaved, so a code
does not depend on a map's bounds and stays the same while the map grows.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError

COORDINATE_LIMIT = 1 << 20
"""Coordinates lie in [-COORDINATE_LIMIT, COORDINATE_LIMIT): 105 km each way at 0.1 m."""


@njit(cache=True, nogil=True)
def spread(bits):  # type: ignore[no-untyped-def]
    """Put two zero bits after each of the 21 low bits of a uint64."""
    bits = (bits | (bits << np.uint64(32))) & np.uint64(0x1F00000000FFFF)
    bits = (bits | (bits << np.uint64(16))) & np.uint64(0x1F0000FF0000FF)
    bits = (bits | (bits << np.uint64(8))) & np.uint64(0x100F00F00F00F00F)
    bits = (bits | (bits << np.uint64(4))) & np.uint64(0x10C30C30C30C30C3)
    return (bits | (bits << np.uint64(2))) & np.uint64(0x1249249249249249)


@njit(cache=True, nogil=True)
def morton_code(x, y, z):  # type: ignore[no-untyped-def]
    """Morton code of one cell within the limit, for compiled code."""
    code = spread(np.uint64(x + COORDINATE_LIMIT))
    code |= spread(np.uint64(y + COORDINATE_LIMIT)) << np.uint64(1)
    return code | (spread(np.uint64(z + COORDINATE_LIMIT)) << np.uint64(2))


@njit(cache=True, nogil=True)
def _codes(coords):  # type: ignore[no-untyped-def]
    """Return the codes (N,) of cells, and the lowest and the highest of all coordinates and 0."""
    codes = np.empty(len(coords), np.uint64)
    low, high = np.int64(0), np.int64(0)
    for i in range(len(coords)):
        x, y, z = np.int64(coords[i, 0]), np.int64(coords[i, 1]), np.int64(coords[i, 2])
        low = min(low, x, y, z)
        high = max(high, x, y, z)
        codes[i] = morton_code(x, y, z)
    return codes, low, high


@njit(cache=True, nogil=True)
def _gathered(bits):  # type: ignore[no-untyped-def]
    """Undo :func:`spread`."""
    bits = bits & np.uint64(0x1249249249249249)
    bits = (bits | (bits >> np.uint64(2))) & np.uint64(0x10C30C30C30C30C3)
    bits = (bits | (bits >> np.uint64(4))) & np.uint64(0x100F00F00F00F00F)
    bits = (bits | (bits >> np.uint64(8))) & np.uint64(0x1F0000FF0000FF)
    bits = (bits | (bits >> np.uint64(16))) & np.uint64(0x1F00000000FFFF)
    return (bits | (bits >> np.uint64(32))) & np.uint64(0x1FFFFF)


@njit(cache=True, nogil=True)
def _coords(codes):  # type: ignore[no-untyped-def]
    coords = np.empty((len(codes), 3), np.int32)
    for i in range(len(codes)):
        for axis in range(3):
            cell = np.int64(_gathered(codes[i] >> np.uint64(axis)))
            coords[i, axis] = cell - COORDINATE_LIMIT
    return coords


def morton_encode(coords: NDArray[np.integer]) -> NDArray[np.uint64]:
    """Interleave voxel coordinates into Morton codes, x in the lowest bit.

    Parameters
    ----------
    coords : (N, 3) integer array, voxel coordinates within ±COORDINATE_LIMIT

    Returns
    -------
    (N,) uint64

    Raises
    ------
    TopometricError
        A coordinate lies outside the limit.

    Examples
    --------
    >>> import numpy as np
    >>> codes = morton_encode(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0]]))
    >>> (codes - codes[0]).tolist()
    [0, 1, 2]
    """
    codes: NDArray[np.uint64]
    codes, low, high = _codes(np.asarray(coords).reshape(-1, 3))
    check_limit(low, high)
    return codes


def check_limit(low: int, high: int) -> None:
    """Raise TopometricError where coordinates from `low` to `high` have no Morton code."""
    if low < -COORDINATE_LIMIT or high >= COORDINATE_LIMIT:
        raise TopometricError(
            f"voxel coordinates {low}..{high} exceed ±{COORDINATE_LIMIT}; "
            "use a larger voxel or move the cloud nearer to its origin"
        )


def morton_decode(codes: NDArray[np.uint64]) -> NDArray[np.int32]:
    """Undo :func:`morton_encode`: (N,) uint64 to (N, 3) int32 voxel coordinates."""
    coords: NDArray[np.int32] = _coords(np.asarray(codes, dtype=np.uint64))
    return coords
