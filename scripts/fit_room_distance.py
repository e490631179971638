#!/usr/bin/env python3
"""Learn how far apart one room seen by two agents lies in feature space, and when to match none.

    fit_room_distance.py MAPS [MAPS ...]

MAPS are folders of maps as `measure_merging.py` writes them (its OUT/maps). Of every two maps of a
building that share a tenth, the rooms that are the same place at the true pose are compared with
all others. Prints what the assignment (thesis eq. 52) gets right, one building left out at a time:
with the distance standardised over the two maps or learned, with every room of the smaller map
matched or only those nearer than a learned level; then what was learned from all. Nothing of it is
used by a preset yet.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from measure_merging import LITTLE_OVERLAP, load_prepared, shared_part
from measure_negatives import corpus
from numpy.typing import NDArray

from topometric_ros.evaluation.metrics_matching import MatchCounts, match_counts
from topometric_ros.fusion.align import SAME_ROOM_SHARE
from topometric_ros.fusion.overlap import same_rooms, shared_voxels
from topometric_ros.fusion.poses import inverse
from topometric_ros.matching.assignment import assign
from topometric_ros.matching.context import embed
from topometric_ros.matching.propose import with_large_rooms
from topometric_ros.runtime.config import load_config

LEVELS = np.arange(0.1, 3.0, 0.05)
Scales = dict[str, NDArray[np.float64]]


@dataclass(frozen=True)
class Pair:
    """Descriptors (logarithms) of the rooms of two maps, by name, and which are the same."""

    building: str
    values: dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]
    same: set[tuple[int, int]]


def main() -> None:
    """Fit, test with one building left out, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("maps", type=Path, nargs="+")
    pairs = _pairs(parser.parse_args().maps)
    print(f"{len(pairs)} pairs, {sum(len(p.same) for p in pairs)} rooms seen by both\n")
    ways: dict[str, tuple[Callable[[Sequence[Pair]], Scales | None], bool]] = {
        "standardised over both maps, all matched": (lambda _: None, False),
        "standardised over both maps, or none": (lambda _: None, True),
        "learned, all matched": (_scales, False),
        "learned, or none": (_scales, True),
    }
    print("| distance | precision | recall | F1 |\n|---|---:|---:|---:|")
    for name, (fit, may_leave) in ways.items():
        total = MatchCounts()
        for building in dict.fromkeys(p.building for p in pairs):
            others = [p for p in pairs if p.building != building]
            scales = fit(others)
            level = _level(others, scales) if may_leave else np.inf
            for pair in (p for p in pairs if p.building == building):
                total += _counts(pair, scales, level)
        cells = f"{total.precision:.0%} ({total.right}/{total.made}) | {total.recall:.0%}"
        print(f"| {name} | {cells} | {total.f1:.2f} |", flush=True)
    scales = _scales(pairs)
    print("\nLEVEL =", round(_level(pairs, scales), 3))
    for name, values in scales.items():
        print(f'"{name}": (' + ", ".join(f"{v:.3g}" for v in values) + "),")


def _pairs(folders: Sequence[Path]) -> list[Pair]:
    config = load_config("default")
    saved = [s for folder in folders for s in corpus(folder)]
    ready = {s.name: load_prepared(s, config) for s in saved}
    pairs = []
    for a, b in itertools.combinations(saved, 2):
        if a.building != b.building:
            continue
        first, second = ready[a.name], ready[b.name]
        T_true = a.T_agent_building @ inverse(b.T_agent_building)
        if shared_part(first, second, T_true) < LITTLE_OVERLAP:
            continue
        least = config.merge.matching.smallest_room
        one, other = (with_large_rooms(m.described, least) for m in (first, second))
        T = one.T_level_input @ T_true @ inverse(other.T_level_input)
        rows_a, rows_b, _ = shared_voxels(one, other, T)
        same = set(same_rooms(one, other, rows_a, rows_b, SAME_ROOM_SHARE))
        values = {
            d.name: (_logarithms(d.values), _logarithms(o.values))
            for d in one.descriptors
            if (o := other.descriptor(d.name)) is not None
        }
        pairs.append(Pair(a.building, values, same))
    return pairs


def _logarithms(values: NDArray[np.float32]) -> NDArray[np.float64]:
    return np.log1p(np.maximum(values.astype(float), 0.0))


def _scales(pairs: Sequence[Pair]) -> Scales:
    """Return the deviation of each number between two agents' views of one room, by descriptor."""
    scales: Scales = {}
    for name in pairs[0].values:
        gaps = [p.values[name][0][i] - p.values[name][1][j] for p in pairs for i, j in p.same]
        # The median forgives rooms of which one agent saw a corner only.
        scales[name] = np.maximum(np.median(np.abs(gaps), axis=0) / 0.6745, 1e-3)
    return scales


def _cost(pair: Pair, scales: Scales | None) -> NDArray[np.float64]:
    names = list(pair.values)
    a, b = embed([pair.values[n] for n in names], [scales[n] for n in names] if scales else None)
    return np.linalg.norm(a[:, None] - b[None], axis=2)


def _counts(pair: Pair, scales: Scales | None, level: float) -> MatchCounts:
    cost = _cost(pair, scales)
    made = [(i, j) for i, j, _ in assign(cost, level)]
    return match_counts(made, pair.same, *cost.shape)


def _level(pairs: Sequence[Pair], scales: Scales | None) -> float:
    """Return the level at which the assignment's F1 is best."""
    best: tuple[float, float] = (-1.0, 0.0)
    costs = [_cost(p, scales) for p in pairs]
    for level in LEVELS:
        total = MatchCounts()
        for pair, cost in zip(pairs, costs, strict=True):
            made = [(i, j) for i, j, _ in assign(cost, float(level))]
            total += match_counts(made, pair.same, *cost.shape)
        if total.f1 > best[0]:
            best = (total.f1, float(level))
    return best[1]


if __name__ == "__main__":
    main()
