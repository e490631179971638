#!/usr/bin/env python3
"""Compare the rooms of the global map: merged from the agents' rooms, or extracted anew.

    compare_fusion.py PAIRS [PAIRS ...] [--preset default | thesis]

PAIRS holds folders of pairs with truth; those that share less than a tenth are left out. Both maps
are fused with the true transform, so that only the fusion of rooms is compared: the topological one
of `fusion/fuse_rooms.py` (thesis §4.4.2), the extraction of the fused surface, and that with the
agents' viewpoints used again. The rooms of preset `default` come from no viewpoints, so there the
last one divides its fused geometry as preset `thesis` does. Prints a Markdown table: MIoU of the
rooms walked through, rooms found, and CPU seconds.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # CPU seconds are of one thread.

import argparse
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.evaluation.case import pair_folders
from topometric_ros.evaluation.metrics_fusion import LITTLE_OVERLAP
from topometric_ros.evaluation.metrics_rooms import RoomScores, room_overlap, room_scores
from topometric_ros.extraction.thesis_rooms import segment
from topometric_ros.fusion.fuse import fuse
from topometric_ros.fusion.poses import apply, inverse
from topometric_ros.runtime.config import load_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation.case import Case
from topometric_ros.simulation.case_files import read_case
from topometric_ros.topometric_map import NO_ROOM, TopometricMap
from topometric_ros.voxels.grid import VoxelGrid

REACH = 2.0
"""A voxel has the true room of a labelled point within this many voxel edges."""


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("pairs", type=Path, nargs="+")
    parser.add_argument("--preset", choices=("default", "thesis"), default="default")
    args = parser.parse_args()
    print(
        "| pair | merged: MIoU, rooms, CPU s | extracted anew: MIoU, rooms, CPU s | "
        "with the agents' viewpoints: MIoU, rooms, CPU s | true rooms |"
    )
    print("|---|---|---|---|---:|")
    totals: list[list[float]] = []
    for folder in (folder for root in args.pairs for folder in pair_folders(root)):
        case = read_case(folder)
        if case.overlap[0] < LITTLE_OVERLAP:
            continue
        cells, scores, walked = _compared(case, args.preset)
        totals.append(scores)
        print(f"| {folder.name} | {' | '.join(cells)} | {walked} |", flush=True)
    means = " | ".join(f"{mean:.3f}" for mean in np.mean(totals, axis=0))
    print(f"| mean | {means} | – |")


def _compared(case: Case, preset: str) -> tuple[list[str], list[float], int]:
    """Fuse a pair in all ways; also the scores and how many rooms were walked through."""
    config = load_config(preset)
    matching = config.merge.matching
    maps = [
        extract_map(agent.points, config.extraction, matching, agent=agent.id).map
        for agent in case.agents
    ]
    first = case.agents[0]
    places = [first.T_agent_building @ inverse(agent.T_agent_building) for agent in case.agents]
    start = time.process_time()
    merged = fuse(maps, list(places), config.merge.fuse).map
    between = time.process_time()
    surface = apply(inverse(merged.T_level_input), merged.surface())
    anew = extract_map(surface, config.extraction, matching, agent="global").map
    later = time.process_time()
    viewed = _from_viewpoints(merged)
    seconds = (between - start, later - between, time.process_time() - later)
    points = np.concatenate(
        [apply(T, agent.points) for T, agent in zip(places, case.agents, strict=True)]
    )
    tree, rooms = cKDTree(points), np.concatenate([agent.room for agent in case.agents])
    walked = sorted({int(room) for agent in case.agents for room in agent.rooms_walked})
    results = ((merged, merged.room), (anew, anew.room), (merged, viewed))
    scored = [_scores(m, room, tree, rooms, walked).miou_walked for m, room in results]
    cells = [
        f"{score:.3f}, {len(np.unique(room[room != NO_ROOM]))}, {cost:.1f}"
        for score, (_, room), cost in zip(scored, results, seconds, strict=True)
    ]
    return cells, scored, len(walked)


def _from_viewpoints(fused: TopometricMap) -> NDArray[np.int32]:
    """Divide fused geometry by what is seen from all agents' viewpoints (§4.2.7, §4.2.8)."""
    grid = VoxelGrid(fused.voxels, np.array(fused.origin), fused.voxel_size)
    views = load_config("thesis").extraction.views
    eyes = fused.viewpoints.astype(np.float64)
    return segment(grid, fused.navigable, eyes, views)


def _scores(
    m: TopometricMap,
    room: NDArray[np.int32],
    tree: cKDTree,
    rooms: NDArray[np.int32],
    walked: Sequence[int],
) -> RoomScores:
    centres = apply(inverse(m.T_level_input), m.centres())
    distance, nearest = tree.query(centres, distance_upper_bound=REACH * m.voxel_size)
    true = np.full(len(centres), -1, np.int32)
    near = np.isfinite(distance)
    true[near] = rooms[nearest[near]]
    return room_scores(room_overlap(true, room), walked)


if __name__ == "__main__":
    main()
