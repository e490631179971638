"""A room by its place in the topological graph alone: what geometry has to be compared with.

Degree, the degrees of the neighbours, rooms within two steps, and the gaps between the directions
in which passages lie, seen from the room's middle (after Huang & Beevers 2005). Nothing here looks
at the room's own shape.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.matching.room_graph import RoomGraph, room_graph
from topometric_ros.topometric_map import TopometricMap

_NEIGHBOURS = 4
_GAPS = 4


@dataclass(frozen=True)
class TopologicalDescriptor:
    """Degree, two-step reach, the largest degrees nearby and the largest gaps between doors."""

    version: int = 1

    @property
    def name(self) -> str:
        """What the descriptor is called in a map."""
        return "topological"

    @property
    def dimension(self) -> int:
        """Length of the vector."""
        return 2 + _NEIGHBOURS + _GAPS

    @property
    def by_ratio(self) -> bool:
        """Whether values are compared by their logarithm."""
        return True

    def __call__(
        self, topometric_map: TopometricMap, members: Sequence[Sequence[int]] | None = None
    ) -> NDArray[np.float32]:
        """Describe every room: (R, 10) float32; a set of rooms in `members` by their mean."""
        graph = room_graph(topometric_map)
        rows = np.array([self.features(graph, k) for k in range(len(graph))], dtype=np.float64)
        rows = rows.reshape(-1, self.dimension)
        if members is not None:
            row_of = {room_id: k for k, room_id in enumerate(graph.ids)}
            rows = np.array([rows[[row_of[i] for i in ids]].mean(axis=0) for ids in members])
        return rows.astype(np.float32).reshape(-1, self.dimension)

    def features(self, graph: RoomGraph, row: int) -> list[float]:
        """Return the features of one room; gaps in degrees, 0 where there is no further one."""
        near = graph.neighbours[row]
        degrees = sorted((len(graph.neighbours[k]) for k in near), reverse=True)
        reach = {k for n in near for k in graph.neighbours[n]} | set(near)
        offsets = graph.passages_of(row)[:, :2] - graph.centroids[row, :2]
        angles = np.sort(np.degrees(np.arctan2(offsets[:, 1], offsets[:, 0])))
        gaps = np.sort(np.diff(angles, append=angles[:1] + 360.0))[::-1]
        return [
            float(len(near)),
            float(len(reach - {row})),
            *_filled(degrees, _NEIGHBOURS),
            *_filled(gaps.tolist(), _GAPS),
        ]


def _filled(values: Sequence[float], length: int) -> list[float]:
    return [float(value) for value in [*values[:length], *[0.0] * (length - len(values))]]
