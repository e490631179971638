#!/usr/bin/env python3
"""Print how far the alignments of a merge lie from known ones.

    compare_with_truth.py OUT TRUTH.json [--within METRES DEGREES]

OUT is the output folder of `topometric merge` or `replay`; TRUTH.json holds 4 x 4 matrices named
T_AGENT_AGENT, and pairs without one are passed over. The distance is the mean displacement of the
second agent's voxels; a translation read at the origin would multiply errors of the yaw. Exit
status 1 where a known pair is not aligned or is off by more than the limits.
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from topometric_ros.io.map_files import load_global_map


def main() -> int:
    """Print two lines for every pair that the truth knows."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("truth", type=Path)
    parser.add_argument("--within", type=float, nargs=2, default=(0.15, 1.0))
    args = parser.parse_args()
    merged = json.loads((args.out / "merge.json").read_text(encoding="utf-8"))
    truth = json.loads(args.truth.read_text(encoding="utf-8"))
    points = _points_of_agents(args.out / "global.tmap", merged["agents"])
    wrong = 0
    for alignment in merged["alignments"]:
        a, b = alignment["agents"]
        true = _true_transform(truth, a, b)
        if true is None:
            continue
        if alignment["status"] != "accepted" or b not in points:
            print(f"{a} and {b}: {alignment['status']} ({alignment['reason']})")
            wrong += 1
            continue
        found = np.array(alignment["T_a_b"])
        x, y, z = found[:3, 3]
        yaw = np.degrees(np.arctan2(found[1, 0], found[0, 0]))
        print(f"{a} from {b}: x {x:.3f} m, y {y:.3f} m, z {z:.3f} m, yaw {yaw:.2f}°")
        metres, degrees = _error(found, true, points[b])
        right = metres <= args.within[0] and degrees <= args.within[1]
        limits = f"limit {args.within[0]:g} m, {args.within[1]:g}°"
        print(f"off the truth by {metres:.3f} m (mean displacement) and {degrees:.2f}°; {limits}")
        wrong += not right
    return int(wrong > 0)


def _points_of_agents(path: Path, agents: list[dict[str, Any]]) -> dict[str, np.ndarray]:
    """Return the voxels that each aligned agent saw: (n, 3) m, in the agent's own frame."""
    fused, observers, ids = load_global_map(path)
    T_input_level = np.linalg.inv(fused.T_level_input)
    centres = fused.centres() @ T_input_level[:3, :3].T + T_input_level[:3, 3]
    points = {}
    for agent in agents:
        if agent["T_global_agent"] is not None and observers is not None:
            bit = ids.index(agent["id"])
            T = np.linalg.inv(agent["T_global_agent"])
            seen = centres[(observers >> bit) & 1 == 1]
            points[agent["id"]] = seen @ T[:3, :3].T + T[:3, 3]
    return points


def _error(found: np.ndarray, true: np.ndarray, points: np.ndarray) -> tuple[float, float]:
    """Return the mean displacement of points (n, 3) in m and the angle between in degrees."""
    moved = points @ (found - true)[:3, :3].T + (found - true)[:3, 3]
    cosine = (np.trace(true[:3, :3].T @ found[:3, :3]) - 1) / 2
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    return float(np.linalg.norm(moved, axis=1).mean()), float(angle)


def _true_transform(truth: dict[str, Any], a: str, b: str) -> np.ndarray | None:
    """Return T_a_b (4, 4), m, from the truth, or None."""
    if f"T_{a}_{b}" in truth:
        return np.array(truth[f"T_{a}_{b}"])
    if f"T_{b}_{a}" in truth:
        return np.linalg.inv(truth[f"T_{b}_{a}"])
    return None


if __name__ == "__main__":
    sys.exit(main())
