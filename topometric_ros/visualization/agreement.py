"""Where two aligned maps agree and where they contradict each other, storey by storey.

A wall cell of one map agrees where the other has a wall too, and conflicts where the other saw
free floor well inside: what an operator looks for before trusting an alignment.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.topometric_map import StoreyLayers, TopometricMap

AGREE_CELLS = 1.5
"""A wall agrees where the other map's nearest wall is at most this many cells away."""
CONFLICT_CELLS = 2.0
"""A wall conflicts where it lies at least this many cells inside the other's free floor."""
SAME_FLOOR = 0.35
"""Floors whose heights differ by at most this are one storey, m."""


@dataclass(frozen=True)
class StoreyAgreement:
    """The wall cells of one storey of both maps: each (n, 2) float64, m, level frame of map a."""

    floor_z: float
    only_a: NDArray[np.float64]
    only_b: NDArray[np.float64]
    both: NDArray[np.float64]
    conflict: NDArray[np.float64]
    free_a: NDArray[np.float64]
    free_b: NDArray[np.float64]
    cell: float


def compare(
    a: TopometricMap, b: TopometricMap, T_a_b: NDArray[np.float64]
) -> list[StoreyAgreement]:
    """Lay map b over map a and sort their wall cells, lowest storey first.

    Parameters
    ----------
    T_a_b : (4, 4) float64, m, from the input frame of b to that of a
    """
    T_level = a.T_level_input @ T_a_b @ np.linalg.inv(b.T_level_input)
    pairs: list[tuple[float, StoreyLayers | None, StoreyLayers | None]] = []
    unpaired = list(b.storeys)
    for storey in sorted(a.storeys, key=lambda s: s.floor_z):
        same = [s for s in unpaired if abs(s.floor_z + T_level[2, 3] - storey.floor_z) < SAME_FLOOR]
        unpaired = [s for s in unpaired if s not in same]
        pairs.append((storey.floor_z, storey.layers, same[0].layers if same else None))
    pairs += [(s.floor_z + float(T_level[2, 3]), None, s.layers) for s in unpaired]
    pairs.sort(key=lambda pair: pair[0])
    return [_compare_storey(z, la, lb, T_level) for z, la, lb in pairs]


def _compare_storey(
    floor_z: float,
    a: StoreyLayers | None,
    b: StoreyLayers | None,
    T_a_b: NDArray[np.float64],
) -> StoreyAgreement:
    """Sort the wall cells of one storey; either map may lack it."""
    T_b_a: NDArray[np.float64] = np.asarray(np.linalg.inv(T_a_b), dtype=np.float64)
    none = np.empty((0, 2))
    walls_a, free_a = (_places(a, a.wall), _places(a, a.free)) if a else (none, none)
    walls_b, free_b = (_places(b, b.wall), _places(b, b.free)) if b else (none, none)
    agree_a, conflict_a = _judge(_moved(walls_a, T_b_a), b)
    walls_b, free_b = _moved(walls_b, T_a_b), _moved(free_b, T_a_b)
    agree_b, conflict_b = _judge(walls_b, a)
    layers = a or b
    return StoreyAgreement(
        floor_z=floor_z,
        only_a=walls_a[~agree_a & ~conflict_a],
        only_b=walls_b[~agree_b & ~conflict_b],
        both=np.concatenate([walls_a[agree_a], walls_b[agree_b]]),
        conflict=np.concatenate([walls_a[conflict_a], walls_b[conflict_b]]),
        free_a=free_a,
        free_b=free_b,
        cell=layers.cell if layers else 0.1,
    )


def _places(layers: StoreyLayers, mask: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Return the centres of a mask's cells: (n, 2) float64, m."""
    return np.argwhere(mask) * layers.cell + np.asarray(layers.origin)


def _moved(places: NDArray[np.float64], T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Move places in the plane: (n, 2) float64, m."""
    return places @ T[:2, :2].T + T[:2, 3]


def _judge(
    places: NDArray[np.float64], other: StoreyLayers | None
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which wall cells agree with the other map and which contradict it: (n,) bool each."""
    if other is None or not len(places):
        return np.zeros(len(places), bool), np.zeros(len(places), bool)
    if other.wall.any():
        to_wall = ndimage.distance_transform_edt(~other.wall)
    else:
        to_wall = np.full(other.wall.shape, np.inf)
    depth = ndimage.distance_transform_edt(other.free)
    cells = np.round((places - np.asarray(other.origin)) / other.cell).astype(np.int64)
    inside = ((cells >= 0) & (cells < other.wall.shape)).all(axis=1)
    agree, conflict = np.zeros(len(places), bool), np.zeros(len(places), bool)
    i, j = cells[inside].T
    agree[inside] = to_wall[i, j] <= AGREE_CELLS
    conflict[inside] = (depth[i, j] >= CONFLICT_CELLS) & ~agree[inside]
    return agree, conflict
