#!/usr/bin/env python3
"""Measure what matching of rooms is sensitive to: what was seen, segmentation, voxels, look-alikes.

    sweep_matching.py PAIRS [PAIRS ...] [--tables NAME ...]

PAIRS holds folders of pairs with truth; those that share a tenth are extracted once under preset
default. Prints one table each, precision / recall of the matches by the descriptors alone (thesis
eq. 52), of the best grown hypothesis (§4.3.6) and of the accepted alignment:

- `parameters`: w, t, c_max, Δe_max and the level of the null option, one changed at a time;
- `completeness`: rooms by the part that both agents saw of what either saw of them;
- `segmentation`: a share of b's rooms cut in two across their longer side, matches by overlap;
- `voxels`: b extracted with other voxels than a;
- `look-alikes`: made buildings, a share of whose rooms has the same size and furniture.
"""

from __future__ import annotations

import argparse
import itertools
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from compare_matching import NONE, Pairs

from topometric_ros.configuration import with_values
from topometric_ros.evaluation.case import pair_folders
from topometric_ros.evaluation.metrics_fusion import LITTLE_OVERLAP
from topometric_ros.evaluation.metrics_matching import (
    MatchCounts,
    match_counts,
    one_to_one,
    right_by_counterpart,
    right_by_overlap,
)
from topometric_ros.evaluation.metrics_rooms import counterparts
from topometric_ros.evaluation.score_pair import ScoredAgent, matches_by_stage, scored_agent
from topometric_ros.fusion.align import align
from topometric_ros.fusion.poses import apply, inverse
from topometric_ros.matching.config import ContextConfig, GrowingConfig, MatchingConfig
from topometric_ros.matching.descriptors import describe
from topometric_ros.runtime.config import ToolConfig, load_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation import cases
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.case import Case, SimulatedAgent
from topometric_ros.simulation.case_files import read_case
from topometric_ros.simulation.cases import SimulationConfig
from topometric_ros.simulation.trajectories import OVERLAP_VOXEL
from topometric_ros.topometric_map import TopometricMap

TABLES = ("parameters", "completeness", "segmentation", "voxels", "look-alikes")
STAGES = ("assigned", "grown", "final")
SHARES = (0.0, 0.25, 0.5, 1.0)
VOXELS = (0.05, 0.1, 0.2)
PARTS = (0.0, 0.25, 0.5, 0.75, 1.01)
ALIKE = ("office:seed=81,rooms=14", "hospital:seed=82,rooms=14")
"""Buildings that look-alikes are made in, walked by two agents each."""

CONFIG = load_config("default")
Matches = dict[str, list[tuple[int, int]]]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("pairs", type=Path, nargs="+")
    parser.add_argument("--tables", nargs="+", choices=TABLES, default=TABLES)
    args = parser.parse_args()
    read = [read_case(f) for root in args.pairs for f in pair_folders(root)]
    found = [case for case in read if case.overlap[0] >= LITTLE_OVERLAP]
    pairs = [_scored(case, CONFIG, CONFIG) for case in found]
    if "parameters" in args.tables:
        _head("parameter | value", len(pairs), STAGES[:2])
        for name, matching in _sweeps(MatchingConfig()):
            _line(name, [_counts(a, b, _matches(a, b, matching)) for a, b in pairs], STAGES[:2])
    if "completeness" in args.tables:
        _completeness(pairs)
    if "segmentation" in args.tables:
        _head("rooms of b cut in two", len(pairs))
        for share in SHARES:
            cut = [(a, _cut(b, share)) for a, b in pairs]
            made = [_counts(a, b, _matches(a, b), by_overlap=True) for a, b in cut]
            _line(f"{share:.0%}", made)
    if "voxels" in args.tables:
        _head("voxels of b, of a 0.1 m", len(pairs))
        for size in VOXELS:
            other = replace(CONFIG, extraction=with_values(CONFIG.extraction, {"voxel_size": size}))
            unlike = [_scored(case, CONFIG, other) for case in found]
            _line(f"{size:g} m", [_counts(a, b, _matches(a, b)) for a, b in unlike])
    if "look-alikes" in args.tables:
        _head("rooms alike", len(ALIKE))
        for share in SHARES:
            walked = [_scored(_walked(spec, share), CONFIG, CONFIG) for spec in ALIKE]
            _line(f"{share:.0%}", [_counts(a, b, _matches(a, b)) for a, b in walked])


def _sweeps(base: MatchingConfig) -> Iterable[tuple[str, MatchingConfig]]:
    """Yield one changed parameter at a time."""
    yield "preset default | –", base
    for weight in (0.1, 0.25, 0.5, 1.0):
        for steps in (1, 2, 3):
            context = ContextConfig("convolution", weight, steps)
            yield f"w, t | {weight:g}, {steps}", replace(base, context=context)
    for cost in (0.3, 0.5, 0.7, 1.0, 1.3, 1.6, 2.0, 1e6):
        growing = replace(base.growing, cost_max=cost)
        yield f"c_max | {cost:g}", replace(base, growing=growing)
    for error in (0.1, 0.25, 0.5, 1.0, 2.5):
        growing = replace(base.growing, error_increase_max=error)
        yield f"Δe_max (m) | {error:g}", replace(base, growing=growing)
    for alone in (0.3, 0.4, 0.5, 0.7, 1.0, 1e6):
        yield f"null option | {alone:g}", replace(base, alone=alone)
    yield "distance | standardised, no null", replace(base, distance="standardised", alone=1e6)
    draft = GrowingConfig(cost_max=1e6, error_increase_max=2.5, seeds_per_room=0, passages=False)
    yield "growing | as the draft has it", replace(base, growing=draft)


def _scored(case: Case, of_a: ToolConfig, of_b: ToolConfig) -> tuple[ScoredAgent, ScoredAgent]:
    a, b = (_agent(s, c) for s, c in zip(case.agents, (of_a, of_b), strict=True))
    return a, b


def _agent(agent: SimulatedAgent, config: ToolConfig) -> ScoredAgent:
    m = extract_map(agent.points, config.extraction, config.merge.matching, agent=agent.id).map
    return scored_agent(agent, m)


def _walked(spec: str, alike: float) -> Case:
    return cases.simulate(load_building(f"{spec},alike={alike}"), SimulationConfig(), 3)


def _matches(a: ScoredAgent, b: ScoredAgent, matching: MatchingConfig | None = None) -> Matches:
    """Return the matches by stage; those of the alignment only under preset default itself."""
    alignment = align(a.map, b.map, CONFIG.merge) if matching is None else NONE
    return matches_by_stage(a.map, b.map, alignment, matching or CONFIG.merge.matching)


def _counts(
    a: ScoredAgent, b: ScoredAgent, made: Matches, by_overlap: bool = False
) -> dict[str, MatchCounts]:
    right = (right_by_overlap if by_overlap else right_by_counterpart)(a.overlap, b.overlap)
    size = len(a.overlap.found_ids), len(b.overlap.found_ids)
    return {
        stage: match_counts(matches if by_overlap else one_to_one(matches), right, *size)
        for stage, matches in made.items()
    }


def _completeness(pairs: Pairs) -> None:
    """Print the table of rooms by how much of them both agents saw."""
    _head("part of the room seen by both", len(pairs))
    made = [_matches(a, b) for a, b in pairs]
    for low, high in itertools.pairwise(PARTS):
        rows = []
        for (a, b), matches in zip(pairs, made, strict=True):
            part, true = _parts(a, b), counterparts(a.overlap)
            inside = {i for i, room in true.items() if low <= part.get(room, 0.0) < high}
            right = {(i, j) for i, j in right_by_counterpart(a.overlap, b.overlap) if i in inside}
            rows.append(
                {
                    stage: match_counts(
                        [m for m in one_to_one(some) if m[0] in inside], right, 1, 1
                    )
                    for stage, some in matches.items()
                }
            )
        _line(f"{low:g} to {min(high, 1):g}", rows)


def _parts(a: ScoredAgent, b: ScoredAgent) -> dict[int, float]:
    """Return of each true room the part of the cells of 0.2 m seen by either that both saw."""
    cells = []
    for one in (a, b):
        T = inverse(one.agent.T_agent_building) @ inverse(one.map.T_level_input)
        index = np.floor(apply(T, one.map.surface()) / OVERLAP_VOXEL).astype(np.int64)
        codes = index @ np.array([1, 1 << 20, 1 << 40])
        cells.append({r: set(codes[one.true_room == r].tolist()) for r in one.overlap.true_ids})
    rooms = cells[0].keys() & cells[1].keys()
    return {r: len(cells[0][r] & cells[1][r]) / len(cells[0][r] | cells[1][r]) for r in rooms}


def _cut(agent: ScoredAgent, share: float) -> ScoredAgent:
    """Return the agent's map with a share of its rooms, drawn by chance, in two pieces."""
    m = agent.map
    drawn = np.random.default_rng(5).permutation(len(m.rooms))[: round(share * len(m.rooms))]
    room, rooms, passages = m.room.copy(), list(m.rooms), list(m.passages)
    centres = m.centres()
    for row in sorted(drawn.tolist()):
        old = rooms[row]
        inside = np.flatnonzero(m.room == old.id)
        axis = int(np.ptp(centres[inside, :2], axis=0).argmax())
        middle = float(np.median(centres[inside, axis]))
        new = max(r.id for r in rooms) + 1
        far = inside[centres[inside, axis] > middle]
        if len(far) in (0, len(inside)):
            continue
        room[far] = new
        near = centres[np.setdiff1d(inside, far)].mean(axis=0), centres[far].mean(axis=0)
        rooms[row] = replace(old, centroid=tuple(near[0].tolist()), area=old.area / 2)
        rooms.append(replace(rooms[row], id=new, centroid=tuple(near[1].tolist())))
        for k, passage in enumerate(passages):
            if old.id in passage.rooms and passage.position[axis] > middle:
                first, second = (new if i == old.id else i for i in passage.rooms)
                passages[k] = replace(passage, rooms=(min(first, second), max(first, second)))
        if passages:
            position = tuple(((near[0] + near[1]) / 2).tolist())
            passages.append(replace(passages[0], rooms=(old.id, new), position=position, width=2.0))
    changed = replace(m, room=room, rooms=tuple(rooms), passages=tuple(passages), descriptors=())
    return scored_agent(agent.agent, _described(changed))


def _described(m: TopometricMap) -> TopometricMap:
    return describe(m, CONFIG.merge.matching)


def _head(first: str, pairs: int, stages: Sequence[str] = STAGES) -> None:
    words = {"assigned": "descriptors alone", "grown": "grown", "final": "accepted alignment"}
    print(f"\n{pairs} pairs\n\n| {first} | {' | '.join(f'{words[s]} | F1' for s in stages)} |")
    print("|---" * (1 + first.count("|")) + "|---|---:" * len(stages) + "|", flush=True)


def _line(
    name: str, rows: Iterable[dict[str, MatchCounts]], stages: Sequence[str] = STAGES
) -> None:
    rows = list(rows)
    cells = []
    for stage in stages:
        c = sum((row[stage] for row in rows), MatchCounts())
        told = f"{100 * c.precision:.0f} % ({c.right}/{c.made})" if c.made else "– (0)"
        recall = f"{100 * c.recall:.0f} % of {c.possible}" if c.possible else "–"
        cells.append(f"{told} / {recall} | {c.f1:.2f}")
    print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
