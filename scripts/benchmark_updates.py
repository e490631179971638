#!/usr/bin/env python3
"""Print what updates of a growing map cost, beside extractions of the same input anew.

    benchmark_updates.py [BUILDING] [--every 12]

BUILDING is what `topometric simulate` takes, an office of two storeys by default. One agent walks
through all rooms of it, one storey after the other, and its map is extracted every so many scans,
once as the session does and once with nothing taken over; the maps must be the same bytes.
Milliseconds of CPU.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # CPU seconds are of one thread.

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np

from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.io.map_files import save_map
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.runtime.extractor_session import ExtractorSession
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.cases import SimulationConfig, prepare, simulate
from topometric_ros.topometric_map import TopometricMap

sys.path.insert(0, str(Path(__file__).parent))
from measure_passages import SEED, tour


def main() -> int:
    """Print a row for each update and the sums by stage."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("building", nargs="?", default="office:rooms=14,storeys=2,seed=1")
    parser.add_argument("--every", type=int, default=12)
    args = parser.parse_args()
    config = SimulationConfig(agents=1)
    ready = prepare(load_building(args.building), config)
    agent = simulate(ready, config, SEED, [tour(ready.walkable)]).agents[0]
    sessions = [
        ExtractorSession("walker", ExtractionConfig(), MatchingConfig(), lambda: "one")
        for _ in range(2)
    ]
    stages: dict[str, list[float]] = {}
    print("| scans | storeys | rooms | update ms | anew ms | same bytes |")
    print("|---:|---:|---:|---:|---:|---|")
    scans = int(agent.scan_of_point.max()) + 1
    for scan in range(scans):
        points = agent.points[agent.scan_of_point == scan]
        for one in sessions:
            one.add_scan(points, "map", scan, np.eye(4))
        if (scan + 1) % args.every and scan + 1 < scans:
            continue
        found = [one.extract(reuse) for one, reuse in zip(sessions, (True, False), strict=True)]
        sums = [1e3 * sum(f.timings.values()) for f in found]
        same = _bytes(found[0].map) == _bytes(found[1].map)
        m = found[0].map
        print(
            f"| {scan + 1} | {len(m.storeys)} | {len(m.rooms)} | {sums[0]:.0f} | {sums[1]:.0f} "
            f"| {'yes' if same else 'NO'} |",
            flush=True,
        )
        if scan + 1 > args.every:  # the first two compile
            for name in found[0].timings:
                total = stages.setdefault(name, [0.0, 0.0])
                for side in (0, 1):
                    total[side] += 1e3 * found[side].timings[name]
    print("\n| stage, all updates but the first | update ms | anew ms |\n|---|---:|---:|")
    for name, (update, anew) in stages.items():
        print(f"| {name} | {update:.0f} | {anew:.0f} |")
    update, anew = np.sum(list(stages.values()), axis=0)
    print(f"| all | {update:.0f} | {anew:.0f} |")
    return 0


def _bytes(m: TopometricMap) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        save_map(Path(folder) / "map.tmap", m)
        return (Path(folder) / "map.tmap").read_bytes()


if __name__ == "__main__":
    sys.exit(main())
