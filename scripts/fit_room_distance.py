#!/usr/bin/env python3
"""Learn how far apart one room seen by two agents lies in feature space, and when to match none.

    fit_room_distance.py MAPS [MAPS ...] [--most 12] [--write]

MAPS are folders of maps as `measure_merging.py` writes them (its OUT/maps). Of every building up to
--most pairs of maps that share a tenth are drawn; rooms that are the same place at the true pose
are compared with all others. Prints what the assignment (thesis eq. 52) gets right, one building
left out at a time: with the distance standardised over the two maps or learned, with every room of
the smaller map matched or only those nearer than a learned level; and what the best hypothesis gets
right that grows from it (§4.3.6). Then the level learned from all; with --write the metric goes
into the package.
"""

from __future__ import annotations

import argparse
import itertools
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from look_alikes import building_cells, corpus, shared_cells
from measure_merging import LITTLE_OVERLAP, Saved
from numpy.typing import NDArray
from scipy.spatial.distance import cdist

from topometric_ros.evaluation.metrics_matching import MatchCounts, match_counts
from topometric_ros.fusion.align import SAME_ROOM_SHARE
from topometric_ros.fusion.overlap import same_rooms, shared_voxels
from topometric_ros.fusion.poses import inverse
from topometric_ros.io.map_files import load_map
from topometric_ros.matching import room_distance
from topometric_ros.matching.assignment import assign
from topometric_ros.matching.choice import choose
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.matching.descriptors import described
from topometric_ros.matching.hypotheses import grow_all
from topometric_ros.matching.propose import room_distances, with_large_rooms
from topometric_ros.matching.room_graph import RoomGraph, room_graph
from topometric_ros.topometric_map import TopometricMap

LEVELS = np.arange(0.2, 3.0, 0.05)
CONFIG = MatchingConfig()
STANDARDISED = replace(CONFIG, distance="standardised")
METRIC = Path(room_distance.__file__).with_name("shape_metric.npy")


@dataclass(frozen=True)
class Pair:
    """Root shares of two maps' rooms (R, D), the standardised distance, and which are the same."""

    building: str
    a: NDArray[np.float64]
    b: NDArray[np.float64]
    standardised: NDArray[np.float64]
    graphs: tuple[RoomGraph, RoomGraph]
    same: set[tuple[int, int]]


Metric = NDArray[np.float64] | None
"""(D, D), or None for the standardised distance."""


def main() -> None:
    """Fit, test with one building left out, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("maps", type=Path, nargs="+")
    parser.add_argument("--most", type=int, default=12, help="pairs of a building (default 12)")
    parser.add_argument("--write", action="store_true", help="put the metric into the package")
    args = parser.parse_args()
    saved = [s for folder in args.maps for s in corpus(folder)]
    buildings = {b: [s for s in saved if s.building == b] for b in {s.building: 0 for s in saved}}
    pairs = [pair for own in buildings.values() for pair in _pairs(own, args.most)]
    print(f"{len(pairs)} pairs, {sum(len(p.same) for p in pairs)} rooms seen by both\n")
    ways: dict[str, tuple[Callable[[Sequence[Pair]], Metric], bool]] = {
        "standardised over both maps, all matched": (lambda _: None, False),
        "standardised over both maps, or none": (lambda _: None, True),
        "learned, all matched": (_metric, False),
        "learned, or none": (_metric, True),
    }
    print("| distance | assigned: precision | recall | F1 | grown: precision | recall | F1 |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    for name, (fit, may_leave) in ways.items():
        assigned, grown = MatchCounts(), MatchCounts()
        for building in buildings:
            others = [p for p in pairs if p.building != building]
            metric = fit(others)
            level = _level(others, metric) if may_leave else np.inf
            for pair in (p for p in pairs if p.building == building):
                cost = _cost(pair, metric)
                assigned += _counts(cost, pair, level)
                grown += match_counts(_grown(cost, pair, level), pair.same, *cost.shape)
        print(f"| {name} | {_cells(assigned)} | {_cells(grown)} |", flush=True)
    metric = _metric(pairs)
    print("\nalone:", round(_level(pairs, metric), 2))
    if args.write:
        np.save(METRIC, metric.astype(np.float32))


def _cells(c: MatchCounts) -> str:
    return f"{c.precision:.0%} ({c.right}/{c.made}) | {c.recall:.0%} | {c.f1:.2f}"


def _grown(cost: NDArray[np.float64], pair: Pair, level: float) -> list[tuple[int, int]]:
    """Return the matches of the largest hypothesis."""
    hypotheses = grow_all(cost, *pair.graphs, CONFIG.growing, level)
    best = choose(hypotheses, *pair.graphs, CONFIG.growing, CONFIG.choice)[:1]
    return [(i, j) for hypothesis in best for i, j, _ in hypothesis.matches]


def _pairs(saved: Sequence[Saved], most: int) -> list[Pair]:
    """Return up to so many pairs of maps of one building."""
    cells = {s.name: building_cells(s) for s in saved}
    sharing = [
        (a, b)
        for a, b in itertools.combinations(saved, 2)
        if shared_cells(cells[a.name], cells[b.name]) >= LITTLE_OVERLAP
    ]
    drawn = random.Random(0).sample(sharing, min(most, len(sharing)))
    maps = {s.name: _described(s) for s in {s.name: s for pair in drawn for s in pair}.values()}
    pairs = []
    for one, other in drawn:
        a, b = maps[one.name], maps[other.name]
        T_true = one.T_agent_building @ inverse(other.T_agent_building)
        T = a.T_level_input @ T_true @ inverse(b.T_level_input)
        rows_a, rows_b, _ = shared_voxels(a, b, T)
        same = set(same_rooms(a, b, rows_a, rows_b, SAME_ROOM_SHARE))
        cost = room_distances(a, b, STANDARDISED)
        shares, graphs = (_root_shares(a), _root_shares(b)), (room_graph(a), room_graph(b))
        pairs.append(Pair(one.building, *shares, cost, graphs, same))
    return pairs


def _described(saved: Saved) -> TopometricMap:
    m = load_map(saved.folder / f"{saved.name}.tmap")
    return with_large_rooms(described(m, CONFIG), CONFIG.smallest_room)


def _root_shares(m: TopometricMap) -> NDArray[np.float64]:
    shape = m.descriptor("shape")
    assert shape is not None, "preset default describes rooms by shape"
    return room_distance.root_shares(shape.values)


def _metric(pairs: Sequence[Pair]) -> NDArray[np.float64]:
    return room_distance.fit_metric(np.array([p.a[i] - p.b[j] for p in pairs for i, j in p.same]))


def _cost(pair: Pair, metric: Metric) -> NDArray[np.float64]:
    return pair.standardised if metric is None else cdist(pair.a @ metric, pair.b @ metric)


def _counts(cost: NDArray[np.float64], pair: Pair, level: float) -> MatchCounts:
    made = [(i, j) for i, j, _ in assign(cost, level)]
    return match_counts(made, pair.same, *cost.shape)


def _level(pairs: Sequence[Pair], metric: Metric) -> float:
    """Return the level at which the assignment's F1 is best."""
    costs = [_cost(pair, metric) for pair in pairs]

    def f1(level: float) -> float:
        counts = (_counts(c, p, level) for c, p in zip(costs, pairs, strict=True))
        return sum(counts, MatchCounts()).f1

    return max(LEVELS.tolist(), key=f1)


if __name__ == "__main__":
    main()
