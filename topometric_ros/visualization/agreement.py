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

NOTHING, FREE, OWN, AGREES, CONFLICTS = range(5)
"""What a cell of a judged storey shows: nothing seen, floor, or a wall and the other's view."""

AGREE_CELLS = 1.5
"""A wall agrees where the other map's nearest wall is at most this many cells away."""
CONFLICT_CELLS = 2.0
"""A wall conflicts where it lies at least this many cells inside the other's free floor."""
SAME_FLOOR = 0.35
"""Floors whose heights differ by at most this are one storey, m."""


@dataclass(frozen=True)
class JudgedStorey:
    """One map's storey, each cell judged by the other map: `verdict` (nx, ny) uint8."""

    layers: StoreyLayers
    verdict: NDArray[np.uint8]


@dataclass(frozen=True)
class StoreyAgreement:
    """One storey of both maps; None where a map lacks it. `floor_z` in m, level frame of a."""

    floor_z: float
    a: JudgedStorey | None
    b: JudgedStorey | None


def level_transform(
    a: TopometricMap, b: TopometricMap, T_a_b: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return `T_a_b`, given between the input frames, between the level frames: (4, 4) m."""
    T: NDArray[np.float64] = a.T_level_input @ T_a_b @ np.linalg.inv(b.T_level_input)
    return T


def compare(
    a: TopometricMap, b: TopometricMap, T_a_b: NDArray[np.float64]
) -> list[StoreyAgreement]:
    """Lay map b over map a and judge the wall cells of both, lowest storey first.

    Parameters
    ----------
    T_a_b : (4, 4) float64, m, from the input frame of b to that of a
    """
    T_level = level_transform(a, b, T_a_b)
    rise = float(T_level[2, 3])
    pairs: list[tuple[float, StoreyLayers | None, StoreyLayers | None]] = []
    unpaired = list(b.storeys)
    for storey in sorted(a.storeys, key=lambda s: s.floor_z):
        same = [s for s in unpaired if abs(s.floor_z + rise - storey.floor_z) < SAME_FLOOR]
        unpaired = [s for s in unpaired if s not in same[:1]]
        pairs.append((storey.floor_z, storey.layers, same[0].layers if same else None))
    pairs += [(s.floor_z + rise, None, s.layers) for s in unpaired]
    T_b_a = np.asarray(np.linalg.inv(T_level), dtype=np.float64)
    return [
        StoreyAgreement(floor_z, _judged(own, other, T_b_a), _judged(other, own, T_level))
        for floor_z, own, other in sorted(pairs, key=lambda pair: pair[0])
    ]


def _judged(
    own: StoreyLayers | None, other: StoreyLayers | None, T_other_own: NDArray[np.float64]
) -> JudgedStorey | None:
    """Judge each wall cell of `own` by what `other` shows at its place."""
    if own is None:
        return None
    verdict = np.where(own.free, FREE, NOTHING).astype(np.uint8)
    verdict[own.wall] = OWN
    if other is None or not own.wall.any():
        return JudgedStorey(own, verdict)
    cells = np.argwhere(own.wall)
    places = (cells * own.cell + np.asarray(own.origin)) @ T_other_own[:2, :2].T
    theirs = np.round((places + T_other_own[:2, 3] - np.asarray(other.origin)) / other.cell)
    inside = ((theirs >= 0) & (theirs < other.wall.shape)).all(axis=1)
    cells, there = cells[inside], tuple(theirs[inside].astype(np.int64).T)
    if other.wall.any():
        near = ndimage.distance_transform_edt(~other.wall)[there] <= AGREE_CELLS
    else:
        near = np.zeros(len(cells), dtype=bool)
    deep = ndimage.distance_transform_edt(other.free)[there] >= CONFLICT_CELLS
    verdict[tuple(cells[deep & ~near].T)] = CONFLICTS
    verdict[tuple(cells[near].T)] = AGREES
    return JudgedStorey(own, verdict)
