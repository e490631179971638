#!/usr/bin/env python3
"""Print what extracting whole generated buildings takes, as a Markdown table by stage.

    benchmark_building.py [--rooms N ...] [--density 1700] [--voxel-size M] [--preset P]

Each building is an office of so many rooms whose surfaces are sampled again and again until there
are `density` points to a m² of each of its surfaces; it runs in a process of its own, after a small
one that compiles the hot loops. Seconds of CPU; memory is the most the process held, the cloud
included; area is the floor of all rooms.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # CPU seconds are of one thread.

import argparse
import sys
import tempfile
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.evaluation.processes import in_own_process, peak_mb
from topometric_ros.runtime.config import preset_config, with_voxel_size
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.surfaces import sampled_surfaces

PASS_DENSITY = 400.0
"""Points a m² of one pass over the surfaces."""
ROWS = ("points", "area (m²)", "voxels", "viewpoints", "rooms found", "passages found")


def main() -> int:
    """Measure every size and print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rooms", type=int, nargs="+", default=[60])
    parser.add_argument("--density", type=float, default=1700.0)
    parser.add_argument("--voxel-size", type=float, default=0.05)
    parser.add_argument("--preset", default="default")
    parser.add_argument("--timeout", type=float, default=3600.0)
    args = parser.parse_args()
    columns = []
    for rooms in args.rooms:
        with tempfile.TemporaryDirectory() as folder:
            cloud = Path(folder) / "cloud.npy"
            found = in_own_process(sample, rooms, args.density, cloud, timeout=args.timeout)
            columns.append(
                found
                | in_own_process(measure, cloud, args.preset, args.voxel_size, timeout=args.timeout)
            )
    print("| | " + " | ".join(f"{rooms} rooms" for rooms in args.rooms) + " |")
    print("|---" + "|---:" * len(columns) + "|")
    for name in columns[0]:
        digits = 0 if name in ROWS else 2
        print(f"| {name} | " + " | ".join(f"{c[name]:.{digits}f}" for c in columns) + " |")
    return 0


def sample(rooms: int, density: float, cloud: Path) -> dict[str, float]:
    """Write the points of a building of so many rooms; return their number and the floor's area."""
    building = load_building(f"office:seed=1,rooms={rooms}")
    x = building.vertices[:, 0]
    stretch = (float(x.min()), float(x.max()))
    passes = max(1, round(density / PASS_DENSITY))
    parts = [
        sampled_surfaces(building, stretch, np.random.default_rng((1, k))).astype(np.float32)
        for k in range(passes)
    ]
    np.save(cloud, np.concatenate(parts))
    area = sum(_area(room.polygon) for room in building.rooms)
    return {"points": sum(map(len, parts)), "area (m²)": area}


def _area(ring: NDArray[np.float64]) -> float:
    """Area of a polygon (K, 2) by the shoelace formula."""
    x, y = ring.T
    return abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1))) / 2


def measure(cloud: Path, preset: str, voxel_size: float) -> dict[str, float]:
    """Extract the map of a cloud; return what was found, seconds by stage and the peak memory."""
    config = with_voxel_size(preset_config(preset), voxel_size)
    points = np.load(cloud)
    small = points[points[:, 0] < points[:, 0].min() + 8.0][::4].astype(np.float64)
    extract_map(small, config.extraction, config.merge.matching, agent="small", session="small")
    result = extract_map(
        points.astype(np.float64),
        config.extraction,
        config.merge.matching,
        agent="large",
        session="large",
    )
    m = result.map
    found = {"voxels": len(m.voxels), "viewpoints": len(m.viewpoints)}
    found |= {"rooms found": len(m.rooms), "passages found": len(m.passages)}
    stages = {f"{stage} (s)": value for stage, value in result.timings.items()}
    total = {"all stages (s)": sum(result.timings.values()), "peak memory (GB)": peak_mb() / 1e3}
    return {**found, **stages, **total}


if __name__ == "__main__":
    sys.exit(main())
