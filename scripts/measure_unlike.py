#!/usr/bin/env python3
"""Merge maps of unlike sensors and resolutions: how often right, and how exactly.

    measure_unlike.py [BUILDING ...] [--seed 1]

Two agents walk each building (a file or a generator, as `topometric simulate` takes them), the
second once for each row with other equipment on the same walk: the same frames, the same truth.
Prints a Markdown table. "Right" is under 0.5 m of mean displacement and 5 degrees, "strictly"
under 0.1 m and 1 degree; "unit" is a cloud in feet, which must be refused with the scale told.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from topometric_ros.configuration import with_values
from topometric_ros.errors import TopometricError
from topometric_ros.evaluation.metrics_fusion import (
    LITTLE_OVERLAP,
    RIGHT,
    STRICTLY_RIGHT,
    TransformError,
    transform_error,
)
from topometric_ros.fusion.align import align
from topometric_ros.fusion.poses import inverse
from topometric_ros.runtime.config import ToolConfig, load_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.cases import SimulatedAgent, SimulationConfig, prepare, simulate
from topometric_ros.simulation.trajectories import Walk, sampled_walks
from topometric_ros.topometric_map import TopometricMap

BUILDINGS = (
    "office:rooms=12,seed=1",
    "hospital:rooms=14,corridor=ring,seed=2",
    "home:seed=3",
    "office:rooms=16,corridor=L,seed=4",
    "office:rooms=14,storeys=2,seed=5",
    "hospital:rooms=12,corridor=L,seed=6",
)


@dataclass(frozen=True)
class Equipment:
    """What the second agent has: settings of the simulation, its voxels (m), its unit (m)."""

    name: str
    settings: dict[str, Any]
    voxel_size: float = 0.1
    first_voxel_size: float = 0.1
    unit: float = 1.0


ROWS = (
    Equipment("the same", {}),
    Equipment("voxels of 5 cm with 20 cm", {}, 0.2, 0.05),
    Equipment("voxels of 20 cm with 5 cm", {}, 0.05, 0.2),
    Equipment("dense with sparse (10 % of the returns)", {"degrade.dropout": 0.9}),
    Equipment("dense with very sparse (2 %)", {"degrade.dropout": 0.98}),
    Equipment("lidar with depth camera", {"sensor.pattern": "camera"}),
    Equipment("ceilings seen by one only", {"degrade.ceiling": "first"}),
    Equipment("metres with feet", {}, unit=0.3048),
)


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("buildings", nargs="*", default=BUILDINGS)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", nargs="+", choices=[row.name for row in ROWS], metavar="ROW")
    args = parser.parse_args()
    config = load_config("default")
    rows = [row for row in ROWS if args.only is None or row.name in args.only]
    outcomes: dict[str, list[tuple[str, TransformError | None]]] = {row.name: [] for row in rows}
    for building in args.buildings:
        for row, told, error in _rows(building, args.seed, config, rows):
            outcomes[row].append((told, error))
            print(f"{building}: {row}: {told}: {error}", file=sys.stderr, flush=True)
    print("| second agent | right | strictly | displacement, median (most) | refused because |")
    print("|---|---:|---:|---|---|")
    for name, results in outcomes.items():
        print(_line(name, results))


def _rows(
    building: str, seed: int, config: ToolConfig, rows: Sequence[Equipment]
) -> list[tuple[str, str, TransformError | None]]:
    """Merge the first agent's map with the second's under each equipment."""
    base = SimulationConfig(overlap=0.5)
    ready = prepare(load_building(building), base)
    walks = sampled_walks(ready.walkable, ready.forecast, 0.5, 2, 0, np.random.default_rng(seed))
    usual = simulate(ready, base, seed, walks)
    if usual.overlap[0] < LITTLE_OVERLAP:
        raise TopometricError(f"{building}: the walks share {usual.overlap[0]:.2f} only")
    maps = {
        size: _map(usual.agents[0], size, 1.0, config)
        for size in sorted({row.first_voxel_size for row in rows})
    }
    found: list[tuple[str, str, TransformError | None]] = []
    for row in rows:
        agent = _second(building, base, row, seed, walks) if row.settings else usual.agents[1]
        try:
            b = _map(agent, row.voxel_size, row.unit, config)
        except TopometricError as error:
            found.append((row.name, f"no map: {error}", None))
            continue
        alignment = align(maps[row.first_voxel_size], b, config.merge)
        error_of: TransformError | None = None
        if alignment.accepted and alignment.T_a_b is not None:
            T_true = usual.agents[0].T_agent_building @ inverse(agent.T_agent_building)
            error_of = transform_error(alignment.T_a_b, T_true, agent.points[::97])
        found.append((row.name, alignment.reason, error_of))
    return found


def _second(
    building: str, base: SimulationConfig, row: Equipment, seed: int, walks: Sequence[Walk]
) -> SimulatedAgent:
    """Return the second agent on its walk with other equipment."""
    config = with_values(base, row.settings)
    return simulate(prepare(load_building(building), config), config, seed, walks).agents[1]


def _map(
    agent: SimulatedAgent, voxel_size: float, unit: float, config: ToolConfig
) -> TopometricMap:
    extraction = replace(config.extraction, voxel_size=voxel_size)
    points = agent.points / unit
    return extract_map(points, extraction, config.merge.matching, agent=agent.id).map


def _line(name: str, results: Sequence[tuple[str, TransformError | None]]) -> str:
    good = [e for _, e in results if e is not None and e.within(RIGHT)]
    wrong = sum(e is not None and not e.within(RIGHT) for _, e in results)
    strict = sum(e.within(STRICTLY_RIGHT) for e in good)
    off = [100 * e.displacement for e in good]
    exact = f"{np.median(off):.1f} ({max(off):.1f}) cm" if off else "–"
    why = sorted({told for told, e in results if e is None})
    why += [f"**{wrong} wrong**"] if wrong else []
    cells = [name, f"{len(good)}/{len(results)}", f"{strict}/{len(results)}", exact, "; ".join(why)]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
