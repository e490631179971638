#!/usr/bin/env python3
"""Print precision and recall of rooms on floor plans as the survey of room segmentation has them.

    compare_with_survey.py PLAN.png [PLAN.png ...] [--preset NAME]

PLAN.png is one of the survey's plans (Bormann et al., Room Segmentation: Survey, Implementation,
and Analysis, ICRA 2016) with its NAME_gt_segmentation.png beside it, as `topometric simulate` takes
them. One agent walks through every room, so that the map is whole, and the floor of its map is
compared cell by cell: recall is the largest share of a true room in one found room, precision that
of a found room in one true room, each the mean over rooms.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from measure_passages import SEED, tour
from scipy.spatial import cKDTree

from topometric_ros.evaluation.metrics_rooms import precision_and_recall, room_overlap
from topometric_ros.extraction.config import ExtractionConfig, extraction_preset
from topometric_ros.extraction.pipeline import extract
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.cases import SimulationConfig, prepare, simulate

_FLOOR = 0.15
"""Voxels this near to the floor are its cells, m."""


def main() -> None:
    """Print a row for each plan, and the mean and the standard deviation."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("plans", type=Path, nargs="+")
    parser.add_argument("--preset", default="default")
    args = parser.parse_args()
    config = extraction_preset(args.preset)
    print("| plan | rooms | found | recall | precision |\n|---|---:|---:|---:|---:|")
    rows = []
    for plan in args.plans:
        rooms, found, precision, recall = measure(plan, config)
        rows.append((recall, precision))
        print(f"| {plan.stem} | {rooms} | {found} | {recall:.1%} | {precision:.1%} |", flush=True)
    mean, spread = np.mean(rows, axis=0), np.std(rows, axis=0)
    cells = [f"{m:.1%} ± {s:.1%}" for m, s in zip(mean, spread, strict=True)]
    print(f"| mean ± standard deviation | | | {cells[0]} | {cells[1]} |")


def measure(plan: Path, config: ExtractionConfig) -> tuple[int, int, float, float]:
    """Return how many rooms a plan has and how many were found, precision and recall."""
    simulation = SimulationConfig(agents=1)
    ready = prepare(load_building(str(plan)), simulation)
    agent = simulate(ready, simulation, SEED, [tour(ready.walkable)]).agents[0]
    m = extract(agent.points, config).map
    z = m.centres()[:, 2]
    centres = (m.centres() - m.T_level_input[:3, 3]) @ m.T_level_input[:3, :3]
    away, nearest = cKDTree(agent.points).query(centres)
    true = np.where(away <= 2 * m.voxel_size, agent.room[nearest], -1)
    floor = (np.abs(z - m.storeys[0].floor_z) <= _FLOOR) & (true >= 0)
    overlap = room_overlap(true[floor], m.room[floor])
    walked = [i for i, k in enumerate(overlap.true_ids) if k in set(agent.rooms_walked)]
    precision, recall = precision_and_recall(overlap, walked)
    return len(walked), len(overlap.found_ids), precision, recall


if __name__ == "__main__":
    main()
