#!/usr/bin/env python3
"""Compare where candidate poses come from: matched rooms, the global search, or both.

    compare_sources.py PAIRS [PAIRS ...]

PAIRS holds one folder a pair: a.ply, b.ply and truth.json with `a_from_b` and `overlap`. Each is
extracted once and merged with every choice of sources, and with preset thesis on maps of its own.
Prints a Markdown table. "Right" is under 0.5 m of mean displacement and under 5 degrees.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # CPU seconds are of one thread.

import argparse
import json
import time
from dataclasses import replace
from pathlib import Path

import numpy as np

from topometric_ros.alignment import Alignment
from topometric_ros.evaluation.metrics_fusion import (
    LITTLE_OVERLAP,
    NO_OVERLAP,
    RIGHT,
    TransformError,
    transform_error,
)
from topometric_ros.fusion.align import align
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.runtime.config import ToolConfig, load_config
from topometric_ros.runtime.sources import load_sources
from topometric_ros.topometric_map import TopometricMap


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("pairs", type=Path, nargs="+")
    args = parser.parse_args()
    default, thesis = load_config("default"), load_config("thesis")
    choices: dict[str, tuple[ToolConfig, MergeConfig]] = {
        "rooms and search": (default, default.merge),
        "search alone": (default, replace(default.merge, sources=("search",))),
        "rooms alone": (default, replace(default.merge, sources=("rooms",))),
        "preset thesis": (thesis, thesis.merge),
        "preset thesis, check: none": (thesis, replace(thesis.merge, check="none")),
    }
    found: dict[str, list[tuple[float, bool, bool, float, float]]] = {name: [] for name in choices}
    for folder in sorted(p.parent for root in args.pairs for p in root.glob("*/truth.json")):
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        maps = {config.preset: _maps(folder, config) for config in (default, thesis)}
        for name, (config, merge) in choices.items():
            a, b = maps[config.preset]
            start = time.process_time()
            alignment = align(a, b, merge)
            cpu = time.process_time() - start
            error = _error(alignment, np.array(truth["a_from_b"]), b)
            right = error is not None and error.within(RIGHT)
            off = error.displacement if error is not None else np.nan
            found[name].append((truth["overlap"], alignment.accepted, right, off, cpu))
    _print(found)


def _maps(folder: Path, config: ToolConfig) -> list[TopometricMap]:
    clouds = [str(folder / "a.ply"), str(folder / "b.ply")]
    return [loaded.map for loaded in load_sources(clouds, config)]


def _error(alignment: Alignment, true: np.ndarray, b: TopometricMap) -> TransformError | None:
    """Return how far an accepted alignment is off, on b's voxels in its input frame."""
    if not alignment.accepted or alignment.T_a_b is None:
        return None
    T_input_level = np.linalg.inv(b.T_level_input)
    points = b.centres() @ T_input_level[:3, :3].T + T_input_level[:3, 3]
    return transform_error(alignment.T_a_b, true, points)


def _print(found: dict[str, list[tuple[float, bool, bool, float, float]]]) -> None:
    print(
        "| candidates from | accepted and right | accepted and wrong | displacement | CPU a pair |"
    )
    print("|---|---:|---:|---|---|")
    for name, rows in found.items():
        shared = sum(row[0] >= LITTLE_OVERLAP for row in rows)
        right = [row for row in rows if row[1] and row[2] and row[0] >= NO_OVERLAP]
        wrong = sum(row[1] and not row[2] for row in rows)
        off = [1000 * row[3] for row in right]
        displacement = f"{min(off):.1f}–{max(off):.1f} mm" if off else "–"
        seconds = [row[4] for row in rows]
        print(
            f"| {name} | {len(right)}/{shared} | {wrong}/{len(rows)} | {displacement} "
            f"| {min(seconds):.1f}–{max(seconds):.1f} s |"
        )


if __name__ == "__main__":
    main()
