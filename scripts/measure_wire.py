"""What a map's message weighs, part by part, and what coarser mean points cost a merge.

    python scripts/measure_wire.py PAIRS [--steps 16 8 4 2]

PAIRS holds one folder a pair: a.ply, b.ply and truth.json (a_from_b). Each cloud is extracted once,
its mean points are rounded to each number of steps an axis (an odd one has a step for the voxel's
middle, 1 is what the extractor sends without `mean_points`), and the pair is aligned again; the
error is the mean distance by which the found transform displaces the second map's voxels. Prints
Markdown tables.
"""

from __future__ import annotations

import argparse
import dataclasses
import json
from pathlib import Path

import numpy as np
import zstandard

from topometric_ros import map_checks, topometric_map
from topometric_ros.evaluation.metrics_fusion import bytes_on_the_wire
from topometric_ros.fusion.align import align
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.io import packing
from topometric_ros.io.clouds import read_cloud
from topometric_ros.runtime.config import preset_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.runtime.message_codec import without_mean_points
from topometric_ros.stopwatch import Stopwatch
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels import grid

FINEST = 16
_EXACT = 240
"""Steps in which the middles of all coarser ones can be told."""


def set_steps(steps: int) -> None:
    """Have every part that reads or makes mean points use so many steps an axis."""
    for module in (topometric_map, map_checks, grid):
        module.OFFSET_STEPS = steps  # type: ignore[attr-defined]


def stepped(m: TopometricMap, steps: int) -> np.ndarray:
    """Return the steps (N, 3), from 0, that the mean points of a map of the finest steps lie in."""
    return ((m.offsets + 0.5 + FINEST // 2) * steps // FINEST).astype(np.uint16)


def rounded(m: TopometricMap, steps: int) -> TopometricMap:
    """Return a map of the finest steps with its mean points in coarser ones."""
    if steps == 1:
        set_steps(4)
        return without_mean_points(m)
    set_steps(_EXACT)
    middles = (stepped(m, steps) + 0.5) / steps - 0.5
    return dataclasses.replace(m, offsets=np.floor(middles * _EXACT).astype(np.int8))


def sizes(m: TopometricMap, steps: int) -> tuple[int, int, int]:
    """Return the bytes of a map's mean points, of its other voxel data, and of all the rest."""
    raw = stepped(m, steps) @ np.array([1, steps, steps**2], np.uint16)
    raw = raw.astype(np.uint8) if steps**3 <= 256 else raw
    points = len(zstandard.ZstdCompressor(level=15).compress(raw.tobytes()))
    voxels = len(packing.pack_coords(m.voxels))
    set_steps(4)
    bare = dataclasses.replace(m, offsets=np.zeros_like(m.offsets))
    rest = bytes_on_the_wire(bare) - len(packing.pack_offsets(bare.offsets)) - voxels
    return points, voxels, rest


def main() -> None:
    """Run the script."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("pairs", type=Path)
    parser.add_argument("--steps", type=int, nargs="+", default=[16, 8, 4, 2])
    options = parser.parse_args()
    config = preset_config("default")
    print("| pair | raw kB | voxels kB | rest kB | ", end="")
    print(" | ".join(f"{s} steps: kB, % of raw, error mm" for s in options.steps), "|")
    print("|---|" + "---:|" * (3 + len(options.steps)))
    for folder in sorted(p for p in options.pairs.iterdir() if (p / "a.ply").exists()):
        truth = json.loads((folder / "truth.json").read_text()).get("a_from_b")
        set_steps(FINEST)
        maps = [
            extract_map(
                read_cloud(folder / f"{agent}.ply").points,
                config.extraction,
                config.merge.matching,
                agent=agent,
            ).map
            for agent in "ab"
        ]
        raw = sum((folder / f"{agent}.ply").stat().st_size for agent in "ab")
        cells = []
        for steps in options.steps:
            pair = [rounded(m, steps) for m in maps]
            a, b = (Prepared(m, config.merge.search.scoring, config.merge.matching) for m in pair)
            found = align(a, b, config.merge, Stopwatch()).T_a_b
            error = "none"
            if found is not None and truth is not None:
                T_b_level = np.linalg.inv(pair[1].T_level_input)
                points = pair[1].centres() @ T_b_level[:3, :3].T + T_b_level[:3, 3]
                D = found - np.array(truth)
                moved = points @ D[:3, :3].T + D[:3, 3]
                error = f"{np.linalg.norm(moved, axis=1).mean() * 1e3:.1f}"
            parts = np.sum([sizes(m, steps) for m in maps], axis=0)
            cells.append(f"{parts[0] / 1e3:.0f}, {parts.sum() / raw:.2%}, {error}")
        row = [folder.name, *(f"{n / 1e3:.0f}" for n in (raw, parts[1], parts[2])), *cells]
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
