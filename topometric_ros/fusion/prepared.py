"""A map with what aligning makes of it once, and a clock for the stages."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
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


class Stopwatch:
    """CPU seconds by stage."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the CPU time of the block to a stage."""
        start = time.process_time()
        try:
            yield
        finally:
            self.seconds[name] = self.seconds.get(name, 0.0) + time.process_time() - start
