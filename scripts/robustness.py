#!/usr/bin/env python3
"""Print how well rooms are found in clouds made worse step by step, as a Markdown table.

    robustness.py CASE... [--figure PNG] [--preset default] [--seed 0]

CASE is a folder with `a.ply`, `truth.json` (`rooms_a`: rooms walked) and `truth.npz` (`a`: room of
each point, -1 none), as those of ../shared/data/pairs. One thing at a time is made worse: points
dropped, noise added, floor and ceiling cut out, the map bent and tilted, voxels larger and smaller.
Every number is the mean MIoU (walked rooms, observed truth) over the cases, with the lowest.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import with_values
from topometric_ros.evaluation.metrics_rooms import room_overlap, room_scores
from topometric_ros.extraction.assemble import majority
from topometric_ros.extraction.config import ExtractionConfig, extraction_preset
from topometric_ros.extraction.errors import ExtractionError
from topometric_ros.extraction.pipeline import extract
from topometric_ros.io.clouds import read_cloud
from topometric_ros.voxels.grid import lattice_coordinates
from topometric_ros.voxels.index import VoxelIndex

Points = NDArray[np.float64]
Change = Callable[[Points, float, np.random.Generator], tuple[Points, NDArray[np.bool_]]]

_PATCH = 1.0
"""Edge in m of the floor's patches that are cut out."""


def _all(points: Points) -> NDArray[np.bool_]:
    return np.ones(len(points), bool)


def _height(points: Points, share: float) -> float:
    """Return the height of the largest level surface in the lower or upper part of a cloud."""
    z = points[:, 2]
    counts, edges = np.histogram(z, np.arange(z.min(), z.max() + 0.1, 0.1))
    part = slice(0, len(counts) // 2) if share == 0.0 else slice(len(counts) // 2, None)
    return float(edges[part][int(np.argmax(counts[part]))] + 0.05)


def _dropped(points: Points, share: float, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    return points, rng.random(len(points)) >= share


def _noisy(points: Points, metres: float, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    return points + rng.normal(0.0, metres, points.shape), _all(points)


def _bent(points: Points, degrees: float, _: np.random.Generator):  # type: ignore[no-untyped-def]
    """Turn the map about its middle by `degrees` for every 10 m along x, as drift in yaw does."""
    middle = points.mean(axis=0)
    away = points - middle
    angle = np.radians(degrees) * away[:, 0] / 10.0
    x = away[:, 0] * np.cos(angle) - away[:, 1] * np.sin(angle)
    y = away[:, 0] * np.sin(angle) + away[:, 1] * np.cos(angle)
    return np.column_stack([x, y, away[:, 2]]) + middle, _all(points)


def _tilted(points: Points, degrees: float, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    towards, a = rng.uniform(0, 2 * np.pi), np.radians(degrees)
    c, s = np.cos(towards), np.sin(towards)
    turn = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
    lean = np.array([[1, 0, 0], [0, np.cos(a), -np.sin(a)], [0, np.sin(a), np.cos(a)]])
    return points @ (turn @ lean @ turn.T).T, _all(points)


def _without_floor(points: Points, share: float, rng: np.random.Generator):  # type: ignore[no-untyped-def]
    patch = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / _PATCH).astype(np.int64)
    chosen = rng.random(tuple(patch.max(axis=0) + 1)) < share
    near = np.abs(points[:, 2] - _height(points, 0.0)) < 0.15
    return points, ~(near & chosen[patch[:, 0], patch[:, 1]])


def _without_ceiling(points: Points, metres: float, _: np.random.Generator):  # type: ignore[no-untyped-def]
    """Cut off what lies higher than `metres` below the ceiling; 0 cuts nothing."""
    return points, points[:, 2] <= _height(points, 1.0) - metres if metres else _all(points)


CHANGES: dict[str, tuple[str, tuple[float, ...], Change | None]] = {
    "points dropped": ("", (0.0, 0.3, 0.6, 0.9), _dropped),
    "noise": ("m", (0.0, 0.01, 0.02, 0.03, 0.05), _noisy),
    "voxel size": ("m", (0.05, 0.1, 0.15, 0.2), None),
    "bend per 10 m": ("deg", (0.0, 1.0, 3.0), _bent),
    "cut below the ceiling": ("m", (0.0, 0.1, 0.4, 0.8), _without_ceiling),
    "floor missing": ("", (0.0, 0.2, 0.4, 0.6), _without_floor),
    "tilt": ("deg", (0.0, 0.5, 1.0, 3.0, 5.0), _tilted),
}


def main() -> int:
    """Print the table and draw the figure."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", nargs="+", type=Path, metavar="CASE")
    parser.add_argument("--figure", type=Path, help="draw the curves to this PNG")
    parser.add_argument("--preset", default="default")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    logging.disable(logging.WARNING)
    config = extraction_preset(args.preset)
    curves: dict[str, list[tuple[float, float, float]]] = {}
    for name, (unit, values, change) in CHANGES.items():
        rows = []
        for value in values:
            scores = [_score(case, config, change, value, args.seed) for case in args.cases]
            rows.append((value, float(np.mean(scores)), min(scores)))
        curves[name] = rows
        cells = [f"{value:g} {unit}: {mean:.2f} ({low:.2f})" for value, mean, low in rows]
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)
    if args.figure:
        _draw(curves, args.figure)
    return 0


def _score(
    case: Path, config: ExtractionConfig, change: Change | None, value: float, seed: int
) -> float:
    """Return the MIoU of a case made worse, 0 where no map can be made."""
    points = read_cloud(case / "a.ply").points
    label = np.load(case / "truth.npz")["a"].astype(np.int32)
    if change is None:
        config = with_values(config, {"voxel_size": value})
    else:
        points, kept = change(points, value, np.random.default_rng(seed))
        points, label = points[kept], label[kept]
    try:
        m = extract(points, config).map
    except ExtractionError:
        return 0.0
    level = points @ m.T_level_input[:3, :3].T + m.T_level_input[:3, 3]
    row = VoxelIndex(m.voxels).rows(
        lattice_coordinates(level, m.voxel_size, np.asarray(m.origin)).astype(np.int32)
    )
    known = row >= 0
    rows, group = np.unique(row[known], return_inverse=True)
    true = majority(group, label[known])
    walked = json.loads((case / "truth.json").read_text())["rooms_a"]
    return room_scores(room_overlap(true, m.room[rows]), walked).miou_walked


def _draw(curves: dict[str, list[tuple[float, float, float]]], path: Path) -> None:
    """Draw a panel for each curve: the mean, and down to the lowest case."""
    import matplotlib

    matplotlib.use("Agg")
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(2, 4, figsize=(12, 5), sharey=True)
    for axis, (name, rows) in zip(axes.flat, curves.items(), strict=False):
        value, mean, low = np.array(rows).T
        axis.fill_between(value, low, mean, alpha=0.2, linewidth=0)
        axis.plot(value, mean, marker="o")
        unit = CHANGES[name][0]
        axis.set(xlabel=f"{name} / {unit}" if unit else name, ylim=(0, 1))
        axis.grid(alpha=0.3)
    axes.flat[-1].axis("off")
    axes[0, 0].set_ylabel("MIoU")
    figure.tight_layout()
    figure.savefig(path, dpi=80, metadata={"Software": None})


if __name__ == "__main__":
    sys.exit(main())
