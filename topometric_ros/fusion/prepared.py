"""A map with what aligning makes of it, once."""

from __future__ import annotations

from collections.abc import Callable, Hashable
from dataclasses import dataclass, field
from threading import RLock
from typing import Any, TypeVar

from scipy.spatial import cKDTree

from topometric_ros.fusion.resolution import coarsened
from topometric_ros.fusion.surface import Surface, surface_of
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.matching.descriptors import described
from topometric_ros.matching.search_fields import MapFields, ScoringConfig, prepare
from topometric_ros.topometric_map import TopometricMap

MadeT = TypeVar("MadeT")

_SAME_SIZE = 1.01
"""Factor up to which two voxel sizes are one."""


@dataclass(frozen=True)
class Prepared:
    """A map and what aligning makes of it, made once however many maps it is aligned with.

    Several threads may ask at the same time: what two of them need is made by the first.
    """

    map: TopometricMap
    scoring: ScoringConfig
    matching: MatchingConfig
    _made: dict[Hashable, Any] = field(default_factory=dict, init=False, repr=False, compare=False)
    _lock: RLock = field(default_factory=RLock, init=False, repr=False, compare=False)

    def at(self, voxel_size: float) -> Prepared:
        """Return the map at a coarser voxel size (m), made once; itself where it is no finer."""
        if voxel_size <= _SAME_SIZE * self.map.voxel_size:
            return self
        return self._once(
            voxel_size,
            lambda: Prepared(coarsened(self.map, voxel_size), self.scoring, self.matching),
        )

    @property
    def described(self) -> TopometricMap:
        """The map with the descriptors that the configuration asks for."""
        return self._once("described", lambda: described(self.map, self.matching))

    @property
    def fields(self) -> MapFields:
        """The storeys' lookup tables."""
        return self._once("fields", lambda: prepare(self.map, self.scoring))

    @property
    def surface(self) -> Surface:
        """Points and normals, level frame."""
        return self._once("surface", lambda: surface_of(self.map))

    @property
    def tree(self) -> cKDTree:
        """Tree of the surface's points."""
        return self._once("tree", lambda: self.surface.tree)

    def _once(self, key: Hashable, make: Callable[[], MadeT]) -> MadeT:
        with self._lock:
            if key not in self._made:
                self._made[key] = make()
            made: MadeT = self._made[key]
            return made
