"""A map with what aligning makes of it, once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from scipy.spatial import cKDTree

from topometric_ros.fusion.resolution import coarsened
from topometric_ros.fusion.surface import Surface, surface_of
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.matching.descriptors import described
from topometric_ros.matching.search_fields import MapFields, ScoringConfig, prepare
from topometric_ros.topometric_map import TopometricMap

_SAME_SIZE = 1.01
"""Factor up to which two voxel sizes are one."""


@dataclass(frozen=True)
class Prepared:
    """A map and what aligning makes of it, made once however many maps it is aligned with."""

    map: TopometricMap
    scoring: ScoringConfig
    matching: MatchingConfig

    def at(self, voxel_size: float) -> Prepared:
        """Return the map at a coarser voxel size (m), made once; itself where it is no finer."""
        if voxel_size <= _SAME_SIZE * self.map.voxel_size:
            return self
        if voxel_size not in self._coarser:
            coarse = Prepared(coarsened(self.map, voxel_size), self.scoring, self.matching)
            self._coarser[voxel_size] = coarse
        return self._coarser[voxel_size]

    @cached_property
    def _coarser(self) -> dict[float, Prepared]:
        return {}

    @cached_property
    def described(self) -> TopometricMap:
        """The map with the descriptors that the configuration asks for."""
        return described(self.map, self.matching)

    @cached_property
    def fields(self) -> MapFields:
        """The storeys' lookup tables."""
        return prepare(self.map, self.scoring)

    @cached_property
    def surface(self) -> Surface:
        """Points and normals, level frame."""
        return surface_of(self.map)

    @cached_property
    def tree(self) -> cKDTree:
        """Tree of the surface's points."""
        return cKDTree(self.surface.points)
