"""What two aligned maps share: the part of the smaller one, and the rooms that are the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment
from scipy.spatial import cKDTree

from topometric_ros.fusion.poses import Transform, apply, inverse
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.labels import joint_counts

_FEWEST = 20
"""Voxels that a further piece of a room shares with it at least: a few meet at any wall."""


def shared_voxels(
    a: TopometricMap, b: TopometricMap, T_a_b: Transform
) -> tuple[NDArray[np.int64], NDArray[np.int64], float]:
    """Pair the voxels of two maps that hold the same surface.

    The smaller map's voxels look for the nearest of the other, up to the coarser voxel's edge.

    Parameters
    ----------
    T_a_b : (4, 4) float64, between the level frames

    Returns
    -------
    rows_a, rows_b : (n,) int64, rows of the maps' voxels that lie on each other
    overlap : share of the smaller map's voxels among these, 0..1
    """
    smaller, larger, T = (a, b, inverse(T_a_b)) if len(a.voxels) < len(b.voxels) else (b, a, T_a_b)
    none = np.zeros(0, dtype=np.int64)
    if len(smaller.voxels) == 0:
        return none, none, 0.0
    reach = max(a.voxel_size, b.voxel_size)
    moved = apply(T, smaller.surface())
    # Only what lies within the other's bounds can have a neighbour there.
    target = larger.surface()
    inside = np.all(
        (moved >= target.min(axis=0) - reach) & (moved <= target.max(axis=0) + reach), axis=1
    )
    rows = np.flatnonzero(inside)
    if len(rows) == 0:
        return none, none, 0.0
    distance, nearest = cKDTree(target).query(moved[rows], distance_upper_bound=reach)
    found = np.isfinite(distance)
    rows, nearest = rows[found], nearest[found].astype(np.int64)
    overlap = len(rows) / len(smaller.voxels)
    return (rows, nearest, overlap) if smaller is a else (nearest, rows, overlap)


def same_rooms(
    a: TopometricMap,
    b: TopometricMap,
    rows_a: NDArray[np.int64],
    rows_b: NDArray[np.int64],
    least_share: float,
    least_part: float = 1.0,
) -> list[tuple[int, int]]:
    """Return the pairs of rows of rooms that are the same place.

    Rooms are assigned one to one by the voxels they share; a pair counts where these are at least
    `least_share` of the smaller room's part that the other map has seen at all. Where a map splits
    a room, its further pieces follow: pairs that share as much, and `least_part` of the smaller of
    the whole rooms as well.

    Parameters
    ----------
    rows_a, rows_b : (n,) int64, voxels that lie on each other (`shared_voxels`)
    least_share, least_part : 0..1; no further pieces where `least_part` is 1

    Returns
    -------
    pairs of rows of rooms: first those one to one, then the further ones, each by rising rows
    """
    if not (a.rooms and b.rooms):
        return []
    ids_a, ids_b = (np.array([room.id for room in m.rooms]) for m in (a, b))
    shared = joint_counts(a.room[rows_a], b.room[rows_b], ids_a, ids_b)[:-1, :-1]
    seen = np.minimum(shared.sum(axis=1)[:, None], shared.sum(axis=0)[None, :])
    same = (shared > 0) & (shared >= least_share * seen)
    pairs = zip(*linear_sum_assignment(-shared), strict=True)
    main = [(int(i), int(j)) for i, j in pairs if same[i, j]]
    if least_part >= 1.0:
        return main
    whole = np.minimum(_voxels_of(a, ids_a)[:, None], _voxels_of(b, ids_b)[None, :])
    pieces = np.argwhere(same & (shared >= np.maximum(least_part * whole, _FEWEST)))
    return main + sorted({(int(i), int(j)) for i, j in pieces} - set(main))


def _voxels_of(m: TopometricMap, ids: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return how many voxels each room has: (R,)."""
    known, counts = np.unique(m.room, return_counts=True)
    size = dict(zip(known.tolist(), counts.tolist(), strict=True))
    return np.array([size.get(int(i), 0) for i in ids], np.int64)
