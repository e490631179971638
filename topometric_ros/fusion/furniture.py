"""Whether furniture stands where it stood, to the centimetre.

Where a fifth of the furniture was moved between two visits, as much of it conflicts as in an
identical flat that is furnished alike. But what was not moved stands exactly where it stood, and in
another flat nothing does that was put there by hand: so each piece is laid on the other map's by
itself, and by how far it has to be moved tells the two apart. A piece beside a wall is fixed in one
direction only and says little, for desks are pushed against walls everywhere.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from topometric_ros.fusion.poses import Transform, apply, inverse
from topometric_ros.fusion.surface import Surface
from topometric_ros.topometric_map import TopometricMap

_LOWEST, _HIGHEST = 0.2, 1.9
"""Heights over the floor (m) between which furniture is looked at."""

_UPRIGHT = 0.35
"""Largest |z| of the normal of an upright face."""

_REACHES = (0.25, 0.25, 0.12, 0.12)
"""Distance (m) within which a face finds its counterpart, step by step."""

_NEIGHBOURS = 3
_PARALLEL = 0.8
"""Faces that one is laid on: so many at most, with normals that agree this well (cosine)."""

_FEWEST_POINTS, _FEWEST_PAIRS = 15, 12
"""Points of a piece, and pairs, from which its place can be told."""

_FIXED = 4.0
"""Pairs that must speak for a direction before a piece is fixed in it."""

_KEPT = 0.04
"""Offset in metres up to which a piece stands where it stood: drift moves whole rooms so far."""

_BY_CHANCE, _SURE = 0.3, 0.02
"""Share of the pieces that stand alike in a flat furnished to the same plan, and how unlikely it
must be that as many do by chance.

Right poses with a fifth of the furniture moved: 4 of 4 to 50 of 61; made flats alike to the
millimetre in part: 3 of 3 at most (docs/benchmarks.md)."""

_LEFT, _DISPLACED, _FEWEST = 0.7, 0.2, 2
"""Share of the pieces that stand where they stood between two visits at the least, and how unlikely
it must be that as few do, of so many pieces and more: below that they were put there anew.

Of 198 right poses one has as few (0 of 3); twin wings furnished otherwise 0 of 2 to 2 of 5."""


Furniture = tuple[Surface, NDArray[np.int64]]
"""Upright faces of furniture, and the number (n,) of the piece of each."""


@dataclass(frozen=True)
class Pieces:
    """How many pieces are fixed in both directions of the plan, and how many were not moved."""

    fixed: int
    kept: int

    @property
    def same(self) -> bool:
        """Whether more stand where they stood than in a flat furnished to the same plan."""
        return self.fixed > 0 and 1.0 - self._as_few(self.kept - 1, _BY_CHANCE) < _SURE

    @property
    def displaced(self) -> bool:
        """Whether fewer stand where they stood than moved furniture explains, if only by a hand."""
        return self.fixed >= _FEWEST and self._as_few(self.kept, _LEFT) < _DISPLACED

    def _as_few(self, count: int, share: float) -> float:
        """Return how likely so many or fewer of the fixed pieces stand where they stood."""
        return sum(
            math.comb(self.fixed, k) * share**k * (1.0 - share) ** (self.fixed - k)
            for k in range(count + 1)
        )


def compare_furniture(
    a: tuple[TopometricMap, Surface], b: tuple[TopometricMap, Surface], T_a_b: Transform
) -> Pieces:
    """Return how much furniture of two maps stands in the same place, piece by piece.

    Parameters
    ----------
    a, b : maps with their surfaces (`fusion.surface.surface_of`), level frames
    T_a_b : (4, 4) float64, m, registered to a centimetre or so
    """
    of_a, of_b = furniture_of(*a), furniture_of(*b)
    ways = (laid_on(of_a, of_b, T_a_b), laid_on(of_b, of_a, inverse(T_a_b)))
    # Most pieces were seen by both, so each is counted twice.
    fixed = math.ceil(sum(way.fixed for way in ways) / 2)
    return Pieces(fixed, sum(way.kept for way in ways) // 2)


def laid_on(a: Furniture, b: Furniture, T_a_b: Transform) -> Pieces:
    """Lay each piece of furniture of b on the furniture of a, moving it on the plan."""
    target, (source, piece) = a[0], b
    if len(target) == 0 or len(source) == 0:
        return Pieces(0, 0)
    tree = cKDTree(target.points)
    points, normals = apply(T_a_b, source.points), source.normals @ T_a_b[:3, :3].T
    fixed = kept = 0
    for number in np.unique(piece):
        own = piece == number
        offset = _offset(points[own], normals[own], target, tree)
        fixed += offset is not None
        kept += offset is not None and offset <= _KEPT
    return Pieces(fixed, kept)


def furniture_of(topometric_map: TopometricMap, surface: Surface) -> Furniture:
    """Return the upright faces of furniture, and the number of the piece of each."""
    piece = np.zeros(len(surface), dtype=np.int64)
    around = np.ones((3, 3), dtype=bool)
    for storey in topometric_map.storeys:
        layers, height = storey.layers, surface.points[:, 2] - storey.floor_z
        labels, _ = ndimage.label(ndimage.binary_dilation(layers.furniture, around), around)
        cells, inside = layers.cells_at(surface.points[:, :2])
        rows = np.flatnonzero(inside & (height > _LOWEST) & (height < _HIGHEST))
        found = labels[tuple(cells[rows].T)]
        piece[rows[found > 0]] = found[found > 0] + piece.max(initial=0)
    rows = np.flatnonzero(piece > 0)
    normals, _ = surface.facing(rows)
    rows = rows[np.abs(normals[:, 2]) < _UPRIGHT]
    return surface.take(rows), piece[rows]


def _offset(
    points: NDArray[np.float64], normals: NDArray[np.float64], target: Surface, tree: cKDTree
) -> float | None:
    """Return how far a piece's faces (n, 3) must be moved on the plan, m; None if not fixed."""
    if len(points) < _FEWEST_POINTS:
        return None
    offset = np.zeros(3)
    for reach in _REACHES:
        moved = points + offset
        distance, nearest = tree.query(moved, k=_NEIGHBOURS, distance_upper_bound=reach)
        found = np.isfinite(distance)
        nearest = np.where(found, nearest, 0)
        there = target.normals[nearest]
        found &= np.abs(np.sum(there * normals[:, None], axis=2)) > _PARALLEL
        if np.count_nonzero(found) < _FEWEST_PAIRS:
            return None
        n = there[found][:, :2]
        residual = np.sum(there * (target.points[nearest] - moved[:, None]), axis=2)[found]
        H = n.T @ n
        if np.linalg.eigvalsh(H)[0] <= _FIXED:
            return None
        offset[:2] += np.linalg.solve(H, n.T @ residual)
    return float(np.linalg.norm(offset))
