"""Whether two maps see a ceiling over the floor that a pose brings together.

Identical storeys without furniture lie on each other as well as on themselves. Above the topmost
there may be a roof far up, or nothing, where the others have a ceiling; the plans do not show it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.fusion.poses import Transform, apply
from topometric_ros.matching.search_fields import MapFields, StoreyFields, storey_pairs
from topometric_ros.matching.search_poses import pose_of
from topometric_ros.topometric_map import Storey, TopometricMap

_COLUMN = 0.2
"""Edge of the columns that are compared, m: wider than the gaps between a ceiling's points."""

_LOWEST, _HIGHEST = 1.9, 6.0
"""Heights over the floor (m) between which something is a ceiling; furniture ends below."""

_SLAB = 0.3
"""Thickness of the floor above, m: its upper side is a ceiling too where the lower was not seen."""

_FEWEST = 100
"""Columns in common from which they are judged: 4 m² of floor."""

_COVERED, _OPEN = 0.5, 0.03
"""Share of the common floor under a ceiling, at least in one map and at most in the other.

One storey laid on another had 0.65 to 0.91 against 0.00 or 0.01, right poses 0.91 against 0.49 or
0.60 against 0.06: the second agent sees some ceiling wherever there is one (docs/benchmarks.md)."""

_Columns = tuple[NDArray[np.bool_], NDArray[np.bool_]]


@dataclass(frozen=True)
class OpenAbove:
    """Floor in common that is under a ceiling in one map (share `covered`), not in the other."""

    covered: float
    open: float

    def reason(self) -> str:
        """Return it as a sentence."""
        return (
            f"one map has a ceiling over {self.covered:.0%} of the floor in common, the other, "
            f"which saw ceilings elsewhere, over {self.open:.0%}: another storey"
        )


def open_above(
    a: TopometricMap,
    b: TopometricMap,
    fields: tuple[MapFields, MapFields],
    T_a_b: Transform,
) -> OpenAbove | None:
    """Return by what the ceilings of two maps contradict each other, None where they do not.

    A map without any ceiling contradicts nothing: its sensor may not look up.

    Parameters
    ----------
    fields : what :func:`matching.search_fields.prepare` made of a and b
    T_a_b : (4, 4) float64, m, level frame of b to level frame of a
    """
    pose = pose_of(T_a_b)
    for i, j in storey_pairs(*fields, pose.height):
        one, other = fields[0].storeys[i], fields[1].storeys[j]
        covered_a, free_a = _columns(a, one)
        covered_b, free_b = _columns(b, other)
        cells = np.argwhere(free_b)
        places = np.column_stack([other.origin + (cells + 0.5) * _COLUMN, np.zeros(len(cells))])
        there = np.floor((apply(pose.matrix(), places)[:, :2] - one.origin) / _COLUMN).astype(int)
        inside = np.all((there >= 0) & (there < free_a.shape), axis=1)
        there, cells = there[inside], cells[inside]
        common = free_a[tuple(there.T)]
        if np.count_nonzero(common) < _FEWEST:
            continue
        shares = (
            float(covered_a[tuple(there[common].T)].mean()),
            float(covered_b[tuple(cells[common].T)].mean()),
        )
        low, sees_ceilings = min((shares[0], _any(a, one)), (shares[1], _any(b, other)))
        if max(shares) >= _COVERED and low <= _OPEN and sees_ceilings:
            return OpenAbove(max(shares), low)
    return None


def _any(m: TopometricMap, but: StoreyFields) -> bool:
    """Whether a map has a ceiling over another storey than one."""
    return any(s.ceiling_z is not None for s in m.storeys if s.floor_z != but.floor_z)


def _columns(m: TopometricMap, storey: StoreyFields) -> _Columns:
    """Return which columns of a storey are covered, and which are free floor; from its origin."""
    shape = tuple(-(-n // 2) for n in storey.kind.shape)
    points = m.surface() - (*storey.origin, storey.floor_z)
    above = points[(points[:, 2] > _LOWEST) & (points[:, 2] < _top(m.storeys, storey.floor_z))]
    index = np.floor(above[:, :2] / _COLUMN).astype(int)
    index = index[np.all((index >= 0) & (index < shape), axis=1)]
    covered, free = np.zeros(shape, bool), np.zeros(shape, bool)
    covered[tuple(index.T)] = True
    free[tuple((np.argwhere(storey.kind == 1) // 2).T)] = True
    return covered, free


def _top(storeys: tuple[Storey, ...], floor: float) -> float:
    """Return the height over a floor up to which something is its own ceiling, m."""
    above = [s.floor_z - floor + _SLAB for s in storeys if s.floor_z > floor + _LOWEST]
    return min([_HIGHEST, *above])
