#!/usr/bin/env python3
"""Print how often an extraction warns of good clouds, and how often of clouds that were spoilt.

    measure_warnings.py CASES [CASES ...] [--every N]

CASES holds one folder a case, as `topometric simulate` writes them and as the ready-made pairs are;
all their clouds are right, so that every warning on one is a false one. Every N-th cloud is spoilt,
too: what lies higher than 1.8 m above the floor of its storey is cut off (`low_view` is the warning
to expect), it is tilted by 35°, or every point is moved by 15 cm (any warning, or a refusal).
"""

from __future__ import annotations

import argparse
import logging
from collections import Counter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.extraction.errors import ExtractionError
from topometric_ros.extraction.pipeline import Extraction, extract
from topometric_ros.io.ply import read_ply_points

Points = NDArray[np.float64]

_SEEN = 1.8
_TILT = 35.0
_NOISE = 0.15


def main() -> None:
    """Print two tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--every", type=int, default=5, help="spoil every N-th cloud")
    args = parser.parse_args()
    logging.disable(logging.WARNING)
    clouds = sorted(p for root in args.cases for p in root.glob("*/[ab].ply"))
    false: Counter[str] = Counter()
    told = {"cut at 1.8 m": 0, "tilted by 35°": 0, "noise of 15 cm": 0}
    warned, spoilt = 0, 0
    for index, path in enumerate(clouds):
        points = read_ply_points(path)
        extraction = extract(points, ExtractionConfig())
        codes = _warnings(extraction)
        false.update(codes)
        warned += bool(codes)
        if codes:
            print(f"{path}: {', '.join(sorted(codes))}", flush=True)
        if index % args.every == 0:
            spoilt += 1
            told["cut at 1.8 m"] += bool({"low_view", "refused"} & _of(_cut(points, extraction)))
            told["tilted by 35°"] += bool(_of(_tilted(points)))
            told["noise of 15 cm"] += bool(_of(_noisy(points)))
    print(f"\n| {len(clouds)} right clouds | warned |\n|---|---:|\n| any | {warned} |")
    for code, count in sorted(false.items()):
        print(f"| `{code}` | {count} |")
    print(f"\n| {spoilt} spoilt clouds | told |\n|---|---:|")
    for name, count in told.items():
        print(f"| {name} | {count} |")


def _warnings(extraction: Extraction) -> set[str]:
    return {f.code for f in extraction.quality.findings if f.is_warning}


def _of(points: Points) -> set[str]:
    """Return the codes of the warnings on a cloud; `refused` where no map is made of it."""
    try:
        return _warnings(extract(points, ExtractionConfig()))
    except ExtractionError:
        return {"refused"}


def _cut(points: Points, extraction: Extraction) -> Points:
    """Leave of every storey what lies at most 1.8 m above its floor."""
    T = extraction.map.T_level_input
    z = points @ T[2, :3] + T[2, 3]
    floors = np.array([s.floor_z for s in extraction.map.storeys])
    storey = np.maximum(np.searchsorted(floors - 0.3, z) - 1, 0)
    return points[z <= floors[storey] + _SEEN]


def _tilted(points: Points) -> Points:
    c, s = np.cos(np.radians(_TILT)), np.sin(np.radians(_TILT))
    return np.asarray(points @ np.array([[1, 0, 0], [0, c, s], [0, -s, c]]))


def _noisy(points: Points) -> Points:
    return points + np.random.default_rng(0).normal(0.0, _NOISE, points.shape)


if __name__ == "__main__":
    main()
