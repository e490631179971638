#!/usr/bin/env python3
"""Measure merging on many simulated pairs: right, strictly right and false merges by overlap.

    measure_merging.py OUT [--data ../shared/data] [--seeds 2] [--crossed 300] [--made]

Agents walk the BIM models and furnished plans below --data and, with --made, buildings made from a
seed; each map is extracted once and kept in OUT/maps, so that a second run only merges. Merged are
both maps of a walk, maps of other walks in the same building, whether they share anything or not
(where both agents stood is known), and maps of different buildings. Prints Markdown tables and
writes every pair to OUT/pairs.json. "Right" is under 0.5 m of mean displacement and 5 degrees.
The right pose is also looked for among those that were considered (up to five distinct ones), and
the matches of rooms that an accepted alignment tells are compared with those of the true pose.
`--sources rooms` or `search` takes one source of candidates alone; `--pairs FILE` (a pairs.json)
merges the same pairs again.
"""

from __future__ import annotations

import argparse
import itertools
import json
import random
import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import Alignment
from topometric_ros.configuration import with_values
from topometric_ros.errors import TopometricError
from topometric_ros.evaluation.metrics_fusion import (
    LITTLE_OVERLAP,
    NO_OVERLAP,
    RIGHT,
    STRICTLY_RIGHT,
    brier_score,
    upper_bound,
)
from topometric_ros.fusion.align import SAME_ROOM_SHARE, align
from topometric_ros.fusion.overlap import same_rooms, shared_voxels
from topometric_ros.fusion.poses import angle, apart, apply, inverse
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.io.map_files import load_map, save_map
from topometric_ros.runtime.config import ToolConfig, load_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation import cases
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.cases import SimulationConfig
from topometric_ros.simulation.trajectories import OVERLAP_VOXEL

MADE = (
    "office:seed=21,rooms=16",
    "hospital:seed=22,rooms=20,corridor=ring",
    "home:seed=23",
    "office:seed=24,rooms=24,corridor=comb,twins=3",
    "hospital:seed=25,rooms=30,storeys=2",
    "office:seed=26,rooms=20,corridor=L,wings=2",
    "hospital:seed=28,rooms=24,twins=4",
)
NOISY = {
    "sensor.lidar.noise": 0.03,
    "degrade.dropout": 0.3,
    "degrade.drift": 0.002,
    "degrade.moved": 0.2,
}
WALKS = ((0.5, False), (0.2, False), (0.0, False), (0.35, True), (0.12, False), (0.2, True))
"""Wanted overlap of the two agents of a walk, and whether scans are noisy."""
BANDS = ((LITTLE_OVERLAP, 0.2), (0.2, 0.35), (0.35, 0.6), (0.6, 1.01))
MOST_MAPS = 60
"""Prepared maps held at once."""


@dataclass(frozen=True)
class Saved:
    """A map of the corpus: its file, the building, and where its frame lies there."""

    name: str
    building: str
    noisy: bool
    T_agent_building: NDArray[np.float64]
    folder: Path


@dataclass(frozen=True)
class Row:
    """One pair: `overlap` is nan between buildings, `error` (m, degrees) only where accepted."""

    a: str
    b: str
    kind: str
    overlap: float
    noisy: bool
    status: str
    reason: str
    confidence: float
    error: tuple[float, float] | None
    rank: int
    """Of the right pose among those considered, from 1; 0 where it is not among them."""
    rooms: tuple[int, int, int]
    """Matches made, right, and how many right ones there are."""
    cpu: float


def main() -> None:
    """Make the corpus where it is missing, merge, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--data", type=Path, default=Path("../shared/data"))
    parser.add_argument("--seeds", type=int, default=1, help="walks of each sort (default 1)")
    parser.add_argument("--crossed", type=int, default=300, help="pairs of different buildings")
    parser.add_argument("--other-walks", type=int, default=10, help="further pairs of a building")
    parser.add_argument("--made", action="store_true", help="also buildings made from a seed")
    parser.add_argument("--sources", nargs="+", default=[], help="rooms, search (default both)")
    parser.add_argument("--pairs", type=Path, help="a pairs.json: the same pairs again")
    args = parser.parse_args()
    config = load_config("default")
    if args.sources:
        merge = replace(config.merge, sources=tuple(args.sources))
        config = replace(config, merge=merge)
    buildings = [str(p) for p in sorted(args.data.glob("buildings/*.npz"))]
    buildings += [str(p) for p in sorted(args.data.glob("floorplans/*_furnitures.png"))]
    buildings += MADE if args.made else ()
    maps = [m for b in buildings for m in _corpus(b, args.out / "maps", args.seeds, config)]
    pairs = _again(maps, args.pairs) if args.pairs else _pairs(maps, args)
    rows = [measure_pair(*pair, config) for pair in pairs]
    text = json.dumps([vars(row) for row in rows], indent=1)
    name = "_".join(["pairs", *args.sources]) + ".json"
    (args.out / name).write_text(text + "\n", encoding="utf-8")
    _print(rows)


def _corpus(building: str, out: Path, seeds: int, config: ToolConfig) -> list[Saved]:
    """Simulate and extract what is not there yet; return all maps of a building."""
    ready: cases.Prepared | None = None
    saved = []
    for seed, (number, (overlap, noisy)) in itertools.product(range(seeds), enumerate(WALKS)):
        stem = Path(building).stem if "/" in building else building
        folder = out / f"{stem}__{overlap:g}{'_noisy' if noisy else ''}_{seed}"
        if not (folder / "truth.json").is_file():
            settings = {"overlap": overlap, **(NOISY if noisy else {})}
            simulation = with_values(SimulationConfig(), settings)
            ready = ready or cases.prepare(load_building(building), simulation)
            walk = replace(ready, config=simulation)
            write_maps(walk, 100 * seed + number, folder, config)
        truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        for agent, T in sorted(truth.items()):
            saved.append(Saved(f"{folder.name}/{agent}", stem, noisy, np.array(T), out))
    return saved


def write_maps(
    ready: cases.Prepared,
    seed: int,
    folder: Path,
    config: ToolConfig,
    walks: Sequence[cases.Walk] = (),
) -> None:
    """Write the maps of one walk and where their frames lie; nothing where none can be made."""
    folder.mkdir(parents=True, exist_ok=True)
    truth: dict[str, Any] = {}
    try:
        for agent in cases.simulate(ready, ready.config, seed, walks).agents:
            extraction = extract_map(
                agent.points,
                config.extraction,
                config.merge.matching,
                agent=agent.id,
                session=folder.name,
                sequence=1,
            )
            save_map(folder / f"{agent.id}.tmap", extraction.map)
            truth[agent.id] = agent.T_agent_building.tolist()
    except TopometricError as error:
        print(f"{folder.name}: left out: {error}")
        truth = {}
    (folder / "truth.json").write_text(json.dumps(truth) + "\n", encoding="utf-8")


def _pairs(maps: Sequence[Saved], args: argparse.Namespace) -> list[tuple[Saved, Saved, str]]:
    """Return both maps of each walk, some of other walks in the same building, and crossed ones."""
    draw = random.Random(0)
    walks, others, crossed = [], [], []
    for a, b in itertools.combinations(maps, 2):
        if a.name.rpartition("/")[0] == b.name.rpartition("/")[0]:
            walks.append((a, b, "one walk"))
        elif a.building == b.building:
            others.append((a, b, "other walks"))
        else:
            crossed.append((a, b, "other building"))
    chosen = []
    for building in dict.fromkeys(m.building for m in maps):
        own = [pair for pair in others if pair[0].building == building]
        chosen += draw.sample(own, min(len(own), args.other_walks))
    crossed = draw.sample(crossed, min(len(crossed), args.crossed))
    # Neighbours in this order share maps, which are prepared once.
    crossed.sort(key=lambda pair: (pair[0].name, pair[1].name))
    return walks + chosen + crossed


def _again(maps: Sequence[Saved], file: Path) -> list[tuple[Saved, Saved, str]]:
    """Return the pairs that an earlier run wrote."""
    by_name = {saved.name: saved for saved in maps}
    rows = json.loads(file.read_text(encoding="utf-8"))
    return [(by_name[row["a"]], by_name[row["b"]], row["kind"]) for row in rows]


_prepared: dict[str, Prepared] = {}


def prepare_map(saved: Saved, config: ToolConfig) -> Prepared:
    """Return a map of the corpus with what merging needs of it; the last ones are kept."""
    if saved.name not in _prepared:
        if len(_prepared) >= MOST_MAPS:
            _prepared.pop(next(iter(_prepared)))
        ready = load_prepared(saved, config)
        _ = (ready.described, ready.fields, ready.surface, ready.tree)
        _prepared[saved.name] = ready
    return _prepared[saved.name]


def load_prepared(saved: Saved, config: ToolConfig) -> Prepared:
    """Return a map of the corpus; what merging needs of it is made where it is asked for."""
    topometric_map = replace(load_map(saved.folder / f"{saved.name}.tmap"), agent=saved.name)
    return Prepared(topometric_map, config.merge.search.scoring, config.merge.matching)


def measure_pair(a: Saved, b: Saved, kind: str, config: ToolConfig) -> Row:
    """Align one pair and compare with the truth."""
    first, second = prepare_map(a, config), prepare_map(b, config)
    start = time.process_time()
    alignment = align(first, second, config.merge)
    cpu = time.process_time() - start
    overlap, error, rank, rooms = float("nan"), None, 0, (0, 0, 0)
    if a.building == b.building:
        T_true = a.T_agent_building @ inverse(b.T_agent_building)
        overlap = shared_part(first, second, T_true)
        points = apply(inverse(second.map.T_level_input), second.map.centres())
        poses = [alternative.T_a_b for alternative in alignment.alternatives]
        if alignment.accepted and alignment.T_a_b is not None:
            poses = [alignment.T_a_b, *poses]
        errors = [_error(T, T_true, points) for T in poses]
        error = errors[0] if alignment.accepted else None
        rank = next((k for k, e in enumerate(errors, 1) if _near(e, RIGHT)), 0)
        rooms = _matched_rooms(first, second, alignment, T_true, config)
    elif alignment.accepted:
        error = (float("inf"), 180.0)
    status, reason, trust = alignment.status.value, alignment.reason, alignment.confidence
    noisy = a.noisy or b.noisy
    return Row(
        a.name, b.name, kind, overlap, noisy, status, reason, trust, error, rank, rooms, cpu
    )  # fmt: skip


def _error(
    T: NDArray[np.float64], T_true: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[float, float]:
    """Return the mean displacement (m) of b's points and the angle (degrees)."""
    return apart(T, T_true, points), float(np.degrees(angle(inverse(T_true) @ T)))


def _matched_rooms(
    a: Prepared,
    b: Prepared,
    alignment: Alignment,
    T_true: NDArray[np.float64],
    config: ToolConfig,
) -> tuple[int, int, int]:
    """Return the matches told, the right ones among them and all that the true pose gives."""
    T = a.map.T_level_input @ T_true @ inverse(b.map.T_level_input)
    rows_a, rows_b, _ = shared_voxels(a.map, b.map, T)
    true = {
        (a.map.rooms[i].id, b.map.rooms[j].id)
        for i, j in same_rooms(
            a.map, b.map, rows_a, rows_b, SAME_ROOM_SHARE, config.merge.room_part
        )
    }
    made = {(m.room_a, m.room_b) for m in alignment.matches if alignment.accepted}
    return len(made), len(made & true), len(true)


def shared_part(a: Prepared, b: Prepared, T_a_b: NDArray[np.float64]) -> float:
    """Return the part of the smaller map's 0.2 m voxels that both have, both in a's frame."""
    codes = []
    for ready, T in ((a, np.eye(4)), (b, T_a_b)):
        surface = apply(T @ inverse(ready.map.T_level_input), ready.map.surface())
        cells = np.floor(surface / OVERLAP_VOXEL).astype(np.int64)
        codes.append(np.unique(cells @ np.array([1, 1 << 20, 1 << 40])))
    shared = np.intersect1d(codes[0], codes[1])
    return len(shared) / max(1, min(map(len, codes)))


def _print(rows: Sequence[Row]) -> None:
    print("| pairs | N | right | strictly right | ambiguous | wrong | ", end="")
    print("right pose first | among three | room matches F1 |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|---:|")
    for noisy in (False, True):
        for low, high in BANDS:
            some = [r for r in rows if r.noisy == noisy and low <= r.overlap < high]
            _line(f"{'noisy' if noisy else 'clean'}, overlap {low:g} to {min(high, 1):g}", some)
    same = [r for r in rows if r.overlap < NO_OVERLAP]
    _line("same building, nothing in common", same)
    _line("different buildings", [r for r in rows if r.kind == "other building"])
    shared = [r for r in rows if r.overlap >= LITTLE_OVERLAP]
    trust = [r.confidence for r in rows]
    print(f"\nBrier score of the confidence, {len(rows)} pairs: ", end="")
    print(
        f"{brier_score(trust, [_within(r, RIGHT) for r in rows]):.3f}; CPU a pair: median ", end=""
    )
    print(f"{np.median([r.cpu for r in rows]):.1f} s")
    for row in rows:
        if row.error is not None and not _within(row, RIGHT):
            print(f"wrong: {row.a} {row.b}: {row.reason}")
    for row in shared:
        if not _within(row, RIGHT):
            print(f"lost at {row.overlap:.2f}: {row.a} {row.b}: {row.status}: {row.reason}")


def _line(name: str, rows: Sequence[Row]) -> None:
    """Print one row of the table, where there are pairs."""
    if not rows:
        return
    n = len(rows)
    right, strict = (sum(_within(r, limit) for r in rows) for limit in (RIGHT, STRICTLY_RIGHT))
    wrong = sum(r.error is not None and not _within(r, RIGHT) for r in rows)
    unsure = sum(r.status == "ambiguous" for r in rows)
    bound = f"{wrong} (below {upper_bound(wrong, n):.1%})"
    shared = all(r.overlap >= LITTLE_OVERLAP for r in rows)
    found, ranks = "– | –", "– | – | –"
    if shared:
        found = f"{right / n:.0%} | {strict / n:.0%}"
        made, good, all_right = (sum(r.rooms[k] for r in rows) for k in range(3))
        first, three = (sum(1 <= r.rank <= most for r in rows) / n for most in (1, 3))
        ranks = f"{first:.0%} | {three:.0%} | {2 * good / max(1, made + all_right):.2f}"
    print(f"| {name} | {n} | {found} | {unsure} | {bound} | {ranks} |", flush=True)


def _within(row: Row, limits: tuple[float, float]) -> bool:
    return row.error is not None and _near(row.error, limits)


def _near(error: tuple[float, float], limits: tuple[float, float]) -> bool:
    return error[0] < limits[0] and error[1] < limits[1]


if __name__ == "__main__":
    main()
