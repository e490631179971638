"""Every yaw and every shift at once: the score of all planar poses by FFT correlation.

At each yaw b's walls, their free sides and its free floor are drawn on a 0.25 m raster and
correlated with a's, the storeys that meet at a height added up. All yaws are tried, since proposing
them from wall directions misses buildings without a main one; but the grid of yaws is laid so that
it brings main direction onto main direction: half a step beside, walls 100 m away are 2.6 m off.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import scipy.fft
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.configuration import parameter
from topometric_ros.matching.main_direction import main_direction
from topometric_ros.matching.search_fields import (
    CELL,
    MapFields,
    StoreyFields,
    candidate_heights,
    storey_pairs,
)
from topometric_ros.matching.search_poses import Pose

_CELLS_WALL_BLUR, _BLUR_GAIN = 0.8, 1.8
"""How far walls are smeared, as a coarse pose is half a cell off, and what makes up for it."""
_LAYERS = 4
"""What is correlated of a storey: walls, their free sides along x and y, free floor."""

_BLOCK = 8
"""Cells along the side of a block of shifts of which the best one is kept."""


@dataclass(frozen=True)
class SweepConfig:
    """Resolution and weights of the coarse search."""

    cell: float = parameter(0.25, "Edge of a raster cell.", unit="m", minimum=0.1, maximum=1.0)
    yaw_step: float = parameter(3.0, "Step in yaw.", unit="deg", minimum=0.5, maximum=15.0)
    side_weight: float = parameter(
        0.5, "Share of a wall's score that hangs on its free side.", minimum=0.0, maximum=1.0
    )
    conflict_weight: float = parameter(
        1.0, "Cost of a wall cell in the other map's free floor.", minimum=0.0, maximum=20.0
    )
    free_weight: float = parameter(
        0.05, "Gain of a free cell in the other map's free floor.", minimum=0.0, maximum=1.0
    )
    maxima_per_yaw: int = parameter(8, "Best poses kept of each yaw.", minimum=1, maximum=100)
    keep: int = parameter(80, "Best poses kept in all.", minimum=1, maximum=1000)
    largest_raster: int = parameter(
        2048, "Cells along a side above which the raster is drawn coarser.", minimum=128,
        maximum=16384,
    )  # fmt: skip


@dataclass(frozen=True)
class _Frame:
    """The raster that both maps are drawn on: cell size and (nx, ny), with a's and b's middles."""

    cell: float
    shape: tuple[int, int]
    middle_a: NDArray[np.float64]
    middle_b: NDArray[np.float64]


def sweep(a: MapFields, b: MapFields, config: SweepConfig) -> list[Pose]:
    """Return the best planar poses of b in a, best first, at most `config.keep`."""
    heights = candidate_heights(a, b)
    if not heights:
        return []
    frame = _frame(a, b, config)
    fixed = [_transform(_kernels(_draw_fixed(s, frame), config), frame) for s in a.storeys]
    pairs = [storey_pairs(a, b, height) for height in heights]
    half_turn = round(180.0 / config.yaw_step)
    offset = (main_direction(a) - main_direction(b)) % (np.pi / half_turn)
    found: list[NDArray[np.float64]] = []
    for k in range(half_turn):
        yaw = offset + np.pi * k / half_turn
        moving = [_transform(_draw_moving(s, frame, yaw), frame) for s in b.storeys]
        for level, meeting in enumerate(pairs):
            for turned in (False, True):
                field = _correlate(fixed, moving, meeting, frame, turned)
                found.append(_maxima(field, yaw + np.pi * turned, level, config.maxima_per_yaw))
    score, level, yaw, *cell = np.concatenate(found).T
    x, y = _shifted(np.column_stack(cell), yaw, frame).T
    best = np.lexsort((y, x, yaw, level, -score))[: config.keep]
    yaw = (yaw + np.pi) % (2 * np.pi) - np.pi
    return [
        Pose(float(yaw[k]), float(x[k]), float(y[k]), heights[int(level[k])], float(score[k]))
        for k in best
    ]


def _frame(a: MapFields, b: MapFields, config: SweepConfig) -> _Frame:
    """A raster on which b, at any yaw, wraps round without meeting a twice."""
    low_a, high_a = _bounds(a)
    low_b, high_b = _bounds(b)
    reach = float(np.linalg.norm(high_b - low_b)) + 2.0
    size = high_a - low_a + reach
    cell = max(config.cell, float(size.max()) / config.largest_raster)
    nx, ny = (scipy.fft.next_fast_len(int(np.ceil(edge / cell)) + 4, real=True) for edge in size)
    return _Frame(cell, (nx, ny), (low_a + high_a) / 2, (low_b + high_b) / 2)


def _bounds(fields: MapFields) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    cells = np.concatenate([p for s in fields.storeys for p in (s.walls, s.free) if len(p)])
    return cells.min(axis=0), cells.max(axis=0)


def _draw(
    storey: StoreyFields, frame: _Frame, middle: NDArray[np.float64], yaw: float
) -> NDArray[np.float32]:
    """Walls, free sides along x and y and free floor about `middle`, turned: (4, nx, ny)."""
    R = np.array([[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]])
    size = frame.shape[0] * frame.shape[1]

    def index(cells: NDArray[np.float64]) -> NDArray[np.int64]:
        k = np.floor((cells - middle) @ R.T / frame.cell + 0.5).astype(np.int64)
        return (k[:, 0] % frame.shape[0]) * frame.shape[1] + k[:, 1] % frame.shape[1]

    at_wall = index(storey.walls)
    count = np.bincount(at_wall, minlength=size)
    sides = storey.wall_sides @ R.T
    layers: list[NDArray[Any]] = [count > 0]
    for axis in (0, 1):
        total = np.bincount(at_wall, weights=sides[:, axis], minlength=size)
        layers.append(total / np.maximum(count, 1))
    area = np.bincount(index(storey.free), minlength=size) * CELL**2
    layers.append((area > 0.5 * frame.cell**2) & (count == 0))
    return np.array(layers, np.float32).reshape(_LAYERS, *frame.shape)


def _draw_fixed(storey: StoreyFields, frame: _Frame) -> NDArray[np.float32]:
    return _draw(storey, frame, frame.middle_a, 0.0)


def _draw_moving(storey: StoreyFields, frame: _Frame, yaw: float) -> NDArray[np.float32]:
    return _draw(storey, frame, frame.middle_b, yaw)


def _kernels(layers: NDArray[np.float32], config: SweepConfig) -> NDArray[np.float32]:
    """What each layer of b gains or costs at each place of a: (4, nx, ny)."""
    wall, side_x, side_y, free = layers

    def blur(layer: NDArray[np.float32]) -> NDArray[np.float32]:
        smooth = ndimage.gaussian_filter(layer, _CELLS_WALL_BLUR, mode="wrap") * _BLUR_GAIN
        return np.clip(smooth, -1.0, 1.0)

    return np.stack(
        [
            (1.0 - config.side_weight) * blur(wall) - config.conflict_weight * free,
            config.side_weight * blur(side_x),
            config.side_weight * blur(side_y),
            config.free_weight * free - config.conflict_weight * wall,
        ]
    ).astype(np.float32)


def _transform(layers: NDArray[np.float32], frame: _Frame) -> NDArray[np.complex64]:
    return scipy.fft.rfft2(layers, s=frame.shape, workers=1)


def _correlate(
    fixed: list[NDArray[np.complex64]],
    moving: list[NDArray[np.complex64]],
    pairs: list[tuple[int, int]],
    frame: _Frame,
    turned: bool,
) -> NDArray[np.float32]:
    """Sum over layers and storeys of the correlation at every shift: (nx, ny).

    Half a turn reverses b's rasters, which only conjugates their spectra (and flips the sides), so
    every spectrum serves two yaws.
    """
    total = np.zeros((frame.shape[0], frame.shape[1] // 2 + 1), np.complex64)
    for i, j in pairs:
        _add_product(total, fixed[i], moving[j], turned)
    return scipy.fft.irfft2(total, s=frame.shape, workers=1)


@njit(cache=True, nogil=True)
def _add_product(total, fixed, moving, turned):  # type: ignore[no-untyped-def]
    """Add the sum over the layers of the product of two maps' spectra, in place."""
    for x in range(total.shape[0]):
        for y in range(total.shape[1]):
            if turned:
                total[x, y] += (
                    fixed[0, x, y] * moving[0, x, y]
                    - fixed[1, x, y] * moving[1, x, y]
                    - fixed[2, x, y] * moving[2, x, y]
                    + fixed[3, x, y] * moving[3, x, y]
                )
            else:
                total[x, y] += (
                    fixed[0, x, y] * np.conj(moving[0, x, y])
                    + fixed[1, x, y] * np.conj(moving[1, x, y])
                    + fixed[2, x, y] * np.conj(moving[2, x, y])
                    + fixed[3, x, y] * np.conj(moving[3, x, y])
                )


def _maxima(field: NDArray[np.float32], yaw: float, level: int, count: int) -> NDArray[np.float64]:
    """Return the best positive blocks of shifts: (n, 5), score, level, yaw and the cell (i, j)."""
    best, cell = _block_maxima(field, _BLOCK)
    top = np.argsort(-best, kind="stable")[:count]
    top = top[best[top] > 0.0]
    return np.column_stack([best[top], np.full(len(top), level), np.full(len(top), yaw), cell[top]])


def _shifted(
    cell: NDArray[np.float64], yaw: NDArray[np.float64], frame: _Frame
) -> NDArray[np.float64]:
    """Return the translations (n, 2), m, of b in a that cells (n, 2) of a correlation mean."""
    shift = np.where(cell > np.array(frame.shape) // 2, cell - frame.shape, cell)
    c, s = np.cos(yaw), np.sin(yaw)
    x, y = frame.middle_b
    turned = np.column_stack([c * x - s * y, s * x + c * y])
    return shift * frame.cell + frame.middle_a - turned


@njit(cache=True, nogil=True)
def _block_maxima(field, size):  # type: ignore[no-untyped-def]
    """Return the largest value of each block (B,), and the cell (B, 2) that holds it."""
    nx, ny = field.shape
    count = -(-nx // size) * -(-ny // size)
    best = np.empty(count, np.float32)
    cell = np.empty((count, 2), np.int64)
    k = 0
    for x in range(0, nx, size):
        for y in range(0, ny, size):
            largest, where_i, where_j = field[x, y], x, y
            for i in range(x, min(x + size, nx)):
                for j in range(y, min(y + size, ny)):
                    if field[i, j] > largest:
                        largest, where_i, where_j = field[i, j], i, j
            best[k], cell[k, 0], cell[k, 1] = largest, where_i, where_j
            k += 1
    return best, cell
