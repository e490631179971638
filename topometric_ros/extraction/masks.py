"""Masks of a plan: growing, shrinking and closing them, how deep cells lie, what they see.

Masks are (nx, ny) bool; lengths are in cells. SciPy's functions do the same for any structure and
any number of dimensions, and take several times as long.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

BESIDE = 1.5
"""Radius of the disk that holds a cell and the eight round it."""


def dilated(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """Grow a mask by a disk of `radius` cells."""
    if not mask.any():
        return mask.copy()
    grown: NDArray[np.bool_] = _stamped(mask, *_disk(radius))
    return grown


def eroded(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """Shrink a mask by a disk of `radius` cells; what lies beyond the raster counts as set."""
    return ~dilated(~mask, radius)


def closed(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """Close the gaps of a mask that a disk of `radius` cells does not fit into."""
    return eroded(dilated(mask, radius), radius)


def opened(mask: NDArray[np.bool_], radius: float) -> NDArray[np.bool_]:
    """Remove what of a mask a disk of `radius` cells does not fit into."""
    return dilated(eroded(mask, radius), radius)


def depth(mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return how far the nearest cell that is not set is from every cell: (nx, ny) float64, cells.

    Exact; at least one cell must not be set (Meijster, Roerdink and Hesselink 2000).
    """
    distance: NDArray[np.float64] = np.sqrt(_squares(np.ascontiguousarray(mask))[0])
    return distance


def nearest_unset(mask: NDArray[np.bool_], cells: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the nearest cell that is not set of each of `cells` (K, 2): (K, 2).

    Of several the one of lowest y, and of these the one of lowest x.
    """
    _, along, nearest = _squares(np.ascontiguousarray(mask))
    x, y = cells[:, 0], nearest[tuple(cells.T)]
    away = along[x, y]
    lower = np.maximum(x - away, 0)
    on_lower = (lower == x - away) & ~mask[lower, y]
    return np.stack([np.where(on_lower, lower, x + away), y], axis=1)


def _disk(radius: float) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return the offsets of the cells within `radius` of one: x and y, each (K,)."""
    line = np.arange(-int(radius), int(radius) + 1)
    x, y = (part.ravel() for part in np.meshgrid(line, line, indexing="ij"))
    inside = np.sqrt(x * x + y * y) <= radius
    return x[inside], y[inside]


@njit(cache=True, nogil=True)
def _stamped(mask, x, y):  # type: ignore[no-untyped-def]
    """Lay a disk on every cell of a mask's rim: (nx, ny) bool."""
    nx, ny = mask.shape
    result = mask.copy()
    for i in range(nx):
        for j in range(ny):
            if not mask[i, j]:
                continue
            # Within the mask the disks of the cells round it reach as far.
            if (
                0 < i < nx - 1
                and 0 < j < ny - 1
                and mask[i - 1, j]
                and mask[i + 1, j]
                and mask[i, j - 1]
                and mask[i, j + 1]
            ):
                continue
            for k in range(len(x)):
                a, b = i + x[k], j + y[k]
                if 0 <= a < nx and 0 <= b < ny:
                    result[a, b] = True
    return result


@njit(cache=True, nogil=True)
def _squares(mask):  # type: ignore[no-untyped-def]
    """Squared distance of every cell from the nearest that is not set; how far that is along x of
    every cell; and its y: (nx, ny) each.

    First along x; then each row is the lowest of the parabolas over its cells: `apex` are those
    that are lowest anywhere, from `start` on.
    """
    nx, ny = mask.shape
    along = np.zeros((nx, ny), np.int64)
    for i in range(nx):
        for j in range(ny):
            if mask[i, j]:
                along[i, j] = along[i - 1, j] + 1 if i else nx + ny
    for i in range(nx - 2, -1, -1):
        for j in range(ny):
            along[i, j] = min(along[i, j], along[i + 1, j] + 1)
    squares, nearest = np.empty((nx, ny)), np.empty((nx, ny), np.int64)
    apex, start = np.zeros(ny, np.int64), np.zeros(ny, np.int64)
    for i in range(nx):
        own = along[i] * along[i]
        last = 0
        apex[0] = 0
        for j in range(1, ny):
            while last >= 0:
                k, x = apex[last], start[last]
                if (x - k) ** 2 + own[k] <= (x - j) ** 2 + own[j]:
                    break
                last -= 1
            if last < 0:
                last, apex[0] = 0, j
                continue
            k = apex[last]
            meet = (j * j - k * k + own[j] - own[k]) // (2 * (j - k)) + 1
            if meet < ny:
                last += 1
                apex[last], start[last] = j, meet
        for j in range(ny - 1, -1, -1):
            nearest[i, j] = apex[last]
            squares[i, j] = (j - apex[last]) ** 2 + own[apex[last]]
            if j == start[last]:
                last -= 1
    return squares, along, nearest


@njit(cache=True, nogil=True)
def sees(space, width, at, end, dx, dy):  # type: ignore[no-untyped-def]
    """Whether the straight line between two cells (dx, dy) apart meets no wall, 0 in `space`.

    The wall that the first cell lies in, if it does, hides nothing. `space` and the cells are flat,
    in rows of `width` (Amanatides & Woo 1987).
    """
    step_x = width if dx > 0 else -width
    step_y = 1 if dy > 0 else -1
    dx, dy = abs(dx), abs(dy)
    # By how much the next crossing in x comes after that in y, in units of half cells over
    # dx * dy: an integer, so no rounding decides.
    later = dy - dx
    leaving = space[at] == 0
    while at != end:
        along_x, along_y = later <= 0, later >= 0
        if along_x:
            at += step_x
            later += 2 * dy
        if along_y:
            at += step_y
            later -= 2 * dx
        if space[at] != 0:
            leaving = False
        elif not leaving:
            return False
    return True
