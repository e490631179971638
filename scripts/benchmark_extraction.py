#!/usr/bin/env python3
"""Print the CPU seconds of every stage of extraction as a Markdown table.

    benchmark_extraction.py [SOURCE] [--voxel-size M] [--presets default thesis]

SOURCE is a cloud or BAG:topic; the default is the bundled bag's first agent. Each preset runs twice
as a process of its own, as users run it, and the second run counts: the first compiles the hot
loops. With --loaded a cloud file is extracted in this process, so that importing and loading do not
count. Seconds of CPU, not of wall clock, because machines are shared.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # CPU seconds are of one thread.

import argparse
import json
import resource
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from topometric_ros.io.clouds import read_cloud
from topometric_ros.runtime.config import preset_config, with_voxel_size
from topometric_ros.runtime.extract_map import extract_map

ROOT = Path(__file__).resolve().parents[1]
SOURCE = f"{ROOT / 'bags/demo'}:/robot1/scan_cloud"


def main() -> int:
    """Print the table; return 2 where an extraction fails."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("source", nargs="?", default=SOURCE)
    parser.add_argument("--voxel-size", type=float, default=0.1)
    parser.add_argument(
        "--loaded",
        action="store_true",
        help="extract a cloud file three times in this process instead",
    )
    parser.add_argument("--presets", nargs="+", default=["default", "thesis"])
    args = parser.parse_args()
    runs = {}
    for preset in args.presets:
        run = (_again if args.loaded else _extract)(args.source, preset, args.voxel_size)
        if run is None:
            return 2
        runs[preset] = run
    stages = list(dict.fromkeys(stage for run in runs.values() for stage in run["timings"]))
    print(f"| stage at {args.voxel_size:g} m (CPU s) | " + " | ".join(runs) + " |")
    print("|---" + "|---:" * len(runs) + "|")
    for stage in stages:
        _row(stage, [run["timings"].get(stage) for run in runs.values()])
    _row("all stages", [sum(run["timings"].values()) for run in runs.values()])
    _row("whole process", [run["cpu"] for run in runs.values()])
    print("| rooms | " + " | ".join(str(run["rooms"]) for run in runs.values()) + " |")
    return 0


def _extract(source: str, preset: str, voxel_size: float) -> dict[str, Any] | None:
    """Run `topometric extract` twice; return what the second run took and found."""
    with tempfile.TemporaryDirectory() as out:
        command = [sys.executable, "-m", "topometric_ros", "extract", source, "-o", out]
        command += ["--config", preset, "--voxel-size", str(voxel_size)]
        cpu = 0.0
        for _ in range(2):
            before = resource.getrusage(resource.RUSAGE_CHILDREN)
            if subprocess.run(command, stdout=subprocess.DEVNULL, check=False).returncode:
                return None
            after = resource.getrusage(resource.RUSAGE_CHILDREN)
            cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
        timings = json.loads((Path(out) / "timings.json").read_text(encoding="utf-8"))
        summary = json.loads((Path(out) / "map.json").read_text(encoding="utf-8"))
        return {"timings": timings, "cpu": cpu, "rooms": len(summary["rooms"])}


def _again(source: str, preset: str, voxel_size: float) -> dict[str, Any]:
    """Extract a cloud three times; return the least that each stage took once all was loaded."""
    config = with_voxel_size(preset_config(preset), voxel_size)
    points = read_cloud(Path(source)).points
    runs = [extract_map(points, config.extraction, config.merge.matching) for _ in range(3)]
    timings = {name: min(run.timings[name] for run in runs[1:]) for name in runs[0].timings}
    return {"timings": timings, "cpu": None, "rooms": len(runs[0].map.rooms)}


def _row(name: str, values: list[float | None]) -> None:
    print(f"| {name} | " + " | ".join("–" if v is None else f"{v:.2f}" for v in values) + " |")


if __name__ == "__main__":
    sys.exit(main())
