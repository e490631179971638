"""Kernels: small voxel sets with weights, moved over a grid (thesis §4.1.2, eq. 11-16).

A kernel names a neighbourhood (which cells count, with which weight) and a function that makes one
value of the neighbours' values. Connectivity, dilation and the stick of §4.2.2 are all kernels.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.voxels.grid import in_morton_order
from topometric_ros.voxels.index import VoxelIndex, row_at

_FUNCTIONS = {"sum": 0, "max": 1, "min": 2, "count": 3, "any": 4}
_TOLERANCE = 1e-9


class KernelError(TopometricError):
    """A kernel whose parts contradict each other, or a convolution with an unknown function."""


@dataclass(frozen=True)
class Kernel:
    """A voxel set with weights and an origin (eq. 12-13).

    `coords` is (K, 3) int32, cells, `weights` (K,) float64 and `origin` (3,) int32 the cell that
    is laid on the voxel of which the neighbourhood is wanted; it need not belong to `coords`.
    """

    coords: NDArray[np.int32]
    weights: NDArray[np.float64]
    origin: NDArray[np.int32]

    def __post_init__(self) -> None:
        k = len(self.coords)
        if self.coords.shape != (k, 3) or self.weights.shape != (k,) or self.origin.shape != (3,):
            raise KernelError(
                f"kernel: expected coords (K, 3), weights (K,), origin (3,), got "
                f"{self.coords.shape}, {self.weights.shape}, {self.origin.shape}"
            )

    def __len__(self) -> int:
        return len(self.coords)

    def offsets(self) -> NDArray[np.int32]:
        """Return the neighbours' places as seen from the voxel (eq. 14): (K, 3) int32, cells."""
        return self.coords - self.origin


def kernel_of(offsets: NDArray[np.integer] | list[tuple[int, int, int]]) -> Kernel:
    """Return a kernel of unit weights at `offsets` (K, 3), with its origin at (0, 0, 0)."""
    coords = np.asarray(offsets, dtype=np.int32).reshape(-1, 3)
    return Kernel(coords, np.ones(len(coords)), np.zeros(3, np.int32))


def ball(radius: float) -> Kernel:
    """Return all cells whose centre lies within `radius` cells of the origin, origin included."""
    reach = _cube(math.floor(radius + _TOLERANCE))
    return kernel_of(reach[(reach**2).sum(1) <= radius**2 + _TOLERANCE])


def circle(radius: float) -> Kernel:
    """Return the horizontal slice of :func:`ball` (§4.2.6; the draft's X-Z plane, y up)."""
    coords = ball(radius).coords
    return kernel_of(coords[coords[:, 2] == 0])


def von_neumann() -> Kernel:
    """Return the six cells that share a face with the origin."""
    reach = _cube(1)
    return kernel_of(reach[(reach**2).sum(1) == 1])


def moore() -> Kernel:
    """Return the 26 cells that share a face, an edge or a corner with the origin."""
    reach = _cube(1)
    return kernel_of(reach[(reach**2).sum(1) > 0])


def column(height: int) -> Kernel:
    """Return the origin and the `height` cells above it."""
    return kernel_of([(0, 0, z) for z in range(height + 1)])


def connectivity(name: str) -> Kernel:
    """Return the neighbourhood called "6" (:func:`von_neumann`) or "26" (:func:`moore`)."""
    kernels = {"6": von_neumann, "26": moore}
    if name not in kernels:
        raise KernelError(f"connectivity: expected one of {', '.join(kernels)}, got {name!r}")
    return kernels[name]()


def stick_kernel(
    voxel_size: float,
    thin_height: float = 0.25,
    wide_height: float = 0.75,
    diameter: float = 0.3,
) -> Kernel:
    """Return the space that an agent takes above the floor voxel it stands on (§4.2.2, figure 6).

    A thin part, one voxel wide, starts one voxel above the floor voxel, so that noise and small
    steps beside it do not obstruct; a wide part stands on top of it. Lengths are in metres;
    heights are rounded to whole voxels from the floor voxel up. Every cell has weight 1, but the
    origin (the floor voxel) 0.
    """
    thin_end = math.floor(thin_height / voxel_size + 0.5)
    wide_end = math.floor((thin_height + wide_height) / voxel_size + 0.5)
    disk = circle(diameter / 2 / voxel_size).coords[:, :2]
    thin = [(0, 0, z) for z in range(1, thin_end + 1)]
    wide = [(x, y, z) for z in range(thin_end + 1, wide_end + 1) for x, y in disk.tolist()]
    coords = np.array([(0, 0, 0), *thin, *wide], dtype=np.int32)
    weights = np.ones(len(coords))
    weights[0] = 0.0
    return Kernel(coords, weights, np.zeros(3, np.int32))


def convolve(
    coords: NDArray[np.int32],
    values: NDArray[np.float64] | None,
    kernel: Kernel,
    function: str | Callable[[NDArray[np.float64], NDArray[np.float64]], float] = "sum",
    index: VoxelIndex | None = None,
) -> NDArray[np.float64]:
    """Return a new value of every voxel from its neighbours' weighted values (eq. 15-16).

    Parameters
    ----------
    coords : (N, 3) int32, cells on which the kernel is laid
    values : one float64 for every voxel of the index, or None for occupancy (1 in every voxel)
    kernel : the neighbourhood
    function : "sum", "max", "min", "count" (of neighbours) or "any" (1 where a neighbour's
        weighted value is not 0, which stops at the first); 0 without neighbours. Or any function
        of the neighbours' values (n,) and weights (n,), n > 0, in the kernel's order: called from
        Python for every voxel, so slowly
    index : of the voxels that are the neighbours; `coords` themselves without it

    Returns
    -------
    (N,) float64

    Raises
    ------
    KernelError
        The function is unknown.
    """
    if not callable(function) and function not in _FUNCTIONS:
        raise KernelError(f"function: expected one of {', '.join(_FUNCTIONS)}, got {function!r}")
    index = VoxelIndex(coords) if index is None else index
    values = np.ones(len(index)) if values is None else np.asarray(values, dtype=np.float64)
    if callable(function):
        return _convolve_freely(coords, values, kernel, function, index)
    return _convolve(
        index.table, coords, values, kernel.offsets(), kernel.weights, _FUNCTIONS[function]
    )


def _convolve_freely(
    coords: NDArray[np.int32],
    values: NDArray[np.float64],
    kernel: Kernel,
    function: Callable[[NDArray[np.float64], NDArray[np.float64]], float],
    index: VoxelIndex,
) -> NDArray[np.float64]:
    """Return what any function makes of each voxel's neighbours (eq. 16): (N,) float64."""
    result = np.zeros(len(coords))
    offsets = kernel.offsets()
    for i, cell in enumerate(np.asarray(coords)):
        rows = index.rows(cell + offsets)
        there = rows >= 0
        if there.any():
            result[i] = function(values[rows[there]], kernel.weights[there])
    return result


@njit(cache=True, nogil=True)
def _convolve(table, coords, values, offsets, weights, function):  # type: ignore[no-untyped-def]
    result = np.zeros(len(coords))
    for i in range(len(coords)):
        count = 0
        value = 0.0
        for k in range(len(offsets)):
            row = row_at(
                table,
                coords[i, 0] + offsets[k, 0],
                coords[i, 1] + offsets[k, 1],
                coords[i, 2] + offsets[k, 2],
            )
            if row < 0:
                continue
            weighted = weights[k] * values[row]
            count += 1
            if function == 0:
                value += weighted
            elif function == 1:
                value = weighted if count == 1 else max(value, weighted)
            elif function == 2:
                value = weighted if count == 1 else min(value, weighted)
            elif function == 3:
                value = count
            elif weighted != 0.0:
                value = 1.0
                break
        result[i] = value
    return result


def dilate(coords: NDArray[np.int32], kernel: Kernel) -> NDArray[np.int32]:
    """Return the cells (M, 3) that a kernel covers when laid on each voxel, in Morton order."""
    if len(coords) == 0:
        return np.zeros((0, 3), np.int32)
    spread = coords[:, None, :] + kernel.offsets()[None, :, :]
    return in_morton_order(spread.reshape(-1, 3))


def _cube(reach: int) -> NDArray[np.int32]:
    """Return the offsets of a cube of edge 2 `reach` + 1 cells: (K, 3) int32."""
    line = np.arange(-reach, reach + 1, dtype=np.int32)
    return np.stack(np.meshgrid(line, line, line, indexing="ij"), -1).reshape(-1, 3)
