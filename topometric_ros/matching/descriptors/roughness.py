"""How rough a room's surface is, from planes through its voxels' neighbourhoods (thesis §4.3.2).

On a lattice many neighbours are equally far, so all that are as far as the n-th are taken: then
the same room gives the same number however it is turned by quarters, and no order decides. Sums
of coordinates are whole numbers, so most neighbourhoods, which are flat, are known to be exactly.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.voxels.index import Table, VoxelIndex, row_at
from topometric_ros.voxels.kernels import ball


def roughness(voxels: NDArray[np.int32], neighbours: int) -> float:
    """Return the mean over voxels of the distance of their neighbours to a plane through them.

    Parameters
    ----------
    voxels : (n, 3) int32, distinct cells
    neighbours : how many nearest voxels, the voxel itself included, make a plane; those at the
        distance of the last are taken too, none beyond twice the radius of so large a disk

    Returns
    -------
    The distance of one neighbour on average times `neighbours`, in cells: the draft's sum

    Examples
    --------
    >>> flat = np.array([[x, y, 0] for x in range(4) for y in range(4)], dtype=np.int32)
    >>> roughness(flat, 5)
    0.0
    """
    if len(voxels) == 0:
        return 0.0
    offsets = ball(2.0 * math.sqrt(neighbours / math.pi)).offsets().astype(np.int64)
    offsets = offsets[np.argsort((offsets**2).sum(1), kind="stable")]
    table: Table = VoxelIndex(voxels).table
    total: float = _summed(table, voxels.astype(np.int64), offsets, neighbours)
    return total / len(voxels) * neighbours


@njit(cache=True, nogil=True)
def _summed(table, coords, offsets, neighbours):  # type: ignore[no-untyped-def]
    """Sum over the voxels of their neighbours' mean distance to the plane through them."""
    near = np.empty(offsets.shape, np.int64)
    total = 0.0
    for i in range(len(coords)):
        count, last = 0, 0
        for k in range(len(offsets)):
            x, y, z = offsets[k, 0], offsets[k, 1], offsets[k, 2]
            square = x * x + y * y + z * z
            if count >= neighbours and square > last:
                break
            if row_at(table, coords[i, 0] + x, coords[i, 1] + y, coords[i, 2] + z) >= 0:
                near[count] = offsets[k]
                count, last = count + 1, square
        total += _distance_to_plane(near[:count])
    return total


@njit(cache=True, nogil=True)
def _distance_to_plane(points):  # type: ignore[no-untyped-def]
    """Mean distance of whole points (k, 3) to the plane of least squares through them."""
    count = len(points)
    sx = sy = sz = xx = xy = xz = yy = yz = zz = np.int64(0)
    for p in range(count):
        x, y, z = points[p, 0], points[p, 1], points[p, 2]
        sx, sy, sz = sx + x, sy + y, sz + z
        xx, xy, xz = xx + x * x, xy + x * y, xz + x * z
        yy, yz, zz = yy + y * y, yz + y * z, zz + z * z
    xx, xy, xz = count * xx - sx * sx, count * xy - sx * sy, count * xz - sx * sz
    yy, yz, zz = count * yy - sy * sy, count * yz - sy * sz, count * zz - sz * sz
    minor = yy * zz - yz * yz
    if xx * minor - xy * (xy * zz - yz * xz) + xz * (xy * yz - yy * xz) == 0:
        return 0.0
    a, b, c = _normal(float(xx), float(xy), float(xz), float(yy), float(yz), float(zz))
    middle = (a * sx + b * sy + c * sz) / count
    total = 0.0
    for p in range(count):
        total += abs(a * points[p, 0] + b * points[p, 1] + c * points[p, 2] - middle)
    return total / count


@njit(cache=True, nogil=True)
def _normal(xx, xy, xz, yy, yz, zz):  # type: ignore[no-untyped-def]
    """Unit eigenvector of the smallest eigenvalue of a symmetric 3 x 3 matrix (Smith 1961)."""
    mean = (xx + yy + zz) / 3.0
    a, b, c = xx - mean, yy - mean, zz - mean
    spread = math.sqrt((a * a + b * b + c * c + 2.0 * (xy * xy + xz * xz + yz * yz)) / 6.0)
    if spread == 0.0:
        return 0.0, 0.0, 1.0
    half = a * (b * c - yz * yz) - xy * (xy * c - yz * xz) + xz * (xy * yz - b * xz)
    half = min(1.0, max(-1.0, half / (2.0 * spread**3)))
    smallest = mean + 2.0 * spread * math.cos(math.acos(half) / 3.0 + 2.0 * math.pi / 3.0)
    a, b, c = xx - smallest, yy - smallest, zz - smallest
    # Two rows of the matrix less the eigenvalue span the plane; the longest product is surest.
    best, nx, ny, nz = -1.0, 0.0, 0.0, 1.0
    for ux, uy, uz, vx, vy, vz in (
        (a, xy, xz, xy, b, yz),
        (a, xy, xz, xz, yz, c),
        (xy, b, yz, xz, yz, c),
    ):
        px, py, pz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
        square = px * px + py * py + pz * pz
        if square > best and square > 0.0:
            best, nx, ny, nz = square, px, py, pz
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    return nx / length, ny / length, nz / length
