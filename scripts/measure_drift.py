#!/usr/bin/env python3
"""Merge maps of agents whose odometry drifts: how often right, and how thick walls become.

    measure_drift.py [BUILDING ...] [--seeds 1] [--drifts none mild hard]

Two agents walk each building (a file or a generator) with no, mild (0.05 degrees and 2 mm over the
first metre) and hard drift (0.15 degrees, 5 mm), growing with the root of the way. Prints a
Markdown table: merges that are right (0.5 m, 5 degrees) and strictly (0.1 m, 1 degree), and the
mean distance between the two agents' faces of the same walls after rigid and non-rigid fusion
(`merge.fuse.nonrigid`), which is by how much walls come out too thick.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # CPU seconds are of one thread.

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from topometric_ros.configuration import with_values
from topometric_ros.evaluation.metrics_fusion import (
    RIGHT,
    STRICTLY_RIGHT,
    TransformError,
    transform_error,
    upper_bound,
)
from topometric_ros.fusion.align import align
from topometric_ros.fusion.nonrigid import bends, gap
from topometric_ros.fusion.poses import apply, inverse, level_frames
from topometric_ros.fusion.surface import surface_of
from topometric_ros.runtime.config import ToolConfig, load_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.cases import SimulationConfig, prepare, simulate

BUILDINGS = (
    "office:rooms=12,seed=1",
    "hospital:rooms=14,corridor=ring,seed=2",
    "home:seed=3",
    "office:rooms=16,corridor=L,seed=4",
    "office:rooms=14,storeys=2,seed=5",
    "hospital:rooms=12,corridor=L,seed=6",
)
DRIFTS = {"none": (0.0, 0.0), "mild": (0.002, 0.05), "hard": (0.005, 0.15)}
"""m and degrees over the first metre."""


@dataclass
class Row:
    """What became of the pairs of one drift; gaps in m, None where nothing was merged."""

    errors: list[TransformError | None] = field(default_factory=list)
    rigid: list[float] = field(default_factory=list)
    bent: list[float] = field(default_factory=list)
    left: int = 0
    seconds: list[float] = field(default_factory=list)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("buildings", nargs="*", default=BUILDINGS)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--drifts", nargs="+", choices=tuple(DRIFTS), default=tuple(DRIFTS))
    args = parser.parse_args()
    config = load_config("default")
    rows = {name: Row() for name in args.drifts}
    for building in args.buildings:
        for seed in range(1, args.seeds + 1):
            for name in rows:
                _run(rows[name], building, name, seed, config)
    print(
        "| drift | right | strictly | displacement, median | gap rigid, median (most) | "
        "gap non-rigid | left rigid | CPU s |"
    )
    print("|---|---:|---:|---:|---|---|---:|---:|")
    for name, row in rows.items():
        print(_line(name, row))


def _run(row: Row, building: str, drift: str, seed: int, config: ToolConfig) -> None:
    """Simulate, extract, align and fuse one pair both ways."""
    metres, degrees = DRIFTS[drift]
    settings = {"degrade.drift": metres, "degrade.yaw_drift": degrees}
    simulation = with_values(SimulationConfig(overlap=0.5), settings)
    case = simulate(prepare(load_building(building), simulation), simulation, seed)
    maps = [
        extract_map(agent.points, config.extraction, config.merge.matching, agent=agent.id).map
        for agent in case.agents
    ]
    alignment = align(maps[0], maps[1], config.merge)
    if not alignment.accepted or alignment.T_a_b is None:
        row.errors.append(None)
        print(f"{building} {drift} {seed}: {alignment.reason}", file=sys.stderr, flush=True)
        return
    first, second = case.agents
    T_true = first.T_agent_building @ inverse(second.T_agent_building)
    row.errors.append(transform_error(alignment.T_a_b, T_true, second.points[::97]))
    T_level = level_frames(alignment.T_a_b, maps[0].T_level_input, maps[1].T_level_input)
    places = [np.eye(4), T_level]
    surfaces = [surface_of(m) for m in maps]
    clouds = [apply(T, s.points) for T, s in zip(places, surfaces, strict=True)]
    start = time.process_time()
    settings_of_bend = replace(config.merge.fuse.nonrigid, enabled=True)
    found = bends(list(zip(maps, places, strict=True)), settings_of_bend)
    row.seconds.append(time.process_time() - start)
    row.rigid.append(gap(surfaces, clouds))
    row.left += found is None
    if found is not None:
        clouds = [b.apply(s.points) for b, s in zip(found, surfaces, strict=True)]
    row.bent.append(gap(surfaces, clouds))
    print(
        f"{building} {drift} {seed}: {row.errors[-1]}, {row.rigid[-1]:.4f} {row.bent[-1]:.4f}",
        file=sys.stderr,
        flush=True,
    )


def _line(name: str, row: Row) -> str:
    good = [e for e in row.errors if e is not None and e.within(RIGHT)]
    strict = sum(e.within(STRICTLY_RIGHT) for e in good)
    total = len(row.errors)
    wrong = sum(e is not None and not e.within(RIGHT) for e in row.errors)
    false = f"; wrong {wrong} (below {100 * upper_bound(wrong, total):.0f} %)"
    off = f"{100 * np.median([e.displacement for e in good]):.1f} cm" if good else "–"
    cells = [name, f"{len(good)}/{total}{false}", f"{strict}/{total}", off]
    cells += [_centimetres(row.rigid), _centimetres(row.bent), f"{row.left}/{len(row.bent)}"]
    cells.append(f"{np.median(row.seconds):.1f}" if row.seconds else "–")
    return f"| {' | '.join(cells)} |"


def _centimetres(values: Sequence[float]) -> str:
    if not values:
        return "–"
    return f"{100 * np.median(values):.2f} ({100 * max(values):.2f}) cm"


if __name__ == "__main__":
    main()
