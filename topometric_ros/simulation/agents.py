"""Agents that walk through a building: a list of rooms in, sensor poses out.

Areas are convex, so an agent that goes straight from opening to opening stays inside them; the
way between two rooms is the shortest over the graph of openings.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import networkx as nx
import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.simulation.building import Area, Building, BuildingError

_CLEARANCE = 0.6
"""How far before and behind a door an agent goes straight, m."""


@dataclass(frozen=True)
class WalkConfig:
    """How an agent moves and how steady it carries its sensor."""

    spacing: float = parameter(
        1.2, "Distance walked between two scans.", unit="m", minimum=0.05, maximum=10.0
    )
    sway: float = parameter(
        0.02, "Standard deviation of roll and pitch.", unit="rad", minimum=0.0, maximum=0.3
    )


def rotation(roll: float, pitch: float, yaw: float) -> NDArray[np.float64]:
    """Return the 4 x 4 rotation Rz(yaw) Ry(pitch) Rx(roll), angles in rad (REP-103)."""
    cr, cp, cy = np.cos((roll, pitch, yaw))
    sr, sp, sy = np.sin((roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr, 0.0],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr, 0.0],
            [-sp, cp * sr, cp * cr, 0.0],
            [0.0, 0.0, 0.0, 1.0],
        ]
    )


def translation(x: float, y: float, z: float) -> NDArray[np.float64]:
    """Return the 4 x 4 transform that moves points by (x, y, z) m."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def path_through(building: Building, rooms: Sequence[int]) -> NDArray[np.float64]:
    """Return the way that visits the middle of each room in turn: (K, 2) float64, m.

    Raises
    ------
    BuildingError
        No way leads from one room to the next.
    """
    graph = _way_graph(building)
    stops = [next(i for i, area in enumerate(building.areas) if area.room == r) for r in rooms]
    way: list[tuple[float, float]] = []
    for start, end in itertools.pairwise(stops):
        try:
            nodes = nx.shortest_path(graph, ("area", start), ("area", end), weight="length")
        except nx.NetworkXNoPath:
            names = [building.names[building.areas[i].room] for i in (start, end)]
            raise BuildingError(f"no way leads from {names[0]} to {names[1]}") from None
        way += [graph.nodes[node]["position"] for node in nodes]
    distinct = [way[0], *(b for a, b in itertools.pairwise(way) if a != b)]
    return np.array(distinct)


def sensor_poses(
    path: NDArray[np.float64], config: WalkConfig, rng: np.random.Generator
) -> list[NDArray[np.float64]]:
    """Return the poses of an agent's base at equal distances along its path.

    Parameters
    ----------
    path : (K, 2) float64, m, building frame
    rng : draws roll and pitch

    Returns
    -------
    list of T_building_base (4, 4) float64: x forward along the path, base on the floor
    """
    steps = np.diff(path, axis=0)
    lengths = np.hypot(*steps.T)
    marks = np.concatenate([[0.0], np.cumsum(lengths)])
    count = max(2, round(marks[-1] / config.spacing) + 1)
    poses = []
    for distance in np.linspace(0.0, marks[-1], count):
        leg = min(int(np.searchsorted(marks, distance, side="right")) - 1, len(steps) - 1)
        x, y = path[leg] + steps[leg] * (distance - marks[leg]) / lengths[leg]
        roll, pitch = rng.normal(0.0, config.sway, 2)
        yaw = float(np.arctan2(steps[leg, 1], steps[leg, 0]))
        poses.append(translation(x, y, 0.0) @ rotation(roll, pitch, yaw))
    return poses


def _way_graph(building: Building) -> nx.Graph:
    """Graph of area middles, door steps and joints between the areas of one room."""
    graph = nx.Graph()
    for i, area in enumerate(building.areas):
        graph.add_node(("area", i), position=area.centre, areas=(i,))
    for k, door in enumerate(o for o in building.openings if o.kind == "door"):
        _add_door(graph, building.areas, k, door.position)
    for (i, a), (j, b) in itertools.combinations(enumerate(building.areas), 2):
        if a.room == b.room and (joint := _joint(a, b)):
            graph.add_node(("joint", i, j), position=joint, areas=(i, j))
    for (m, first), (n, second) in itertools.combinations(list(graph.nodes(data=True)), 2):
        same_door = m[0] == n[0] == "door" and m[1] == n[1]
        if same_door or set(first["areas"]) & set(second["areas"]):
            length = float(np.hypot(*np.subtract(first["position"], second["position"])))
            graph.add_edge(m, n, length=length)
    return graph


def _add_door(
    graph: nx.Graph, areas: tuple[Area, ...], k: int, position: tuple[float, float]
) -> None:
    """Add the two steps of a door, one in each of the areas it joins."""
    for dx, dy in ((1, 0), (-1, 0), (0, 1), (0, -1)):
        x, y = position[0] + _CLEARANCE * dx, position[1] + _CLEARANCE * dy
        for i, area in enumerate(areas):
            x0, y0, x1, y1 = area.bounds
            crosses = position[0] in (x0, x1) if dx else position[1] in (y0, y1)
            if crosses and x0 < x < x1 and y0 < y < y1:
                graph.add_node(("door", k, i), position=(x, y), areas=(i,))


def _joint(a: Area, b: Area) -> tuple[float, float] | None:
    """Return the middle of the edge that two areas share, None where they share none."""
    x0, x1 = max(a.bounds[0], b.bounds[0]), min(a.bounds[2], b.bounds[2])
    y0, y1 = max(a.bounds[1], b.bounds[1]), min(a.bounds[3], b.bounds[3])
    touching = x1 >= x0 and y1 >= y0 and (x1 > x0 or y1 > y0)
    return ((x0 + x1) / 2, (y0 + y1) / 2) if touching else None
