#!/usr/bin/env python3
"""Compare the ways to register matched rooms, match by match and all at once.

    compare_registration.py PAIRS [PAIRS ...] [--methods icp gicp ...]

PAIRS holds folders of pairs with truth as `topometric simulate` writes them; pairs that share less
than a tenth are left out. Each cloud is extracted once under preset default. Two sets of matches
are registered, from the transform of their centroids: those of the best grown hypothesis (thesis
§4.3.6), many of which are wrong, and the right ones (§5.3). Prints Markdown tables: how often a
single match's transform is right, the mean of the largest cluster, and what registering all its
rooms at once makes of it; then the precision of the grown matches, before and after those that
registered badly or stand apart are rejected (§6.5). CPU seconds are a pair's.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # CPU seconds are of one thread.

import argparse
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from topometric_ros.alignment import RoomMatch
from topometric_ros.errors import ConfigurationError
from topometric_ros.evaluation.case import pair_folders
from topometric_ros.evaluation.metrics_fusion import (
    LITTLE_OVERLAP,
    RIGHT,
    STRICTLY_RIGHT,
    TransformError,
    transform_error,
)
from topometric_ros.evaluation.metrics_matching import right_by_counterpart
from topometric_ros.evaluation.score_pair import ScoredAgent, scored_agent
from topometric_ros.fusion.consensus import ConsensusConfig, consensus, register_jointly
from topometric_ros.fusion.poses import Transform, inverse, level_frames
from topometric_ros.fusion.registration import METHODS, RegistrationError
from topometric_ros.fusion.surface import Surface, surface_of
from topometric_ros.matching.hypotheses import register_positions
from topometric_ros.matching.propose import propose_from_rooms
from topometric_ros.runtime.config import load_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation.case_files import read_case

SMALLEST = 50
"""Voxels below which two rooms of a right match share too little to be registered."""


@dataclass
class Pair:
    """Two maps, the true transform of their level frames, and two sets of matches with a pose."""

    name: str
    a: ScoredAgent
    b: ScoredAgent
    T_true: Transform
    right: set[tuple[int, int]]
    surfaces: tuple[Surface, Surface]
    sets: dict[str, tuple[Transform, tuple[RoomMatch, ...]]]


@dataclass
class Row:
    """What a method made of all pairs: errors of single matches, of means and of joint ones."""

    single: list[TransformError | None] = field(default_factory=list)
    mean: list[TransformError] = field(default_factory=list)
    joint: list[TransformError] = field(default_factory=list)
    kept: int = 0
    kept_right: int = 0
    seconds: list[tuple[float, float]] = field(default_factory=list)


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("pairs", type=Path, nargs="+")
    parser.add_argument("--methods", nargs="+", choices=METHODS, default=METHODS)
    args = parser.parse_args()
    pairs = [pair for root in args.pairs for pair in _load(root)]
    print(f"{len(pairs)} pairs")
    for kind in ("right", "grown"):
        made = [(m.room_a, m.room_b) in p.right for p in pairs for m in p.sets[kind][1]]
        print(f"\n{kind} matches: {len(made)}, {sum(made)} of them right\n")
        print(
            "| method | single match right | mean: right, strictly, median | joint: right, "
            "strictly, median | right matches, of those kept | CPU s single, joint |"
        )
        print("|---|---:|---|---|---:|---|")
        for method in args.methods:
            try:
                print(_line(method, _measured(pairs, kind, method), len(pairs)), flush=True)
            except ConfigurationError as error:
                print(f"| {method} | {error} | | | | |")


def _load(root: Path) -> list[Pair]:
    """Extract the clouds of all pairs that overlap, and match their rooms."""
    config = load_config("default")
    pairs = []
    for folder in pair_folders(root):
        case = read_case(folder)
        if case.overlap[0] < LITTLE_OVERLAP:
            continue
        a, b = (
            scored_agent(
                agent,
                extract_map(
                    agent.points, config.extraction, config.merge.matching, agent=agent.id
                ).map,
            )
            for agent in case.agents
        )
        T_input = a.agent.T_agent_building @ inverse(b.agent.T_agent_building)
        T_true = level_frames(T_input, a.map.T_level_input, b.map.T_level_input)
        right = right_by_counterpart(a.overlap, b.overlap)
        best = propose_from_rooms(a.map, b.map, config.merge.matching)[:1]
        sets = {"right": _from_centroids(a, b, sorted(right))}
        sets["grown"] = (best[0].T_a_b, best[0].matches) if best else (np.eye(4), ())
        surfaces = surface_of(a.map), surface_of(b.map)
        pairs.append(Pair(folder.name, a, b, T_true, right, surfaces, sets))
    return pairs


def _from_centroids(
    a: ScoredAgent, b: ScoredAgent, rooms: Sequence[tuple[int, int]]
) -> tuple[Transform, tuple[RoomMatch, ...]]:
    """Return matches with the transform of their rooms' centroids; shreds are left out."""
    rooms = [
        (i, j)
        for i, j in rooms
        if min(a.map.room_by_id(i).voxels, b.map.room_by_id(j).voxels) >= SMALLEST
    ]
    if not rooms:
        return np.eye(4), ()
    target = np.array([a.map.room_by_id(i).centroid for i, _ in rooms])
    source = np.array([b.map.room_by_id(j).centroid for _, j in rooms])
    return register_positions(target, source)[0], tuple(RoomMatch(i, j, 0.0) for i, j in rooms)


def _measured(pairs: Sequence[Pair], kind: str, method: str) -> Row:
    base = ConsensusConfig(joint=False)
    config = replace(base, registration=replace(base.registration, method=method))
    row = Row()
    for pair in pairs:
        T_init, matches = pair.sets[kind]
        maps = (pair.a.map, pair.b.map, *pair.surfaces)
        start = time.process_time()
        try:
            found = consensus(*maps, T_init, matches, config)
            between = time.process_time()
            T = register_jointly(*maps, found.T_a_b, found.kept, config)
        except RegistrationError:
            row.single += [None] * len(matches)
            continue
        row.seconds.append((between - start, time.process_time() - between))
        row.mean.append(_error(pair, found.T_a_b))
        row.joint.append(_error(pair, T))
        row.single += [_single(pair, found.transforms.get(match), match) for match in matches]
        row.kept += len(found.kept)
        row.kept_right += sum((match.room_a, match.room_b) in pair.right for match in found.kept)
    return row


def _single(pair: Pair, T: Transform | None, match: RoomMatch) -> TransformError | None:
    """Return the error of one match's transform, read on the room itself."""
    if T is None:
        return None
    return transform_error(T, pair.T_true, pair.surfaces[1].points[pair.b.map.room == match.room_b])


def _error(pair: Pair, T: Transform) -> TransformError:
    return transform_error(T, pair.T_true, pair.surfaces[1].points[::97])


def _line(method: str, row: Row, pairs: int) -> str:
    right = sum(e is not None and e.within(RIGHT) for e in row.single)
    cells = [method, f"{right}/{len(row.single)}"]
    for errors in (row.mean, row.joint):
        good = [e for e in errors if e.within(RIGHT)]
        strict = sum(e.within(STRICTLY_RIGHT) for e in good)
        middle = f"{100 * np.median([e.displacement for e in good]):.1f} cm" if good else "–"
        cells.append(f"{len(good)}/{pairs}, {strict}/{pairs}, {middle}")
    first, more = np.median(np.array(row.seconds), axis=0)
    cells += [f"{row.kept_right}/{row.kept}", f"{first:.2f}, {more:.2f}"]
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
