"""Morton order of voxel coordinates (thesis eq. 9): 3D locality kept in one sorted integer.

Coordinates may be negative: 2^20 is added to each before its 21 bits are interleaved, so a code
does not depend on a map's bounds and stays the same while the map grows.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError

COORDINATE_LIMIT = 1 << 20
"""Coordinates lie in [-COORDINATE_LIMIT, COORDINATE_LIMIT): 105 km each way at 0.1 m."""

_MASKS = (
    (32, 0x1F00000000FFFF),
    (16, 0x1F0000FF0000FF),
    (8, 0x100F00F00F00F00F),
    (4, 0x10C30C30C30C30C3),
    (2, 0x1249249249249249),
)


def _spread(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Put two zero bits after each of the 21 low bits."""
    for shift, mask in _MASKS:
        bits = (bits | (bits << np.uint64(shift))) & np.uint64(mask)
    return bits


def _gather(bits: NDArray[np.uint64]) -> NDArray[np.uint64]:
    """Undo :func:`_spread`."""
    bits = bits & np.uint64(_MASKS[-1][1])
    for (shift, _), mask in zip(
        reversed(_MASKS), (*(m for _, m in reversed(_MASKS[:-1])), 0x1FFFFF), strict=True
    ):
        bits = (bits | (bits >> np.uint64(shift))) & np.uint64(mask)
    return bits


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
    coords = np.asarray(coords, dtype=np.int64)
    if coords.size and (coords.min() < -COORDINATE_LIMIT or coords.max() >= COORDINATE_LIMIT):
        raise TopometricError(
            f"voxel coordinates {coords.min()}..{coords.max()} exceed ±{COORDINATE_LIMIT}; "
            "use a larger voxel or move the cloud nearer to its origin"
        )
    x, y, z = ((coords + COORDINATE_LIMIT).astype(np.uint64)).T.reshape(3, -1)
    return _spread(x) | (_spread(y) << np.uint64(1)) | (_spread(z) << np.uint64(2))


def morton_decode(codes: NDArray[np.uint64]) -> NDArray[np.int32]:
    """Undo :func:`morton_encode`: (N,) uint64 to (N, 3) int32 voxel coordinates."""
    codes = np.asarray(codes, dtype=np.uint64)
    axes = [_gather(codes >> np.uint64(axis)) for axis in range(3)]
    return (np.stack(axes, axis=-1).astype(np.int64) - COORDINATE_LIMIT).astype(np.int32)
