"""A map's surface for registration: points, normals and, where it is known, the free side."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.matching.planes import fit_planes
from topometric_ros.topometric_map import Storey, TopometricMap

NEIGHBOURS = 10
"""Voxels that a normal is fitted through: about 0.35 m of wall at 0.1 m voxels."""

_ASIDE = (0.15, 0.2, 0.25, 0.3, 0.35, 0.4)
"""How far from a wall, in metres, its free side shows seen floor."""

_NEARER = 0.1
"""By how much (m) the floor on one side of a wall must be nearer than on the other to be its own.

The face of a wall 0.16 m thick has floor beyond the wall too where both rooms were seen."""

_WALL_TOP = 2.2
"""Height (m) up to which walls are told apart where no ceiling was seen."""

_SLAB = 0.15
"""Points this near to a storey's floor or ceiling (m) are seen from that storey."""


class Surface:
    """Points (N, 3) float64 in m, unit normals (N, 3), and which of them (N,) point to free space.

    A wall seen from one room must not attract the same wall seen from the next: where both normals
    are `sided` they must agree, where one is not, their sign means nothing. `spacing` is the
    typical distance of neighbouring points, m: the voxel's edge.
    """

    def __init__(
        self,
        points: NDArray[np.float64],
        normals: NDArray[np.float64],
        sided: NDArray[np.bool_],
        spacing: float,
    ) -> None:
        self.points = points
        self.spacing = spacing
        self._normals = normals
        self._sided = sided

    def __len__(self) -> int:
        return len(self.points)

    @property
    def normals(self) -> NDArray[np.float64]:
        """Unit normals of all points: (N, 3)."""
        self._fit(np.arange(len(self)))
        return self._normals

    @property
    def sided(self) -> NDArray[np.bool_]:
        """Whether each normal points to free space: (N,)."""
        self._fit(np.arange(len(self)))
        return self._sided

    @cached_property
    def tree(self) -> cKDTree:
        """Tree of the points."""
        return cKDTree(self.points)

    def facing(self, rows: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return some points' normals (n, 3) and which of these point to free space (n,)."""
        self._fit(rows)
        return self._normals[rows], self._sided[rows]

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Surface:
        """Return the surface of some points: their rows (n,), or a mask of all."""
        kept = np.arange(len(self))[rows]
        return Surface(self.points[kept], *self.facing(kept), self.spacing)

    def _fit(self, rows: NDArray[np.int64]) -> None:
        """Make sure that the normals of some points are there."""


class _MapSurface(Surface):
    """The surface of a map, whose normals are fitted where they are asked for.

    Registering a pair looks at some ten thousand points, and a map may have a million. What two
    threads fit at once is the same.
    """

    def __init__(self, topometric_map: TopometricMap) -> None:
        points = topometric_map.surface()
        n = len(points)
        super().__init__(
            points, np.zeros((n, 3)), np.zeros(n, dtype=bool), topometric_map.voxel_size
        )
        self._storeys = topometric_map.storeys
        self._fitted = np.zeros(n, dtype=bool)

    def _fit(self, rows: NDArray[np.int64]) -> None:
        missing = rows[~self._fitted[rows]]
        if len(missing) == 0:
            return
        missing = np.unique(missing)
        points = self.points[missing]
        normals, _ = fit_planes(self.points, NEIGHBOURS, missing, self.tree)
        sided = np.zeros(len(points), dtype=bool)
        for storey in self._storeys:
            _side_walls(storey, points, normals, sided)
        _side_slabs(self._storeys, points, normals, sided)
        self._normals[missing], self._sided[missing] = normals, sided
        self._fitted[missing] = True


def surface_of(topometric_map: TopometricMap) -> Surface:
    """Return the surface of a map in its level frame.

    Normals come from principal components. The free side of a wall is the one where floor was seen
    (the storey's `free` raster) and of a slab the one of its storey; a wall free on both sides, as
    a thin one seen from two rooms is, stays without.
    """
    return _MapSurface(topometric_map)


def _side_walls(
    storey: Storey,
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    sided: NDArray[np.bool_],
) -> None:
    """Turn the normals of one storey's walls to their free side, in place."""
    height = points[:, 2] - storey.floor_z
    top = _WALL_TOP if storey.ceiling_z is None else storey.ceiling_z - storey.floor_z - _SLAB
    rows = np.flatnonzero((height > 0.2) & (height < top) & (np.abs(normals[:, 2]) < 0.35))
    ahead, behind = np.full((2, len(rows)), np.inf)
    for distance in reversed(_ASIDE):
        ahead[_seen_free(storey, points[rows] + distance * normals[rows])] = distance
        behind[_seen_free(storey, points[rows] - distance * normals[rows])] = distance
    away = behind + _NEARER - 1e-9 < ahead
    normals[rows[away]] *= -1.0
    sided[rows[away | (ahead + _NEARER - 1e-9 < behind)]] = True


def _side_slabs(
    storeys: Sequence[Storey],
    points: NDArray[np.float64],
    normals: NDArray[np.float64],
    sided: NDArray[np.bool_],
) -> None:
    """Turn the normals of floors up and of ceilings down, in place.

    The faces of a thin slab lie nearer to each other than points may lie off a face, so the nearest
    face counts: a ceiling taken for the floor upon it lifts a map by the thickness of the slab.
    """
    faces = [(s.floor_z, 1.0) for s in storeys]
    faces += [(s.ceiling_z, -1.0) for s in storeys if s.ceiling_z is not None]
    if not faces:
        return
    rows = np.flatnonzero(np.abs(normals[:, 2]) > 0.8)
    z, sign = np.array(faces).T
    distance = np.abs(points[rows, 2][:, None] - z)
    nearest = distance.argmin(axis=1)
    near = distance[np.arange(len(rows)), nearest] < _SLAB
    rows, nearest = rows[near], nearest[near]
    normals[rows] *= (sign[nearest] * np.sign(normals[rows, 2]))[:, None]
    sided[rows] = True


def _seen_free(storey: Storey, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Return whether each point (n, 3) stands above seen-free floor."""
    cells, inside = storey.layers.cells_at(points[:, :2])
    return inside & storey.layers.free[cells[:, 0], cells[:, 1]]
