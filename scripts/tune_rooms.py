#!/usr/bin/env python3
"""Score the rooms of preset default building by building, and refit the weights of merging.

    tune_rooms.py CASES [CASES ...] [--candidates N]

CASES holds one folder a case, as `topometric simulate` writes them and as the ready-made pairs are.
With candidates, weights are drawn round those of the configuration; every building is then scored
with the candidate that is best for all other buildings, so that nothing was fitted to it. Prints
a Markdown table: MIoU as `check/score.py` counts it, and how far the rooms of two agents agree
where both saw one surface, voxels within 0.1 m that bound one true room: the mean Jaccard index of
the first agent's rooms with those assigned to them, and of the two rooms that hold most of each
true room which both walked through.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.evaluation.metrics_rooms import assigned, jaccard, room_overlap, room_scores
from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.extraction.merging import MergingConfig
from topometric_ros.extraction.pipeline import extract
from topometric_ros.io.ply import read_ply_points
from topometric_ros.topometric_map import TopometricMap

_WEIGHTS = ("visibility", "saddle", "line", "corner", "threshold")
_SPREAD = (0.4, 0.4, 0.6, 0.8, 0.4)
_SMALLEST = 50


@dataclass(frozen=True)
class Agent:
    """One cloud with its truth; `T_case_input` (4, 4) puts it into the frame of agent a."""

    building: str
    points: NDArray[np.float64]
    room: NDArray[np.int64]
    walked: tuple[int, ...]
    T_case_input: NDArray[np.float64]


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("cases", type=Path, nargs="+")
    parser.add_argument("--candidates", type=int, default=0, help="sets of weights to draw")
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    folders = sorted(p.parent for root in args.cases for p in root.glob("*/truth.json"))
    cases = [_read(folder) for folder in folders]
    buildings = np.array([case[0].building for case in cases])
    candidates = _candidates(args.candidates, np.random.default_rng(args.seed))
    found = np.array([[_scores(case, weights) for case in cases] for weights in candidates])
    print(
        "| building | clouds | MIoU | worst | agreement | rooms of both | left out: MIoU | worst |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    kept = []
    for building in sorted(set(buildings.tolist())):
        ours = buildings == building
        best = int(np.argmax([_mean_of_buildings(f[~ours], buildings[~ours]) for f in found]))
        kept.append(_row(building, found[0][ours], found[best][ours]))
    print(_line("mean of buildings", np.nanmean(kept, axis=0)))
    if len(candidates) > 1:
        best = int(np.argmax([_mean_of_buildings(f, buildings) for f in found]))
        print("\nbest of all:", {w: round(getattr(candidates[best], w), 2) for w in _WEIGHTS})


def _row(
    building: str, now: NDArray[np.float64], fitted: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Print a building's line from the scores (n, 4) of its cases; return what is averaged."""
    rows = np.array(
        [
            2.0 * len(now),
            now[:, :2].mean(),
            now[:, :2].min(),
            *(np.nanmean(k) if np.isfinite(k).any() else np.nan for k in now[:, 2:].T),
            fitted[:, :2].mean(),
            fitted[:, :2].min(),
        ]
    )
    print(_line(building, rows), flush=True)
    return rows


def _line(name: str, row: NDArray[np.float64]) -> str:
    return f"| {name} | {row[0]:.0f} | " + " | ".join(f"{value:.3f}" for value in row[1:]) + " |"


def _mean_of_buildings(found: NDArray[np.float64], buildings: NDArray[np.str_]) -> float:
    if len(found) == 0:
        return 0.0
    return float(np.mean([found[buildings == b, :2].mean() for b in set(buildings.tolist())]))


def _candidates(count: int, rng: np.random.Generator) -> list[MergingConfig]:
    """Return the configuration's weights and `count` others round them."""
    now = MergingConfig()
    drawn = [now]
    for step in rng.normal(size=(count, len(_WEIGHTS))) * _SPREAD:
        values = {w: max(getattr(now, w) + s, 0.0) for w, s in zip(_WEIGHTS, step, strict=True)}
        drawn.append(replace(now, **values))
    return drawn


def _read(folder: Path) -> tuple[Agent, Agent]:
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    rooms = np.load(folder / "truth.npz")
    agents = [
        Agent(
            truth["plan"].removesuffix("_furnitures"),
            read_ply_points(folder / f"{key}.ply"),
            rooms[key].astype(np.int64),
            tuple(truth[f"rooms_{key}"]),
            np.eye(4) if key == "a" else np.array(truth["a_from_b"]),
        )
        for key in "ab"
    ]
    return agents[0], agents[1]


def _scores(case: tuple[Agent, Agent], weights: MergingConfig) -> tuple[float, ...]:
    """Return the MIoU of both agents and how far their rooms agree, all and those of both."""
    config = ExtractionConfig()
    config = replace(config, narrowings=replace(config.narrowings, merging=weights))
    maps = [extract(agent.points, config).map for agent in case]
    true = [_truth(agent, m) for agent, m in zip(case, maps, strict=True)]
    found = [
        room_scores(room_overlap(t, m.room), agent.walked).miou_walked
        for agent, m, t in zip(case, maps, true, strict=True)
    ]
    return (*found, *_agreement(case, maps, true))


def _centres(m: TopometricMap) -> NDArray[np.float64]:
    """Return the centres of a map's voxels in its input frame: (N, 3), m."""
    T = m.T_level_input
    return np.asarray((m.centres() - T[:3, 3]) @ T[:3, :3])


def _truth(agent: Agent, m: TopometricMap) -> NDArray[np.int64]:
    """Return the true room of every voxel, that of the nearest point: (N,), -1 none."""
    reach = 2 * m.voxel_size
    distance, nearest = cKDTree(agent.points).query(_centres(m), distance_upper_bound=reach)
    inside = np.isfinite(distance)
    true = np.full(len(inside), -1, np.int64)
    true[inside] = agent.room[nearest[inside]]
    return true


def _agreement(
    case: tuple[Agent, Agent], maps: list[TopometricMap], true: list[NDArray[np.int64]]
) -> tuple[float, float]:
    """Return two mean Jaccard indices of rooms in what both saw; NaN where that is too little.

    `true` are the true rooms of the voxels (N,) of either map: two faces of a wall lie within
    0.1 m of each other and are not one surface.
    """
    places = []
    for agent, m in zip(case, maps, strict=True):
        T = agent.T_case_input
        places.append((_centres(m) @ T[:3, :3].T + T[:3, 3])[m.room >= 0])
    room_a, room_b = (m.room[m.room >= 0] for m in maps)
    distance, nearest = cKDTree(places[1]).query(places[0], distance_upper_bound=0.1)
    true_a, true_b = (t[m.room >= 0] for t, m in zip(true, maps, strict=True))
    shared = np.isfinite(distance)
    shared[shared] = true_a[shared] == true_b[nearest[shared]]
    if np.count_nonzero(shared) < 2 * _SMALLEST:
        return float("nan"), float("nan")
    room_a, room_b = room_a[shared], room_b[nearest[shared]]
    overlap = room_overlap(room_a, room_b)
    similarity = jaccard(overlap)
    large = {i for i, size in enumerate(overlap.true_sizes) if size >= _SMALLEST}
    pairs = {i: similarity[i, j] for i, j in assigned(similarity)}
    of_rooms = [float(pairs.get(i, 0.0)) for i in sorted(large)]
    both = set(case[0].walked) & set(case[1].walked)
    of_both = []
    for room in sorted(both):
        ours = true_a[shared] == room
        if np.count_nonzero(ours) >= _SMALLEST:
            a, b = np.bincount(room_a[ours]).argmax(), np.bincount(room_b[ours]).argmax()
            common = np.count_nonzero((room_a == a) & (room_b == b))
            either = np.count_nonzero((room_a == a) | (room_b == b))
            of_both.append(float(common / either))
    return _mean(of_rooms), _mean(of_both)


def _mean(values: list[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


if __name__ == "__main__":
    main()
