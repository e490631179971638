"""A map's surface for registration: points, normals and, where it is known, the free side."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

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


@dataclass(frozen=True)
class Surface:
    """Points (N, 3) float64 in m, unit normals (N, 3), and which of them (N,) point to free space.

    A wall seen from one room must not attract the same wall seen from the next: where both normals
    are `sided` they must agree, where one is not, their sign means nothing.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    sided: NDArray[np.bool_]
    spacing: float
    """Typical distance of neighbouring points, m: the voxel's edge."""

    def __len__(self) -> int:
        return len(self.points)

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> Surface:
        """Return some of the points."""
        return Surface(self.points[rows], self.normals[rows], self.sided[rows], self.spacing)


def surface_of(topometric_map: TopometricMap) -> Surface:
    """Return the surface of a map in its level frame.

    Normals come from principal components. The free side of a wall is the one where floor was seen
    (the storey's `free` raster) and of a slab the one of its storey; a wall free on both sides, as
    a thin one seen from two rooms is, stays without.
    """
    points = topometric_map.surface()
    normals, _ = fit_planes(points, NEIGHBOURS)
    sided = np.zeros(len(points), dtype=bool)
    for storey in topometric_map.storeys:
        _side_walls(storey, points, normals, sided)
    _side_slabs(topometric_map.storeys, points, normals, sided)
    return Surface(points, normals, sided, topometric_map.voxel_size)


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
