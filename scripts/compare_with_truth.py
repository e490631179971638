#!/usr/bin/env python3
"""Compare the transform in a `merge.json` with a known one and say how far apart they are.

    compare_with_truth.py OUT TRUTH.json [--within METRES DEGREES]

OUT is the output folder of `topometric merge` or `replay`; TRUTH.json holds `T_<first>_<second>`,
4 x 4, for the two agents. The distance is the mean displacement of the second agent's voxels, not
the difference of the translations, which a small error of the yaw would blow up far from the
origin. Exit status 1 where the agents were not aligned or the limits are exceeded.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

import numpy as np
from topometric_ros.io.map_files import read_labelled_ply


def displacement(
    T_found: np.ndarray, T_true: np.ndarray, global_points: np.ndarray
) -> tuple[float, float]:
    """Return the mean displacement (m) of points seen by the second agent and the angle (deg)."""
    points = (global_points - T_found[:3, 3]) @ T_found[:3, :3]
    moved = points @ (T_found - T_true)[:3, :3].T + (T_found - T_true)[:3, 3]
    cosine = (np.trace(T_true[:3, :3].T @ T_found[:3, :3]) - 1) / 2
    return float(np.linalg.norm(moved, axis=1).mean()), float(np.degrees(np.arccos(min(1, cosine))))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--within", type=float, nargs=2, default=(0.15, 1.0))
    args = parser.parse_args()
    alignment = json.loads((args.out / "merge.json").read_text())["alignments"][0]
    first, second = alignment["agents"]
    if alignment["T_a_b"] is None:
        print(f"{first} and {second} were not aligned: {alignment['reason']}")
        return 1
    T_true = np.array(json.loads(args.truth.read_text())[f"T_{first}_{second}"])
    table = read_labelled_ply(args.out / "global.ply")
    points = np.stack([table["x"], table["y"], table["z"]], 1)[(table["agent"] & 2) > 0]
    metres, degrees = displacement(np.array(alignment["T_a_b"]), T_true, points)
    right = metres <= args.within[0] and degrees <= args.within[1]
    print(
        f"T_{first}_{second} is {metres:.3f} m and {degrees:.2f} deg from the truth "
        f"({'within' if right else 'NOT within'} {args.within[0]} m and {args.within[1]} deg)"
    )
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(main())
