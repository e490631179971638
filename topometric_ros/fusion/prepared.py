"""A map with what aligning makes of it, once."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from scipy.spatial import cKDTree

from topometric_ros.fusion.surface import Surface, surface_of
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.matching.descriptors import described
from topometric_ros.matching.search_fields import MapFields, ScoringConfig, prepare
from topometric_ros.topometric_map import TopometricMap


@dataclass(frozen=True)
class Prepared:
    """A map and what aligning makes of it, made once however many maps it is aligned with."""

    map: TopometricMap
    scoring: ScoringConfig
    matching: MatchingConfig

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
