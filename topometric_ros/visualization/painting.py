"""Rasters laid over each other on a sheet, each turned as its frame is, as one picture.

Every pixel takes the cell that its centre lies in, the lowest raster first. Drawing them one by one
with matplotlib took most of the time of a report.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray


@dataclass(frozen=True)
class Raster:
    """An image (nx, ny, 4) uint8 on a sheet; higher orders lie on top.

    `cells` (2, 3) takes a place on the sheet, m, to cells: their integer parts are the indices.
    """

    image: NDArray[np.uint8]
    cells: NDArray[np.float64]
    order: float


def raster_on_sheet(
    image: NDArray[np.uint8],
    origin: tuple[float, float],
    cell: float,
    place: tuple[float, float, float],
    order: float,
) -> Raster:
    """Return an image whose first cell is centred at `origin`, m, in a frame at `place`.

    `place` is the frame's turn (rad) and where it lies on the sheet (x, y), m.
    """
    angle, x, y = place
    turn = np.array([[np.cos(angle), np.sin(angle)], [-np.sin(angle), np.cos(angle)]]) / cell
    corner = np.asarray(origin) / cell - 0.5
    return Raster(image, np.column_stack([turn, -turn @ (x, y) - corner]), order)


def painted(
    rasters: Iterable[Raster], corner: tuple[float, float], pixel: float, shape: tuple[int, int]
) -> NDArray[np.uint8]:
    """Return rasters on white paper as an image (rows, columns, 4) uint8, the lowest row first.

    Parameters
    ----------
    rasters : lower orders first, equal ones as they come
    corner : the place on the sheet of the picture's lower left corner, m
    pixel : edge of a pixel, m
    shape : rows and columns
    """
    paper = np.full((*shape, 4), 255, np.uint8)
    for raster in sorted(rasters, key=lambda r: r.order):
        A, b = raster.cells[:, :2], raster.cells[:, 2]
        edges = np.array([[i, j] for i in (0, raster.image.shape[0])
                          for j in (0, raster.image.shape[1])])  # fmt: skip
        pixels = (np.linalg.solve(A, (edges - b).T).T - corner) / pixel
        low = np.clip(np.floor(pixels.min(axis=0)), 0, shape[::-1]).astype(np.int64)
        high = np.clip(np.ceil(pixels.max(axis=0)), 0, shape[::-1]).astype(np.int64)
        start = A @ np.asarray(corner) + b
        _paint(paper, raster.image, A * pixel, start, low, high)
    return paper


@njit(cache=True, nogil=True)
def _paint(paper: Any, image: Any, step: Any, start: Any, low: Any, high: Any) -> None:
    """Lay an image over some pixels of the paper; `step` (2, 2) is what a pixel is in cells."""
    for row in range(low[1], high[1]):
        for column in range(low[0], high[0]):
            x, y = column + 0.5, row + 0.5
            i = int(np.floor(start[0] + step[0, 0] * x + step[0, 1] * y))
            j = int(np.floor(start[1] + step[1, 0] * x + step[1, 1] * y))
            if i < 0 or j < 0 or i >= image.shape[0] or j >= image.shape[1]:
                continue
            alpha = int(image[i, j, 3])
            if alpha == 255:
                for channel in range(3):
                    paper[row, column, channel] = image[i, j, channel]
            elif alpha > 0:
                for channel in range(3):
                    mixed = alpha * int(image[i, j, channel])
                    mixed += (255 - alpha) * int(paper[row, column, channel])
                    paper[row, column, channel] = (mixed + 127) // 255
