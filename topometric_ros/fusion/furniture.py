"""Whether furniture stands where it stood, to the centimetre.

Where a fifth of the furniture was moved between two visits, as much of it conflicts as in an
identical flat that is furnished alike. But what was not moved stands exactly where it stood, and in
another flat little does that was put there by hand: so each piece is laid on the other map's by
itself, and by how far it has to be moved tells the two apart. A piece of which one face was seen is
fixed in one direction only and says less, for desks are pushed against walls everywhere. Drift
moves whole rooms, so the walls around a piece are laid on the other map's too, and it is measured
from them.
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

_FIXED, _SLANT = 4.0, 0.05
"""Pairs that must speak for a direction before a piece is fixed in it, and their share of those
that speak for the other one: normals are some degrees off, so a long face seems to hold its ends
too."""

_KEPT = 0.03
"""Offset from the walls around it, m, up to which a piece stands where it stood."""

_AROUND, _IN_PLACE = 4.0, 0.02
"""Distance (m) of the walls around a piece, and the offset (m) up to which they are in place."""

_HERE, _ALIKE = {1: 0.9, 2: 0.88}, {1: 0.55, 2: 0.3}
"""Share of the pieces fixed in one and in two directions that stand where they stood, between two
visits of one place, a fifth moved in between, and in a flat furnished to the same plan by hand.

Measured: 0.93 and 0.86 in noisy maps of one place, 0.47 and 0.29 in twins furnished otherwise, 0.52
and 0.21 in identical storeys (docs/benchmarks.md)."""

_SAME, _DISPLACED = 50.0, 20.0
"""Odds from which the furniture is that of one place, and from which it was put there anew.

Only pieces count against a place whose walls are in place, as a twin's are: where they are not it
is drift."""


@dataclass(frozen=True)
class Furniture:
    """Upright faces of furniture, the number (n,) of the piece of each, and the walls as high."""

    faces: Surface
    piece: NDArray[np.int64]
    walls: Walls


@dataclass(frozen=True)
class Pieces:
    """How many pieces are fixed by their faces, how many were not moved, and what that tells.

    `odds` is the logarithm of how much likelier that is of one place than of two that are furnished
    alike; `placed` is the same of the pieces of which the walls around are in place.
    """

    fixed: int
    kept: int
    odds: float = 0.0
    placed: float = 0.0

    @property
    def same(self) -> bool:
        """Whether more stand where they stood than in a flat furnished to the same plan."""
        return self.odds > math.log(_SAME)

    @property
    def displaced(self) -> bool:
        """Whether fewer stand where they stood than moved furniture explains, if only by a hand."""
        return self.placed < -math.log(_DISPLACED)


def _odds(directions: int, kept: bool) -> float:
    """Return the log odds of one place, by one piece fixed in so many directions."""
    here, alike = _HERE[directions], _ALIKE[directions]
    return math.log(here / alike) if kept else math.log((1.0 - here) / (1.0 - alike))


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
    # Most pieces were seen by both, so each is counted twice; halves speak against both findings.
    return Pieces(
        fixed=math.ceil(sum(way.fixed for way in ways) / 2),
        kept=sum(way.kept for way in ways) // 2,
        odds=sum(way.odds for way in ways) / 2.0,
        placed=sum(way.placed for way in ways) / 2.0,
    )


def laid_on(a: Furniture, b: Furniture, T_a_b: Transform) -> Pieces:
    """Lay each piece of furniture of b on the furniture of a, moving it on the plan."""
    if len(a.faces) == 0 or len(b.faces) == 0:
        return Pieces(0, 0)
    target = _Target(a.faces)
    points, normals = apply(T_a_b, b.faces.points), b.faces.normals @ T_a_b[:3, :3].T
    fixed, kept_pieces, odds, placed = 0, 0, 0.0, 0.0
    for number in np.unique(b.piece):
        own = b.piece == number
        found = target.offset(points[own], normals[own])
        if found is None:
            continue
        offset, axes = found
        kept = in_place = _length(offset) <= _KEPT
        if not kept:
            walls = _walls_moved(a.walls, b.walls, b.faces.points[own].mean(axis=0), T_a_b)
            kept = walls is not None and _length(axes.T @ (offset - walls)) <= _KEPT
            in_place = walls is not None and _length(walls) <= _IN_PLACE
        told = _odds(axes.shape[1], kept)
        fixed, kept_pieces, odds = fixed + 1, kept_pieces + kept, odds + told
        placed += told if in_place else 0.0
    return Pieces(fixed, kept_pieces, odds, placed)


def _walls_moved(
    a: Walls, b: Walls, centre: NDArray[np.float64], T_a_b: Transform
) -> NDArray[np.float64] | None:
    """Return how b's walls around a point of b must be moved onto a's, (2,) m; None if unknown."""
    source = b.around(centre, _AROUND)
    target = a.around(apply(T_a_b, centre[None])[0], _AROUND + _REACHES[0])
    found = _Target(target).offset(apply(T_a_b, source.points), source.normals @ T_a_b[:3, :3].T)
    return found[0] if found is not None and found[1].shape[1] == 2 else None


def furniture_of(topometric_map: TopometricMap, surface: Surface) -> Furniture:
    """Return the upright faces of furniture and the walls as high as it."""
    piece, high = np.zeros(len(surface), dtype=np.int64), np.zeros(len(surface), dtype=np.bool_)
    around = np.ones((3, 3), dtype=bool)
    for storey in topometric_map.storeys:
        layers, height = storey.layers, surface.points[:, 2] - storey.floor_z
        labels, _ = ndimage.label(ndimage.binary_dilation(layers.furniture, around), around)
        cells, inside = layers.cells_at(surface.points[:, :2])
        rows = np.flatnonzero(inside & (height > _LOWEST) & (height < _HIGHEST))
        high[rows] = True
        found = labels[tuple(cells[rows].T)]
        piece[rows[found > 0]] = found[found > 0] + piece.max(initial=0)
    rows = _upright(surface, np.flatnonzero(piece > 0))
    walls = Walls(surface, np.flatnonzero(high & (piece == 0)))
    return Furniture(surface.take(rows), piece[rows], walls)


def _upright(surface: Surface, rows: NDArray[np.int64]) -> NDArray[np.int64]:
    normals, _ = surface.facing(rows)
    return rows[np.abs(normals[:, 2]) < _UPRIGHT]


class Walls:
    """What is as high as furniture and none; its normals are fitted where it is asked for."""

    def __init__(self, surface: Surface, rows: NDArray[np.int64]) -> None:
        self._surface, self._rows = surface, rows

    def around(self, centre: NDArray[np.float64], distance: float) -> Surface:
        """Return the upright faces within a distance (m) of a point (3,), on the plan."""
        apart = self._surface.points[self._rows] - centre
        near = self._rows[np.hypot(apart[:, 0], apart[:, 1]) <= distance]
        return self._surface.take(_upright(self._surface, near))


def _length(offset: NDArray[np.float64]) -> float:
    return float(np.linalg.norm(offset))


class _Target:
    """Faces that others are laid on."""

    def __init__(self, faces: Surface) -> None:
        self._points, self._normals = faces.points, faces.normals
        self._tree = cKDTree(faces.points)

    def offset(
        self, points: NDArray[np.float64], normals: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]] | None:
        """Return how faces (n, 3) must be moved on the plan, (2,) m, and the axes that fix them.

        The axes (2, 1) or (2, 2) are unit vectors that the move lies in. None if not fixed at all.
        """
        if len(points) < _FEWEST_POINTS or len(self._points) == 0:
            return None
        offset = np.zeros(3)
        for reach in _REACHES:
            moved = points + offset
            distance, nearest = self._tree.query(moved, k=_NEIGHBOURS, distance_upper_bound=reach)
            found = np.isfinite(distance)
            nearest = np.where(found, nearest, 0)
            there = self._normals[nearest]
            found &= np.abs(np.sum(there * normals[:, None], axis=2)) > _PARALLEL
            if np.count_nonzero(found) < _FEWEST_PAIRS:
                return None
            n = there[found][:, :2]
            residual = np.sum(there * (self._points[nearest] - moved[:, None]), axis=2)[found]
            speaking, axes = np.linalg.eigh(n.T @ n)
            fixed = speaking > max(_FIXED, _SLANT * speaking[1])
            if not fixed.any():
                return None
            axes = axes[:, fixed]
            offset[:2] += axes @ (axes.T @ (n.T @ residual) / speaking[fixed])
        return offset[:2], axes
