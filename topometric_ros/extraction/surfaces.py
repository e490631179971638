"""How a cloud's surfaces lie: how thick, how dense, how upright they are, how high the rooms.

Buildings consist of thin surfaces that are level or upright, two to five metres apart in height.
A cloud that shows none of this is noisy, sparse, tilted, in other units or no building, and the
numbers tell which (`quality.py`). Everything is read from blocks and columns of a thinned cloud.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.extraction.columns import NOTHING, Columns, sort_columns
from topometric_ros.voxels.grid import bounds, means, thin, voxelise

_BLOCK = 0.3
"""Edge in m of the blocks in which a plane is fitted to the points."""

_MOST_POINTS = 200_000
"""Points that are looked at, evenly drawn from more."""
_FEWEST_IN_BLOCK = 8
"""Points that make a block worth a plane."""
_THIN = 0.04
"""A block whose points lie within this of a plane (standard deviation, m) is a surface."""

_UPRIGHT = 0.25
_LEVEL = 0.97
"""Height of a surface's normal below which it is upright, and above which it is level."""

_MOST_CANDIDATES = 500
"""Directions that are tried as the walls' own."""
_BUILT = 0.6
"""Share of a building's surfaces that lie along one direction or square to it."""

_ALONG = 0.996
_ACROSS = 0.087
"""Cosines of five degrees from a direction, and from square to it."""

_WALL_BLOCK = 1.2
"""Height in m of the blocks that walls are measured in: a lean shows over a height."""

_THICK_WALL = 0.07
"""Standard deviation from its plane above which a block holds more than a wall, m."""
_LEANING = 0.1
"""Height of a wall's normal, about six degrees."""

_FEWEST_ON_WALLS = 2000
"""Points on walls of one direction that tell a lean."""
_LEAST_ACROSS = 0.05
"""Weight of the walls that run across the others, as a share of theirs."""

_THICKNESS_OF_THINNING = 0.005
"""What blocks of points without noise measure, m: corners, and the means of 5 cm cells."""

_NOISE_OF_THICKNESS = 1.4
"""Measured with noise of 1 to 5 cm: blocks cut off what lies far out."""

_ORDINARY_GAP = 10
"""Cells: smaller gaps lie under tables and in shelves."""

_SMALLEST_SHARE_OF_GAPS = 0.02
"""Fewer voxels under or over a gap say nothing: of a cloud without ceilings lintels remain."""

_GAP_SHARE = 0.5
"""Share of the gaps that the commonest one must have to tell a spacing."""
_MOST_BLOCKS = 5_000_000
"""Up to so many blocks are all counted; of more, as of wide clouds, only those that occur."""

_INDOORS = (2.0, 5.0)
"""Free heights of ordinary rooms, m."""

_UNITS = (("millimetres", 0.001), ("centimetres", 0.01), ("inches", 0.0254), ("feet", 0.3048))


@dataclass(frozen=True)
class Planes:
    """Planes fitted to a cloud's blocks: `thickness` (B,) m, unit `normals` (B, 3), `counts` (B,).

    `measured` is the share of all points that lie in blocks with enough of them.
    """

    thickness: NDArray[np.float64]
    normals: NDArray[np.float64]
    counts: NDArray[np.int64]
    measured: float


@dataclass(frozen=True)
class Surfaces:
    """What the surfaces of a cloud look like; shares are of the points in measured blocks.

    `noise` is the standard deviation across them (m, within a third; at most about 0.07), `flat`
    the share that lies on any thin surface, `straight` the share on one that is level or upright,
    `upright` on an upright one, `measured` the share of all points that lie in blocks with enough
    of them.
    """

    noise: float
    flat: float
    straight: float
    upright: float
    measured: float


def fit_planes(points: NDArray[np.float64], height: float = _BLOCK) -> Planes:
    """Fit planes to the blocks of a cloud.

    Parameters
    ----------
    points : (P, 3) float64, m, thinned to 5 cm or less, P > 0
    height : m, of the blocks
    """
    edges = np.array([_BLOCK, _BLOCK, height])
    low, high = np.floor(bounds(points) / edges).astype(np.int64)
    size = high - low + 1
    key = _blocks(points, edges, low, size)
    stride = -(-len(points) // _MOST_POINTS)
    if stride > 1:
        # Whole blocks, spread over the cloud: Knuth's multiplicative hash of their place.
        chosen = ((key * 2_654_435_761) >> 16) % stride == 0
        points, key = points[chosen], key[chosen]
    of_point, counts = _numbered(key, int(size.prod()))
    spread = _covariances(points, of_point, means(points, of_point, len(counts)), counts)
    enough = counts >= _FEWEST_IN_BLOCK
    values, vectors = np.linalg.eigh(spread[enough])
    measured = float(counts[enough].sum() / max(1, counts.sum()))
    thickness = np.sqrt(np.maximum(values[:, 0], 0.0))
    return Planes(thickness, vectors[:, :, 0], counts[enough], measured)


def _numbered(key: NDArray[np.int64], keys: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Number the keys that occur, in their order: each point's, and how many points each has."""
    if keys > _MOST_BLOCKS:
        _, of_point, counts = np.unique(key, return_inverse=True, return_counts=True)
        return of_point.reshape(-1), counts
    every = np.bincount(key, minlength=1)
    return (np.cumsum(every > 0) - 1)[key], every[every > 0]


@njit(cache=True, nogil=True)
def _blocks(points, edges, low, size):  # type: ignore[no-untyped-def]
    """Flat number of the block that holds each point, of `size` (3,) blocks from `low` on: (P,)."""
    keys = np.zeros(len(points), np.int64)
    for p in range(len(points)):
        for axis in range(3):
            block = np.int64(np.floor(points[p, axis] / edges[axis])) - low[axis]
            keys[p] = keys[p] * size[axis] + block
    return keys


@njit(cache=True, nogil=True)
def _covariances(points, of_point, mean, counts):  # type: ignore[no-untyped-def]
    """Covariance of the points of each block: (B, 3, 3)."""
    spread = np.zeros((len(counts), 3, 3))
    for p in range(len(points)):
        block = of_point[p]
        for i in range(3):
            for j in range(i, 3):
                product = (points[p, i] - mean[block, i]) * (points[p, j] - mean[block, j])
                spread[block, i, j] += product
    for block in range(len(counts)):
        for i in range(3):
            for j in range(i, 3):
                spread[block, i, j] /= counts[block]
                spread[block, j, i] = spread[block, i, j]
    return spread


def measure_surfaces(planes: Planes) -> Surfaces:
    """Measure the surfaces of a levelled cloud; all is zero where no block holds enough points."""
    if len(planes.counts) == 0:
        return Surfaces(0.0, 0.0, 0.0, 0.0, 0.0)
    height = np.abs(planes.normals[:, 2])
    flat = planes.thickness < _THIN
    upright, level = flat & (height < _UPRIGHT), flat & (height > _LEVEL)
    thickness = float(np.median(planes.thickness)) - _THICKNESS_OF_THINNING
    total = planes.counts.sum()
    on_any, on_straight, on_upright = (
        float(planes.counts[kind].sum() / total) for kind in (flat, upright | level, upright)
    )
    noise = max(0.0, thickness) * _NOISE_OF_THICKNESS
    return Surfaces(noise, on_any, on_straight, on_upright, planes.measured)


def steepest_tilt(planes: Planes) -> float:
    """Return by how much a cloud is tilted, rad, whatever the tilt; 0 where it is no building.

    Up is the direction nearest to z along which, or square to which, the most surfaces lie.
    """
    flat = planes.thickness < _THIN
    normals, weights = planes.normals[flat], planes.counts[flat].astype(float)
    if len(normals) == 0:
        return 0.0
    candidates = normals[:: max(1, len(normals) // _MOST_CANDIDATES)]
    towards = np.abs(candidates @ normals.T)
    score = ((towards > _ALONG) | (towards < _ACROSS)) @ weights
    if score.max() < _BUILT * weights.sum():
        return 0.0
    good = candidates[score >= 0.9 * score.max()]
    up = good[np.argmax(np.abs(good[:, 2]))]
    near = np.abs(normals @ up) > _ALONG
    mean = np.sign(normals[near] @ up) * weights[near] @ normals[near]
    return float(np.arccos(min(1.0, abs(mean[2]) / np.linalg.norm(mean))))


def lean_of_walls(points: NDArray[np.float64]) -> float | None:
    """Return by how much the walls of a cloud lean, rad; None where too few stand, or all one way.

    Blocks cut leaning walls off, so the lean comes out too small, by half where there is much
    noise: it tells which of two poses is the more upright rather than by how much.

    Parameters
    ----------
    points : (P, 3) float64, m, thinned to 5 cm or less, P > 0
    """
    planes = fit_planes(points, _WALL_BLOCK)
    weights = planes.counts / (planes.thickness + _THICKNESS_OF_THINNING) ** 2
    weights[planes.thickness >= _THICK_WALL] = 0.0
    up = np.array([0.0, 0.0, 1.0])
    for within in (_LEANING, _LEANING / 2):
        walls = np.abs(planes.normals @ up) < within
        normals = planes.normals[walls]
        if planes.counts[walls].sum() < _FEWEST_ON_WALLS:
            return None
        values, vectors = np.linalg.eigh((normals * weights[walls, None]).T @ normals)
        if values[1] < _LEAST_ACROSS * values[2]:
            return None
        up = vectors[:, 0]
    return float(np.arccos(min(1.0, abs(up[2]))))


def spacing(coords: NDArray[np.int32], voxel_size: float) -> float:
    """Return how far apart a cloud's points lie, m: the root of the area that each has.

    Points strewn over a surface at a density d fill a share 1 - exp(-d a²) of its cells of edge a,
    so the number of voxels over that of cells twice as wide tells d (Poisson). Less than half a
    voxel cannot be told and is returned as that.

    Parameters
    ----------
    coords : (N, 3) int32, distinct, in Morton order, N > 0
    voxel_size : m
    """
    parents = 1 + np.count_nonzero(np.diff(coords >> 1, axis=0).any(axis=1))
    ratio = len(coords) / parents
    mean = np.geomspace(0.01, 4.0, 200)
    expected = 4.0 * np.expm1(-mean) / np.expm1(-4.0 * mean)
    at = min(int(np.searchsorted(expected, ratio)), len(mean) - 1)
    return float(voxel_size / np.sqrt(mean[at]))


def clear_height(columns: Columns, voxel_size: float) -> float | None:
    """Return the free height, m, that most of a building's rooms have; None where none stands out.

    The commonest gap above level surfaces, over a metre in voxels of 0.1 m, if most have it.
    """
    gaps = columns.above[
        columns.horizontal & (columns.above > _ORDINARY_GAP) & (columns.above < NOTHING)
    ]
    if len(gaps) < max(50, _SMALLEST_SHARE_OF_GAPS * len(columns.z)):
        return None
    counts = np.convolve(np.bincount(gaps), np.ones(3), "same")
    commonest = int(np.argmax(counts))
    return commonest * voxel_size if counts[commonest] >= _GAP_SHARE * len(gaps) else None


def likely_unit(points: NDArray[np.float64]) -> tuple[str, float, float] | None:
    """Return the unit in which a cloud's free heights are those of rooms.

    Parameters
    ----------
    points : (P, 3) float64, z up, P > 0, in any unit

    Returns
    -------
    Its name, its length in m and the free height in m; None where no unit fits, or metres do.
    """
    for name, length in (("metres", 1.0), *_UNITS):
        if np.prod(np.ptp(points[:, :2], axis=0)) * length**2 > 1e6:
            continue
        cells = thin(points * length, 0.05)
        grid, _ = voxelise(cells, 0.1, np.zeros(3))
        height = clear_height(sort_columns(grid.coords), 0.1)
        if height is not None and _INDOORS[0] <= height <= _INDOORS[1]:
            return None if length == 1.0 else (name, length, height)
    return None
