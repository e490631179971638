"""Where a newer map contradicts an older one: furniture that moved, doors that were opened or shut.

What an older map holds where a newer one saw the bare floor is gone, and what a newer one holds
where an older saw the bare floor has appeared. The newest is kept, so nothing is doubled. Robots
that map at the same time cannot be put in order: their changes are marked and nothing is dropped.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage
from scipy.spatial import cKDTree

from topometric_ros.alignment import Change
from topometric_ros.configuration import parameter
from topometric_ros.fusion.poses import Transform, apply, inverse
from topometric_ros.topometric_map import Storey, TopometricMap
from topometric_ros.voxels.components import connected_components
from topometric_ros.voxels.kernels import moore

Placed = tuple[int, TopometricMap, Transform]
"""Index of an agent, its map, and its level frame's transform to the global level frame."""

_LOWEST, _HIGHEST = 0.3, 2.0
"""Heights over the floor, m, between which bare floor says that nothing stood there."""


@dataclass(frozen=True)
class ChangesConfig:
    """When two maps disagree about what stands somewhere."""

    keep_newest: bool = parameter(
        True, "Drop what an older map holds where a newer one saw the bare floor."
    )
    visits: float = parameter(
        600.0, "Maps whose newest input lies farther apart in time than this are of different "
        "visits.", unit="s", minimum=0.0, maximum=1e9,
    )  # fmt: skip
    depth: float = parameter(
        0.2, "How deep in the bare floor something must stand to contradict it.", unit="m",
        minimum=0.05, maximum=1.0,
    )  # fmt: skip
    smallest: int = parameter(
        20, "Voxels that hang together from which something has changed.", minimum=1
    )


class _Witness:
    """A map as what it saw to be bare floor, prepared once for all others."""

    def __init__(self, m: TopometricMap, depth: float) -> None:
        self.map = m
        self._storeys = []
        for storey in m.storeys:
            deep = storey.layers.bare
            if steps := round(depth / storey.layers.cell):
                deep = ndimage.binary_erosion(deep, np.ones((3, 3), bool), iterations=steps)
            self._storeys.append((storey.floor_z, storey.layers, deep))

    @cached_property
    def tree(self) -> cKDTree:
        """Tree of the map's surface, level frame."""
        return cKDTree(self.map.surface())

    def saw_bare(self, points: NDArray[np.float64], deep: bool) -> NDArray[np.bool_]:
        """Return which points (N, 3), level frame, stand in the bare floor, or deep in it."""
        found = np.zeros(len(points), bool)
        for floor, layers, eroded in self._storeys:
            height = points[:, 2] - floor
            rows = np.flatnonzero((height > _LOWEST) & (height < _HIGHEST))
            cells, inside = layers.cells_at(points[rows, :2])
            bare = eroded if deep else layers.bare
            found[rows[inside]] |= bare[cells[inside, 0], cells[inside, 1]]
        return found


def without_outdated(
    placed: Sequence[Placed], config: ChangesConfig
) -> tuple[list[Placed], tuple[Change, ...]]:
    """Return the maps without what newer ones saw to be gone, and all that has changed.

    Rasters lose what is gone too, and cells that could be stood on before something appeared.
    """
    result = list(placed)
    changes: list[Change] = []
    witnesses = [(index, _Witness(m, config.depth), T) for index, m, T in placed]
    for k, (holder, m, T) in enumerate(placed):
        dropped = np.zeros(len(m.voxels), bool)
        surface = m.surface()
        for witness, other, T_other in witnesses:
            if witness == holder or len(surface) == 0:
                continue
            to_witness = inverse(T_other) @ T
            rows = _contradicted(m, apply(to_witness, surface), other, config)
            if len(rows) == 0:
                continue
            later = (m.stamp - other.map.stamp) / 1e9
            ordered = abs(later) > config.visits
            gone = ordered and later < 0 and config.keep_newest
            changes.append(Change(holder, witness, gone, ordered, apply(T, surface[rows])))
            if gone:
                dropped[rows] = True
                m = replace(m, storeys=_cleared(m.storeys, other, to_witness))
        result[k] = (holder, _without(m, dropped), T)
    return _unwalkable(result, changes), tuple(changes)


def told(changes: Sequence[Change], names: Sequence[str]) -> list[str]:
    """Return the changes in words, a sentence for each pair of agents."""
    lines = []
    for change in changes:
        holder, witness = names[change.holder], names[change.witness]
        voxels = f"{len(change.points)} voxels of {holder} stand where {witness} saw the bare floor"
        what = "marked only: the maps are of one time"
        if change.ordered:
            what = "older, so they are left out" if change.gone else "newer, so they are kept"
        lines.append(f"changed: {voxels} ({what})")
    return lines


def _contradicted(
    m: TopometricMap, points: NDArray[np.float64], other: _Witness, config: ChangesConfig
) -> NDArray[np.int64]:
    """Return the rows of m's voxels that stand where the other map saw the bare floor.

    Parameters
    ----------
    points : (N, 3) float64, m, m's surface in the other's level frame
    """
    deep = other.saw_bare(points, deep=True)
    if not deep.any():
        return np.zeros(0, np.int64)
    # What stands deep in the bare floor takes along what hangs on it up to the floor's edge.
    rows = np.flatnonzero(other.saw_bare(points, deep=False))
    reach = 2.0 * max(m.voxel_size, other.map.voxel_size)
    rows = rows[~np.isfinite(other.tree.query(points[rows], distance_upper_bound=reach)[0])]
    if len(rows) == 0:
        return rows
    part = connected_components(m.voxels[rows], moore())
    large = np.bincount(part, weights=deep[rows]) >= config.smallest
    return rows[large[part]]


def _cleared(storeys: Sequence[Storey], other: _Witness, to_other: Transform) -> tuple[Storey, ...]:
    """Return storeys whose rasters hold nothing where another map saw the bare floor."""
    result = []
    for storey in storeys:
        layers = storey.layers
        filled = np.argwhere(layers.furniture | layers.wall)
        there = np.column_stack(
            [
                np.asarray(layers.origin) + layers.cell * filled,
                np.full(len(filled), storey.floor_z + 1.0),
            ]
        )
        gone = filled[other.saw_bare(apply(to_other, there), deep=True)]
        wall, furniture = layers.wall.copy(), layers.furniture.copy()
        wall[gone[:, 0], gone[:, 1]] = furniture[gone[:, 0], gone[:, 1]] = False
        result.append(replace(storey, layers=replace(layers, wall=wall, furniture=furniture)))
    return tuple(result)


def _without(m: TopometricMap, dropped: NDArray[np.bool_]) -> TopometricMap:
    """Return a map without some of its voxels."""
    if not dropped.any():
        return m
    kept = ~dropped
    return replace(m, voxels=m.voxels[kept], offsets=m.offsets[kept], room=m.room[kept])


def _unwalkable(placed: Sequence[Placed], changes: Sequence[Change]) -> list[Placed]:
    """Take from older maps the cells to stand on where something appeared."""
    result = []
    for index, m, T in placed:
        appeared = [c.points for c in changes if c.witness == index and c.ordered and not c.gone]
        if appeared and len(m.navigable):
            points = apply(inverse(T), np.concatenate(appeared))
            centres = np.asarray(m.origin) + m.navigable * m.voxel_size
            flat = cKDTree(points[:, :2]).query(
                centres[:, :2], distance_upper_bound=1.5 * m.voxel_size
            )[1]
            hit = flat < len(points)
            over = points[np.where(hit, flat, 0), 2] - centres[:, 2]
            m = replace(m, navigable=m.navigable[~(hit & (np.abs(over) < _HIGHEST + 0.3))])
        result.append((index, m, T))
    return result
