#!/usr/bin/env python3
"""Measure what merging a pair costs beside KISS-Matcher, from raw clouds and from ready maps.

    measure_cost.py PAIRS [--points 2000000]

PAIRS holds folders of pairs as `topometric simulate` writes them. All methods run on each pair in
one process, one after the other, on clouds in memory; the first pair is run once before, so that
libraries are loaded. "Maps" begins with reading two .tmap files. Memory is the peak of a process of
its own that extracts and merges the pair with the most points, each cloud brought to --points by
drawing points of its own with a millimetre of noise. Prints Markdown tables.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # CPU seconds are of one thread.

import argparse
import tempfile
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.evaluation.case import pair_folders
from topometric_ros.evaluation.peers.kiss_matcher import KissMatcher
from topometric_ros.evaluation.processes import in_own_process, peak_mb
from topometric_ros.fusion.merge import merge
from topometric_ros.io.map_files import load_map, save_map
from topometric_ros.runtime.config import load_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation.case_files import read_case
from topometric_ros.topometric_map import TopometricMap

Cloud = NDArray[np.float64]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("pairs", type=Path)
    parser.add_argument("--points", type=int, default=2_000_000)
    args = parser.parse_args()
    folders = pair_folders(args.pairs)
    kiss = KissMatcher()
    print("| pair | points | raw clouds | maps | KISS-Matcher | raw / KISS | maps / KISS |")
    print("|---|---:|---:|---:|---:|---:|---:|")
    rows = []
    sizes = {}
    for number, folder in enumerate([folders[0], *folders]):
        a, b = (agent.points for agent in read_case(folder).agents)
        sizes[folder] = len(a) + len(b)
        seconds = [
            _timed(lambda: _merged(_extracted("a", a), _extracted("b", b))),  # noqa: B023
            _from_maps(a, b),
            _timed(lambda: kiss.align(a, b)),  # noqa: B023
        ]
        if number:
            rows.append(seconds)
            _print(folder.name, f"{len(a) + len(b):,}", seconds)
    _print("median", "–", np.median(rows, axis=0).tolist())
    largest = max(sizes, key=lambda folder: sizes[folder])
    peak = in_own_process(_peak, str(largest), args.points, timeout=3600.0)
    print(f"\n{args.points:,} points an agent ({largest.name}): peak {peak:.0f} MB")


def _print(name: str, points: str, seconds: list[float]) -> None:
    raw, maps, kiss = seconds
    cells = [name, points, *(f"{s:.1f} s" for s in seconds)]
    print(f"| {' | '.join([*cells, f'{raw / kiss:.2f}', f'{maps / kiss:.2f}'])} |", flush=True)


def _timed(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def _extracted(agent: str, points: Cloud) -> TopometricMap:
    config = load_config("default")
    return extract_map(points, config.extraction, config.merge.matching, agent=agent).map


def _merged(*maps: TopometricMap) -> object:
    return merge(maps, load_config("default").merge)


def _from_maps(a: Cloud, b: Cloud) -> float:
    """Return what merging takes once both maps lie in files."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{agent}.tmap" for agent in "ab"]
        for path, points in zip(paths, (a, b), strict=True):
            save_map(path, _extracted(path.stem, points))
        return _timed(lambda: _merged(*map(load_map, paths)))


def _peak(folder: str, wanted: int) -> float:
    """Extract and merge a pair brought to so many points an agent; return the peak in MB."""
    rng = np.random.default_rng(0)
    maps = []
    for agent in read_case(Path(folder)).agents:
        more = max(0, wanted - len(agent.points))
        drawn = agent.points[rng.integers(len(agent.points), size=more)]
        points = np.concatenate([agent.points, drawn + rng.normal(0.0, 0.001, drawn.shape)])
        maps.append(_extracted(agent.id, points[:wanted]))
    _merged(*maps)
    return peak_mb()


if __name__ == "__main__":
    main()
