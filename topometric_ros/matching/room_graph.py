"""What matching needs of a map's topological graph, by row instead of by room id."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.topometric_map import TopometricMap


@dataclass(frozen=True)
class RoomGraph:
    """Rooms as rows 0..R-1 in the map's order; positions in metres, level frame.

    `centroids` (R, 3), `floors` (R,) the height of each room's storey, `neighbours` the adjacent
    rows of each row (eq. 47), `passages` the positions (p, 3) between two rows, lower row first.
    """

    ids: tuple[int, ...]
    centroids: NDArray[np.float64]
    floors: NDArray[np.float64]
    areas: NDArray[np.float64]
    neighbours: tuple[tuple[int, ...], ...]
    passages: dict[tuple[int, int], NDArray[np.float64]]

    def __len__(self) -> int:
        return len(self.ids)

    def passages_of(self, row: int) -> NDArray[np.float64]:
        """Return the positions of all passages that lead to a room: (p, 3)."""
        parts = [self.passages[min(row, other), max(row, other)] for other in self.neighbours[row]]
        return np.concatenate([np.zeros((0, 3)), *parts])


def room_graph(topometric_map: TopometricMap) -> RoomGraph:
    """Return the topological graph of a map."""
    rooms = topometric_map.rooms
    row_of = {room.id: row for row, room in enumerate(rooms)}
    floor_of = {storey.id: storey.floor_z for storey in topometric_map.storeys}
    positions: dict[tuple[int, int], list[tuple[float, float, float]]] = {}
    for passage in topometric_map.passages:
        first, second = sorted(row_of[i] for i in passage.rooms)
        positions.setdefault((first, second), []).append(passage.position)
    neighbours: list[set[int]] = [set() for _ in rooms]
    for first, second in positions:
        neighbours[first].add(second)
        neighbours[second].add(first)
    return RoomGraph(
        ids=tuple(room.id for room in rooms),
        centroids=np.array([room.centroid for room in rooms], dtype=float).reshape(-1, 3),
        floors=np.array([floor_of[room.storey] for room in rooms], dtype=float),
        areas=np.array([room.area for room in rooms], dtype=float),
        neighbours=tuple(tuple(sorted(near)) for near in neighbours),
        passages={key: np.array(sorted(p), dtype=float) for key, p in positions.items()},
    )
