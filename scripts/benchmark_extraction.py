#!/usr/bin/env python3
"""Print the CPU seconds that each stage of extraction took, as a Markdown table.

    benchmark_extraction.py CLOUD [--voxel-size M] [--presets default thesis]

The first extraction of a process compiles the hot loops, so each preset runs twice and the second
run is reported. Seconds of CPU, not of wall clock: machines are shared.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from topometric_ros.extraction.config import extraction_preset
from topometric_ros.extraction.pipeline import extract
from topometric_ros.io.clouds import read_cloud


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cloud", type=Path)
    parser.add_argument("--voxel-size", type=float, default=0.1)
    parser.add_argument("--presets", nargs="+", default=["default", "thesis"])
    args = parser.parse_args()
    points = read_cloud(args.cloud).points
    columns = {}
    for preset in args.presets:
        config = replace(extraction_preset(preset), voxel_size=args.voxel_size)
        extract(points, config)
        columns[preset] = extract(points, config)
    stages = list(dict.fromkeys(s for e in columns.values() for s in e.timings))
    print(f"{len(points):,} points, {args.voxel_size} m voxels\n")
    print("| stage (CPU s) | " + " | ".join(columns) + " |")
    print("|---" * (len(columns) + 1) + "|")
    for stage in stages:
        cells = [f"{e.timings[stage]:.2f}" if stage in e.timings else "–" for e in columns.values()]
        print(f"| {stage} | " + " | ".join(cells) + " |")
    print("| rooms found | " + " | ".join(str(len(e.map.rooms)) for e in columns.values()) + " |")


if __name__ == "__main__":
    main()
