"""Bird's-eye correlation: walls on walls, less walls in the other map's seen floor.

    score(yaw, shift) = wall_a * wall_b - weight (wall_a * free_b + free_a * wall_b)

over all shifts by FFT, at the yaws that lay the walls' dominant directions on each other (four
quarter turns) and, where the walls have no clear one, at every few degrees. One floor at a time.
No features, no ICP: the simplest method that knows that free space disproves a pose.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.fft
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.evaluation.peers.base import PeerResult, thinned

_CELL = 0.1
_THIN = 0.05
_FREE_WEIGHT = 4.0
_SWEEP_STEP = np.radians(5.0)
_FLOORS = 3
"""Floors of each map that are tried against each other, fullest first."""

_CLEAR_DIRECTION = 1.5
"""How many times the median the peak of the walls' directions must be to be trusted."""

_APART = 1.0
"""Distance in metres beyond which a second maximum is a rival of the first."""

_LEAST_MARGIN = 1.25
"""A pose is accepted where its score is so many times the best rival's."""


@dataclass(frozen=True)
class _Level:
    """One floor seen from above: cells (n, 2) m of its walls and of its free floor, height m."""

    z: float
    walls: NDArray[np.float64]
    free: NDArray[np.float64]


@dataclass(frozen=True)
class _Maximum:
    """A pose with its score, and the best score at other shifts of the same field."""

    score: float
    yaw: float
    x: float
    y: float
    z: float
    rival: float


class Birdseye:
    """Accepts a pose that scores `_LEAST_MARGIN` times the best rival."""

    name = "birdseye"

    def align(self, points_a: NDArray[np.float64], points_b: NDArray[np.float64]) -> PeerResult:
        """Return the best pose over floors, candidate yaws and shifts."""
        levels_a, levels_b = (_levels(thinned(points, _THIN)) for points in (points_a, points_b))
        found = [
            _correlate(a, b, yaw)
            for a in levels_a
            for b in levels_b
            for yaw in _candidate_yaws(a.walls, b.walls)
        ]
        found = [maximum for maximum in found if maximum.score > 0.0]
        if not found:
            return PeerResult(None, False, 0.0)
        found.sort(key=lambda maximum: -maximum.score)
        best = found[0]
        rivals = [m.score for m in found[1:] if _apart(m, best)] + [best.rival]
        margin = best.score / max(1e-9, *rivals)
        return PeerResult(_pose(best), margin >= _LEAST_MARGIN, min(margin, 1e6))


def _pose(maximum: _Maximum) -> NDArray[np.float64]:
    c, s = np.cos(maximum.yaw), np.sin(maximum.yaw)
    T = np.eye(4)
    T[:2, :2] = (c, -s), (s, c)
    T[:3, 3] = maximum.x, maximum.y, maximum.z
    return T


def _apart(one: _Maximum, other: _Maximum) -> bool:
    turn = (one.yaw - other.yaw + np.pi) % (2 * np.pi) - np.pi
    shift = np.hypot(one.x - other.x, one.y - other.y)
    return bool(abs(turn) > np.radians(6) or shift > _APART or abs(one.z - other.z) > 0.4)


def _levels(points: NDArray[np.float64]) -> list[_Level]:
    """Return the floors with free space above, fullest first."""
    step = 0.1
    bins = np.floor((points[:, 2] - points[:, 2].min()) / step).astype(np.int64)
    counts = np.bincount(bins).astype(float)
    low = points[:, 2].min()
    levels: list[_Level] = []
    for k in np.argsort(-counts, kind="stable"):
        if counts[k] < 0.2 * counts.max() or len(levels) == _FLOORS:
            break
        slab = points[np.abs(points[:, 2] - (low + (k + 0.5) * step)) < 0.75 * step, 2]
        z = float(np.median(slab))
        if any(abs(level.z - z) < 1.8 for level in levels):
            continue
        level = _level(points, z)
        if len(level.walls) > 50 and len(level.free) > 200:
            levels.append(level)
    return levels


def _level(points: NDArray[np.float64], z: float) -> _Level:
    """Return the walls and the free floor of one level; a ceiling has no walls above it."""
    low = points[:, :2].min(axis=0) - 1.0
    shape = np.ceil((points[:, :2].max(axis=0) + 1.0 - low) / _CELL).astype(np.int64)
    above = points[:, 2] - z

    def count(mask: NDArray[np.bool_]) -> NDArray[np.int64]:
        k = np.floor((points[mask, :2] - low) / _CELL).astype(np.int64)
        flat = np.bincount(k[:, 0] * shape[1] + k[:, 1], minlength=int(shape.prod()))
        return flat.reshape(shape)

    band = count((above > 0.95) & (above < 2.05))
    walls = band >= 5
    floor = ndimage.binary_closing(count(np.abs(above) < 0.12) > 0, iterations=3)
    free = floor & ~ndimage.binary_dilation(walls) & (band == 0)
    cells = [np.argwhere(mask) * _CELL + low for mask in (walls, free)]
    return _Level(z, cells[0], cells[1])


def _direction(walls: NDArray[np.float64]) -> tuple[float, float]:
    """Return the walls' dominant direction in [0, pi/2), rad, and how clear it is."""
    angles = np.radians(np.arange(0.0, 90.0, 0.5))
    scores = np.empty(len(angles))
    for k, angle in enumerate(angles):
        c, s = np.cos(angle), np.sin(angle)
        total = 0.0
        for axis in ((c, s), (-s, c)):
            bins = np.floor(walls @ np.array(axis) / _CELL).astype(np.int64)
            total += float((np.bincount(bins - bins.min()).astype(float) ** 2).sum())
        scores[k] = total
    return float(angles[scores.argmax()]), float(scores.max() / np.median(scores))


def _candidate_yaws(
    walls_a: NDArray[np.float64], walls_b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the yaws of b in a to try, rad."""
    (direction_a, clear_a), (direction_b, clear_b) = _direction(walls_a), _direction(walls_b)
    if min(clear_a, clear_b) < _CLEAR_DIRECTION:
        return np.arange(0.0, 2 * np.pi, _SWEEP_STEP)
    quarter_turns = np.arange(4, dtype=np.float64) * (np.pi / 2)
    return np.asarray(quarter_turns + (direction_a - direction_b), dtype=np.float64)


def _correlate(a: _Level, b: _Level, yaw: float) -> _Maximum:
    """Return the best shift at one yaw, with the best score elsewhere in the field."""
    c, s = np.cos(yaw), np.sin(yaw)
    R = np.array([[c, -s], [s, c]])
    layers_a, layers_b = (a.walls, a.free), (b.walls @ R.T, b.free @ R.T)
    low_a, low_b = (np.concatenate(layers).min(axis=0) for layers in (layers_a, layers_b))
    spans = [
        np.concatenate(one).max(axis=0) - low for one, low in ((layers_a, low_a), (layers_b, low_b))
    ]
    nx, ny = (
        scipy.fft.next_fast_len(int(np.ceil(edge / _CELL)) + 4, real=True) for edge in sum(spans)
    )

    def spectrum(cells: NDArray[np.float64], low: NDArray[np.float64]) -> NDArray[np.complex64]:
        raster = np.zeros((nx, ny), np.float32)
        k = np.floor((cells - low) / _CELL + 0.5).astype(np.int64)
        raster[k[:, 0], k[:, 1]] = 1.0
        return scipy.fft.rfft2(raster, workers=1)

    wall_a, free_a = (spectrum(cells, low_a) for cells in layers_a)
    wall_b, free_b = (np.conj(spectrum(cells, low_b)) for cells in layers_b)
    product = wall_a * wall_b - _FREE_WEIGHT * (wall_a * free_b + free_a * wall_b)
    field = scipy.fft.irfft2(product, s=(nx, ny), workers=1)
    i, j = np.unravel_index(int(field.argmax()), field.shape)
    score = float(field[i, j])
    near = int(_APART / _CELL)
    for axis, k in ((0, int(i)), (1, int(j))):
        field = np.roll(field, near - k, axis=axis)
    field[: 2 * near + 1, : 2 * near + 1] = 0.0
    shift = [k - n if k > n // 2 else k for k, n in ((int(i), nx), (int(j), ny))]
    x, y = np.array(shift) * _CELL + low_a - low_b
    return _Maximum(score, yaw, float(x), float(y), a.z - b.z, float(max(field.max(), 0.0)))
