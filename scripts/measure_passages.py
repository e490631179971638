#!/usr/bin/env python3
"""Measure passages, stairs and rooms' attributes against the truth of buildings.

    measure_passages.py BUILDING... [--preset NAME]

BUILDING is what `topometric simulate` takes. In each, one agent visits every room that can be
reached from the part with most rooms; its map is compared with the building's links and rooms:

- edges: right of found, covered of true (docs/evaluation.md), and how many wrong ones join two
  pieces of one true room, which is the segmentation's doing;
- triangles: three rooms joined pairwise by passages within 1.5 m of each other;
- stairs: storeys walked, and storeys of the map in one piece by its passages;
- doors: error of the width, and passages under a lintel;
- attributes: error of the floor area and of the volume of rooms that are found whole; a true
  volume is that of a room as high as its model says, which under a pitched roof it is not;
- viewpoints: share of the voxels that any of them sees, as far as preset `thesis` looks.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from dataclasses import dataclass, field
from typing import Any

import networkx as nx
import numpy as np
from scipy.spatial import cKDTree

from topometric_ros.evaluation.metrics_rooms import assigned, edge_counts, jaccard, room_overlap
from topometric_ros.extraction.visibility import VisibilityConfig, visibilities
from topometric_ros.runtime.config import preset_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.cases import SimulationConfig, prepare, simulate
from topometric_ros.simulation.trajectories import Walk
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.grid import VoxelGrid

SEED = 11
TOGETHER = 1.5
"""Passages this near to each other, m, are of one place."""
WHOLE = 0.8
"""Jaccard index from which a room counts as found whole."""


@dataclass
class Totals:
    """What is summed over the buildings."""

    found: int = 0
    right: int = 0
    true: int = 0
    covered: int = 0
    pieces: int = 0
    triangles: int = 0
    widths: list[float] = field(default_factory=list)
    areas: list[float] = field(default_factory=list)
    volumes: list[float] = field(default_factory=list)
    viewpoints: int = 0
    voxels: int = 0
    seen: int = 0

    def line(self, name: str, storeys: str) -> str:
        """Return the figures as a row of a table."""
        widths = np.abs(self.widths)
        area, volume = (
            f"{np.median(np.abs(errors)):.1%}" if errors else "–"
            for errors in (self.areas, self.volumes)
        )
        return (
            f"| {name} | {self.right}/{self.found} | {self.pieces} | {self.covered}/{self.true} "
            f"| {self.triangles} | {storeys} | {np.sum(widths <= 0.1)}/{len(widths)} "
            f"| {area} | {volume} | {self.viewpoints} | {self.seen / max(self.voxels, 1):.1%} |"
        )

    def add(self, other: Totals) -> None:
        """Add the figures of a building."""
        for name, value in vars(other).items():
            setattr(self, name, getattr(self, name) + value)


def tour(walkable: Any) -> Walk:
    """Return a walk through all rooms that are joined with most others, the nearest first."""
    component = {room: int(walkable.component[p]) for room, p in walkable.anchors.items()}
    members = list(component.values())
    largest = max(sorted(set(members)), key=members.count)
    left = {room: p for room, p in sorted(walkable.anchors.items()) if component[room] == largest}
    order = [min(left)]
    while len(left) > 1:
        lengths = walkable.lengths_from(left.pop(order[-1]))
        order.append(min(left, key=lambda room: (lengths[left[room]], room)))
    return Walk(tuple(order))


def triangles(m: TopometricMap) -> int:
    """Return how many three rooms are joined pairwise by passages at one place."""
    graph = nx.MultiGraph()
    for passage in m.passages:
        graph.add_edge(*passage.rooms, position=np.array(passage.position))
    count = 0
    for a, b, c in itertools.combinations(sorted(graph), 3):
        sides = [graph.get_edge_data(*pair) for pair in ((a, b), (b, c), (a, c))]
        if all(sides):
            places = itertools.product(*([e["position"] for e in s.values()] for s in sides))
            count += any(
                max(np.linalg.norm(p - q) for p, q in itertools.combinations(three, 2)) < TOGETHER
                for three in places
            )
    return count


def joined(m: TopometricMap) -> int:
    """Return how many storeys the largest part of the map spans that stairs hold together."""
    graph = nx.Graph()
    graph.add_nodes_from(storey.id for storey in m.storeys)
    storey = {room.id: room.storey for room in m.rooms}
    graph.add_edges_from([storey[room] for room in passage.rooms] for passage in m.passages)
    return max((len(part) for part in nx.connected_components(graph)), default=0)


def seen_from_viewpoints(m: TopometricMap) -> tuple[int, int, int]:
    """Return how many viewpoints a map has, its voxels, and those that any viewpoint sees."""
    grid = VoxelGrid(m.voxels, np.array(m.origin), m.voxel_size)
    sets = visibilities(grid, m.viewpoints.astype(np.float64), VisibilityConfig())
    words = np.bitwise_or.reduce(sets.words, axis=0)
    return len(sets), len(grid), int(np.bitwise_count(words).sum())


def measure(spec: str, preset: str) -> tuple[Totals, str]:
    """Return the figures of one building, and its storeys in words."""
    config = SimulationConfig(agents=1)
    ready = prepare(load_building(spec), config)
    case = simulate(ready, config, SEED, [tour(ready.walkable)])
    agent, building = case.agents[0], ready.building
    tool = preset_config(preset)
    m = extract_map(agent.points, tool.extraction, tool.merge.matching, agent="a").map
    T = m.T_level_input @ agent.T_agent_building
    centres = (m.centres() - m.T_level_input[:3, 3]) @ m.T_level_input[:3, :3]
    away, nearest = cKDTree(agent.points).query(centres)
    true = np.where(away <= 2 * m.voxel_size, agent.room[nearest], -1)
    overlap = room_overlap(true, m.room)
    links = {(min(link.rooms), max(link.rooms)) for link in building.links}
    counts = edge_counts(overlap, {p.rooms for p in m.passages}, links)
    totals = Totals(counts.found, counts.right, counts.true, counts.covered)
    totals.triangles = triangles(m)
    stands = {
        found: overlap.true_ids[int(overlap.both[:, j].argmax())]
        for j, found in enumerate(overlap.found_ids)
        if overlap.found_labelled[j]
    }
    totals.pieces = len(
        {p.rooms for p in m.passages if stands.get(p.rooms[0], -1) == stands.get(p.rooms[1], -2)}
    )
    for passage in m.passages:
        pair = tuple(sorted(stands.get(room, -1) for room in passage.rooms))
        for link in building.links:
            place = T[:3, :3] @ link.position + T[:3, 3]
            near = np.hypot(*(place - passage.position)[:2]) <= 1.0
            if near and link.kind in ("door", "opening") and tuple(sorted(link.rooms)) == pair:
                totals.widths.append(passage.width - link.width)
                break
    similarity = jaccard(overlap)
    by_id = {room.id: room for room in m.rooms}
    for i, j in assigned(similarity):
        if similarity[i, j] >= WHOLE:
            true_room, room = building.rooms[overlap.true_ids[i]], by_id[overlap.found_ids[j]]
            x, y = true_room.polygon.T
            area = abs(float(np.sum(x * np.roll(y, -1) - y * np.roll(x, -1)))) / 2
            totals.areas.append(room.floor_area / area - 1)
            if room.volume is not None:
                high = true_room.z_high - true_room.z_low
                totals.volumes.append(room.volume / (area * high) - 1)
    totals.viewpoints, totals.voxels, totals.seen = seen_from_viewpoints(m)
    walked = {building.rooms[room].storey for room in agent.rooms_walked}
    return totals, f"{len(walked)} walked, {len(m.storeys)} found, {joined(m)} joined"


def main() -> int:
    """Print one row a building and their sum."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("building", nargs="+")
    parser.add_argument("--preset", default="default")
    args = parser.parse_args()
    print("| building | edges right | pieces | links covered | triangles | storeys ", end="")
    print("| doors within 0.1 m of their width | floor area off by | volume off by ", end="")
    print("| viewpoints | voxels they see |\n|" + " --- |" * 11)
    total = Totals()
    for spec in args.building:
        totals, storeys = measure(spec, args.preset)
        name = spec.rsplit("/", 1)[-1]
        print(totals.line(name, storeys), flush=True)
        total.add(totals)
    print(total.line("all", ""))
    precision, recall = total.right / max(total.found, 1), total.covered / max(total.true, 1)
    f1 = 2 * precision * recall / max(precision + recall, 1e-9)
    print(f"\nprecision {precision:.3f}, recall {recall:.3f}, F1 {f1:.3f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
