"""Where a cloud lies and how far it reaches: stray points, far-off frames, wrong units.

Rasters take memory by the area of the cloud and lattices reach 50 to 100 km from their origin, so
both are looked at before anything else. Clouds of ordinary size near their origin stay untouched.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from topometric_ros.extraction.errors import ExtractionError
from topometric_ros.extraction.quality import USE_SCALE, Finding
from topometric_ros.extraction.surfaces import likely_unit
from topometric_ros.voxels.grid import bounds

_FAR = 1000.0
"""A cloud whose middle lies farther from its origin is moved by whole multiples of this, m."""

_NOWHERE = 1e8
"""Coordinates beyond this, m, are no place on Earth."""
_NO_UNIT = 1e13
"""Nor is there a unit in which those beyond this are one."""

_COARSE = 0.01
"""Distance of neighbouring single-precision numbers, m, from which walls blur."""
_SAMPLE = 10_000
"""Points at which is looked whether they are single-precision numbers."""

_WIDE = 100_000.0
"""Area in m² that no ordinary cloud covers; nor is one as high as its square root."""

_WIDEST = 360_000.0
"""Largest area in m² that is mapped: 600 m x 600 m; more would take gigabytes."""

_TILE = 50.0
"""Edge in m of the tiles in which stray points are told: what adjoins no tile lies apart."""

_ISLAND_TILE = 10.0
"""Edge in m of the tiles in which islands are told."""
_ISLAND_SHARE = 0.002
"""Share of the points up to which what lies apart is dropped."""
_TWICE_AS_LARGE = 2.0
"""By how much islands must enlarge the area or the height to be dropped."""

_MOST_TILES = 20_000
"""With more occupied tiles nothing is told to lie apart."""
_STRAY_SHARE = 0.01
"""Share of the points up to which strays are dropped."""


def without_strays(
    points: NDArray[np.float64],
) -> tuple[NDArray[np.float64], tuple[Finding, ...]]:
    """Drop the few points that lie far from all others, where they make a cloud too wide.

    Reflections and misread ranges put points hundreds of metres outside a building; the rasters
    would have to reach there. Only clouds over 100,000 m² are looked at.

    Parameters
    ----------
    points : (P, 3) float64, m, finite, P > 0

    Returns
    -------
    points : those that stay, in their order
    findings : how many were dropped, if any

    Raises
    ------
    ExtractionError
        What stays is wider than 360,000 m², as clouds that are not in metres are, or nowhere.
    """
    low, high = bounds(points)
    total = len(points)
    if max(np.abs(low).max(), np.abs(high).max()) > _NOWHERE:
        points = _few_dropped(points, np.asarray((np.abs(points) <= _NOWHERE).all(axis=1)))
        low, high = bounds(points)
        if (farthest := max(np.abs(low).max(), np.abs(high).max())) > _NO_UNIT:
            raise ExtractionError(f"expected coordinates in metres, got some of {farthest:.3g}")
    if _is_wide(low, high):
        points = _few_dropped(points, _largest_cluster(points))
        low, high = bounds(points)
    x, y, z = high - low
    if x * y > _WIDEST:
        raise ExtractionError(
            f"the cloud spans {x:.0f} m x {y:.0f} m x {z:.0f} m, at most {_WIDEST:.0f} m² can be "
            f"mapped: {_question(points)}"
        )
    if len(points) == total:
        return points, ()
    dropped = total - len(points)
    return points, (_strays(dropped, total),)


def without_islands(
    points: NDArray[np.float64],
) -> tuple[NDArray[np.float64], tuple[Finding, ...]]:
    """Drop the few points more than 10 m away from all others that make a cloud twice as large.

    Parameters
    ----------
    points : (P, 3) float64, m, thinned, P > 0, no wider than :func:`without_strays` leaves them

    Returns
    -------
    As :func:`without_strays`.
    """
    low, high = bounds(points)
    shape = np.floor((high - low) / _ISLAND_TILE).astype(np.int64) + 1
    if shape.max() == 1:
        return points, ()
    flat, counts = _tiles(points, low, shape)
    counts = counts.reshape(tuple(shape))
    labels, number = ndimage.label(counts, np.ones((3, 3, 3), bool))
    if number == 1:
        return points, ()
    largest = int(np.argmax(np.bincount(labels.ravel(), counts.ravel())[1:])) + 1
    kept = labels.ravel()[flat] == largest
    dropped = len(points) - int(np.count_nonzero(kept))
    x, y, z = np.ptp(points, axis=0) / np.maximum(np.ptp(points[kept], axis=0), _ISLAND_TILE)
    if dropped > _ISLAND_SHARE * len(points) or max(x * y, z) < _TWICE_AS_LARGE:
        return points, ()
    return points[kept], (_strays(dropped, len(points)),)


@njit(cache=True, nogil=True)
def _tiles(points, low, shape):  # type: ignore[no-untyped-def]
    """Flat tile of each point (P,), tiles of 10 m from `low` on, and how many each holds."""
    flat = np.empty(len(points), np.int64)
    counts = np.zeros(shape[0] * shape[1] * shape[2], np.int64)
    for p in range(len(points)):
        tile = np.int64(0)
        for axis in range(3):
            tile *= shape[axis]
            tile += np.int64(np.floor((points[p, axis] - low[axis]) / _ISLAND_TILE))
        flat[p] = tile
        counts[tile] += 1
    return flat, counts


def anchor(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the place near a cloud that its level frame is to have its origin at: (3,) float64, m.

    The frame's own origin, unless the middle of the cloud lies more than a kilometre from it, as in
    projected coordinates (UTM): then the nearest multiple of a kilometre in each axis. Lattices,
    rasters and single precision all do with a few kilometres.
    """
    if np.abs(bounds(points)).max() <= _FAR:
        return np.zeros(3)
    middle = np.median(points, axis=0)
    if np.abs(middle).max() <= _FAR:
        return np.zeros(3)
    # Adding zero turns -0.0 into 0.0.
    return np.asarray(np.round(middle / _FAR) * _FAR + 0.0)


def _question(points: NDArray[np.float64]) -> str:
    """Return what to ask of a cloud that is too wide."""
    unit = likely_unit(points)
    if unit is None:
        return "is it in metres (--scale), without points far outside the building?"
    name, length, height = unit
    return f"in {name} its rooms would be {height:.2g} m high; {USE_SCALE} {length:g}"


def _strays(dropped: int, total: int) -> Finding:
    message = f"{dropped} of {total} points lie far from all others and were dropped"
    return Finding("strays", "warning", message)


def far_findings(points: NDArray[np.float64], middle: NDArray[np.float64]) -> tuple[Finding, ...]:
    """Return what to tell of points (P, 3), m, whose level frame begins at `middle` (3,), m."""
    if not middle.any():
        return ()
    some = points[:: max(1, len(points) // _SAMPLE)]
    step = float(np.spacing(np.abs(some).max().astype(np.float32)))
    coarse: tuple[Finding, ...] = ()
    if step > _COARSE and np.array_equal(some, some.astype(np.float32)):
        message = (
            "the coordinates are single-precision numbers, which so far from the frame's origin "
            f"lie up to {step:.2g} m apart"
        )
        advice = "write them as doubles or relative to a nearby origin"
        coarse = (Finding("coarse_numbers", "warning", message, advice),)
    x, y, z = middle
    message = (
        "the cloud lies far from its frame's origin, so the map's level frame begins at "
        f"({x:.0f}, {y:.0f}, {z:.0f}) m"
    )
    return (*coarse, Finding("far_frame", "warning", message, "T_level_input holds this"))


def _is_wide(low: NDArray[np.float64], high: NDArray[np.float64]) -> bool:
    x, y, z = high - low
    return bool(x * y > _WIDE or z > np.sqrt(_WIDE))


def _few_dropped(points: NDArray[np.float64], kept: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the points kept, or all of them where those to be dropped are not few."""
    dropped = len(kept) - int(np.count_nonzero(kept))
    return points[kept] if 0 < dropped <= max(1.0, _STRAY_SHARE * len(kept)) else points


def _largest_cluster(points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return which points lie in the cluster of adjoining tiles that holds the most: (P,) bool."""
    tile = np.floor((points - points[0]) / _TILE).astype(np.int64)
    tiles, of_point, counts = np.unique(tile, axis=0, return_inverse=True, return_counts=True)
    if len(tiles) > _MOST_TILES:
        return np.ones(len(points), bool)
    pairs = cKDTree(tiles).query_pairs(1.5, p=np.inf, output_type="ndarray")
    joined = coo_array((np.ones(len(pairs)), pairs.T), (len(tiles), len(tiles)))
    _, cluster = connected_components(joined, directed=False)
    largest = int(np.argmax(np.bincount(cluster, weights=counts)))
    return np.asarray(cluster[of_point.reshape(-1)] == largest)
