"""The topological graph of one storey as a route graph that Nav2's route server loads (GeoJSON).

Rooms and passages are nodes. The server drives straight from node to node, so the way through a
room is sought on the storey's occupancy grid, away from walls, and every bend becomes a node.
Edges are directed there: each way is written in both directions.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.io.occupancy import FREE, OCCUPIED, OccupancyGrid, occupancy_grid
from topometric_ros.io.ways import Cell, find_ways
from topometric_ros.topometric_map import Passage, Room, Storey, TopometricMap

_COMFORT = 0.6
"""Cells nearer than this to an obstacle cost more, m."""
_CLOSEST = 0.15
"""Cells nearer than this to an obstacle are not driven through unless nothing else is left, m."""
_MARGIN = 1.0
"""A way through a room is sought this far around its bounds, m."""
_SNAP = 0.6
"""A node off the free cells starts from a free cell this near, m."""


@dataclass(frozen=True)
class _Raster:
    """A storey's grid for seeking ways: cost a cell (ny, nx) float64, inf where nothing drives."""

    grid: OccupancyGrid
    cost: NDArray[np.float64]

    def cell(self, xy: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return (row, column) of a point of the grid's frame: (2,) int64."""
        x, y, yaw = self.grid.origin
        c, s = np.cos(yaw), np.sin(yaw)
        dx, dy = xy - (x, y)
        own = np.array([-s * dx + c * dy, c * dx + s * dy])
        return np.floor(own / self.grid.resolution).astype(np.int64)

    def point(self, cell: NDArray[np.int64]) -> NDArray[np.float64]:
        """Return the centre of a cell in the grid's frame: (2,) float64, m."""
        x, y, yaw = self.grid.origin
        row, column = (cell + 0.5) * self.grid.resolution
        c, s = np.cos(yaw), np.sin(yaw)
        return np.array([x + c * column - s * row, y + s * column + c * row])

    def snapped(self, cell: Cell) -> Cell | None:
        """Return the drivable cell nearest to a cell, or None where none is near."""
        reach = int(_SNAP / self.grid.resolution)
        low = np.maximum(cell - reach, 0)
        box = self.cost[low[0] : cell[0] + reach + 1, low[1] : cell[1] + reach + 1]
        cells = np.argwhere(np.isfinite(box)) + low
        if len(cells) == 0:
            return None
        return cells[int(np.argmin(((cells - cell) ** 2).sum(axis=1)))]  # type: ignore[no-any-return]


def route_graph(m: TopometricMap, storey: Storey) -> dict[str, Any]:
    """Return the route graph of one storey as GeoJSON.

    Node and edge ids are unique together, from 1. Coordinates are metres in the map's frame. A
    node's metadata holds `kind` (room, passage or way), the room's id and area or the passage's
    own kind, width, height and rooms; an edge's the room that it leads through and whether the way
    is `seen` free (a straight line stands in where the grid shows none).

    Parameters
    ----------
    m : the map
    storey : one of its storeys
    """
    raster = _raster(occupancy_grid(m, storey))
    graph = _Graph(m.frame_id)
    node_of_passage: dict[int, int] = {}
    for room in (room for room in m.rooms if room.storey == storey.id):
        goals: list[tuple[int, Cell | None]] = []
        for k, passage in enumerate(m.passages):
            if room.id in passage.rooms:
                position = _to_grid_frame(m, raster, passage.position)
                if k not in node_of_passage:
                    node_of_passage[k] = graph.node(position, _of_passage(passage))
                goals.append((node_of_passage[k], raster.snapped(raster.cell(position))))
        _add_room(graph, m, raster, room, goals)
    features = [*graph.nodes, *graph.edge_features()]
    return {"type": "FeatureCollection", "name": f"storey_{storey.id}", "features": features}


class _Graph:
    """Nodes as GeoJSON features and edges (from, to, metadata) while they are gathered."""

    def __init__(self, frame_id: str) -> None:
        self.frame_id = frame_id
        self.nodes: list[dict[str, Any]] = []
        self.edges: list[tuple[int, int, dict[str, Any]]] = []

    def node(self, xy: NDArray[np.float64], metadata: dict[str, Any]) -> int:
        """Add a node and return its id."""
        node_id = len(self.nodes) + 1
        self.nodes.append(
            {
                "type": "Feature",
                "properties": {"id": node_id, "frame": self.frame_id, "metadata": metadata},
                "geometry": {
                    "type": "Point",
                    "coordinates": [round(float(value), 3) for value in xy],
                },
            }
        )
        return node_id

    def edge_features(self) -> Iterator[dict[str, Any]]:
        """Yield every edge in both directions, ids after the nodes'."""
        edge_id = len(self.nodes)
        for a, b, metadata in self.edges:
            for start, end in ((a, b), (b, a)):
                edge_id += 1
                ids = {"id": edge_id, "startid": start, "endid": end}
                line = [self.nodes[n - 1]["geometry"]["coordinates"] for n in (start, end)]
                yield {
                    "type": "Feature",
                    "properties": {**ids, "metadata": metadata},
                    "geometry": {"type": "MultiLineString", "coordinates": [line]},
                }


def _add_room(
    graph: _Graph,
    m: TopometricMap,
    raster: _Raster,
    room: Room,
    goals: list[tuple[int, Cell | None]],
) -> None:
    """Add a room and the ways from its centre to its passages: `goals` are (node, cell)."""
    place = room.centroid if room.centre is None else room.centre
    centre = _to_grid_frame(m, raster, place)
    start = raster.snapped(raster.cell(centre))
    about = {"kind": "room", "room": room.id, "storey": room.storey, "area": round(room.area, 2)}
    root = graph.node(centre if start is None else raster.point(start), about)
    box = _box(m, raster, room)
    corner = np.array([side.start for side in box], dtype=np.int64)
    source, *ends = (None if c is None else c - corner for c in (start, *(c for _, c in goals)))
    ways = find_ways(raster.cost[box], source, ends)
    node_at = {} if source is None else {_key(source): root}
    for chain in ways.chains:
        for bend in chain:
            if _key(bend) not in node_at:
                way = {"kind": "way", "room": room.id}
                node_at[_key(bend)] = graph.node(raster.point(bend + corner), way)
        line = [node_at[_key(bend)] for bend in chain]
        graph.edges += [(p, q, _through(room, True)) for p, q in itertools.pairwise(line)]
    for (node, _), cell, reached in zip(goals, ends, ways.reached, strict=True):
        last = node_at[_key(cell)] if reached and cell is not None else root
        graph.edges.append((last, node, _through(room, reached)))


def _through(room: Room, seen: bool) -> dict[str, Any]:
    return {"room": room.id, "seen": seen}


def _key(cell: Cell) -> tuple[int, int]:
    return int(cell[0]), int(cell[1])


def _of_passage(passage: Passage) -> dict[str, Any]:
    rooms = [int(room) for room in passage.rooms]
    metadata: dict[str, Any] = {"kind": "passage", "passage": passage.kind, "rooms": rooms}
    metadata["width"] = round(float(passage.width), 3)
    if passage.height is not None:
        metadata["height"] = round(float(passage.height), 3)
    return metadata


def _raster(grid: OccupancyGrid) -> _Raster:
    """Return what driving through each cell costs: more near obstacles, inf where not seen free."""
    clearance = ndimage.distance_transform_edt(grid.values != OCCUPIED) * grid.resolution
    near = np.clip(1.0 - clearance / _COMFORT, 0.0, 1.0)
    cost = 1.0 + 4.0 * near**2 + 50.0 * (clearance < _CLOSEST)
    return _Raster(grid, np.where(grid.values == FREE, cost, np.inf))


def _to_grid_frame(
    m: TopometricMap, raster: _Raster, point: tuple[float, float, float]
) -> NDArray[np.float64]:
    """Return x and y of a level-frame point in the frame of the grid: (2,) float64, m."""
    if raster.grid.level:
        return np.array(point[:2])
    T = np.linalg.inv(m.T_level_input)
    return (T[:3, :3] @ point + T[:3, 3])[:2]


def _box(m: TopometricMap, raster: _Raster, room: Room) -> tuple[slice, slice]:
    """Return the cells around a room, within the raster."""
    (x0, y0, z0), (x1, y1, _) = room.bounds
    corners = [
        (x, y, z0) for x in (x0 - _MARGIN, x1 + _MARGIN) for y in (y0 - _MARGIN, y1 + _MARGIN)
    ]
    cells = np.array([raster.cell(_to_grid_frame(m, raster, corner)) for corner in corners])
    low = np.clip(cells.min(axis=0), 0, None)
    high = np.clip(cells.max(axis=0) + 1, 0, raster.cost.shape)
    return slice(int(low[0]), int(high[0])), slice(int(low[1]), int(high[1]))
