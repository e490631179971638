"""Print how far the alignments of a merge.json lie from the truth of a simulated recording.

compare_with_truth.py MERGE_JSON TRUTH_JSON

The truth holds 4 x 4 matrices named T_AGENT_AGENT; pairs without one are passed over.
"""

import json
import math
import sys
from pathlib import Path

import numpy as np


def main() -> int:
    """Print one line for every pair that the truth knows; 1 where one of them is not aligned."""
    merged, truth = (json.loads(Path(name).read_text(encoding="utf-8")) for name in sys.argv[1:3])
    missing = 0
    for alignment in merged["alignments"]:
        a, b = alignment["agents"]
        true = _true_transform(truth, a, b)
        if true is None:
            continue
        if alignment["status"] != "accepted":
            print(f"{a} and {b}: {alignment['status']} ({alignment['reason']})")
            missing += 1
            continue
        found = np.array(alignment["T_a_b"])
        for name, matrix in (("found", found), ("true", true)):
            x, y, z = matrix[:3, 3]
            yaw = math.degrees(math.atan2(matrix[1, 0], matrix[0, 0]))
            print(f"{a} from {b}, {name:5}: x {x:.3f} m, y {y:.3f} m, z {z:.3f} m, yaw {yaw:.2f}°")
        error = np.linalg.inv(true) @ found
        angle = math.degrees(math.acos(np.clip((np.trace(error[:3, :3]) - 1) / 2, -1, 1)))
        print(f"{a} from {b}, error: {np.linalg.norm(error[:3, 3]):.3f} m, {angle:.2f}°")
    return int(missing > 0)


def _true_transform(truth: dict, a: str, b: str) -> np.ndarray | None:
    """Return T_a_b (4, 4), m, from the truth, or None."""
    if f"T_{a}_{b}" in truth:
        return np.array(truth[f"T_{a}_{b}"])
    if f"T_{b}_{a}" in truth:
        return np.linalg.inv(truth[f"T_{b}_{a}"])
    return None


if __name__ == "__main__":
    sys.exit(main())
