#!/usr/bin/env python3
"""Measure false merges on pairs of maps that must not be merged, by kind of look-alike.

    measure_negatives.py OUT [--corpus DIR ...] [--others 800]

Buildings are made in variants: the same rooms with other furniture (an identical flat or storey, or
another day), mirrored, both, bare; further ones have wings, identical storeys with stairs between,
or rows of one room. Agents walk each; maps are extracted once and kept in OUT/maps. --corpus adds
the maps of `measure_merging.py` (its OUT/maps): their pairs of one building that share nothing, and
pairs of different buildings, --others in all. Prints a Markdown table and writes OUT/pairs.json.
An answer is wrong where a pose is accepted that is not the true one; pairs of variants have none.
"""

from __future__ import annotations

import argparse
import itertools
import json
import random
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from measure_merging import RIGHT, Row, Saved, measure_pair, prepare_map, shared_part, write_maps

from topometric_ros.evaluation.metrics_fusion import NO_OVERLAP, upper_bound
from topometric_ros.fusion.poses import inverse
from topometric_ros.runtime.config import ToolConfig, load_config
from topometric_ros.simulation import cases
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.cases import SimulationConfig, Walk
from topometric_ros.simulation.labelled import LabelledBuilding

BASES = (
    "office:seed=41,rooms=9",
    "hospital:seed=42,rooms=8",
    "home:seed=43,rooms=7",
    "office:seed=44,rooms=10,alike=0.6",
    "hospital:seed=45,rooms=9,corridor=L",
    "home:seed=46,rooms=8,twins=2",
)
VARIANTS = {
    "plain": "furnished=1",
    "other furniture": "furnished=2",
    "mirrored": "furnished=1,mirrored=true",
    "bare": "furnished=1,furniture=0",
}
WINGS = ("office:seed=51,rooms=16,wings=2", "hospital:seed=52,rooms=15,wings=2")
STOREYS = (
    "office:seed=61,rooms=16,storeys=2,stacked=true,furnished=1",
    "hospital:seed=62,rooms=14,storeys=2,stacked=true,furnished=1",
)
ROWS = (
    "hospital:seed=71,rooms=18,alike=1,furnished=1",
    "office:seed=72,rooms=18,alike=1,furnished=1",
)
ROOMS_WALKED = 7
KINDS = (
    "identical rooms, other furniture",
    "mirrored",
    "identical rooms, one side bare",
    "identical storeys, stairs between",
    "another wing",
    "rows of one room, nothing in common",
    "same real building, nothing in common",
    "different buildings",
    "identical rooms, both bare",
)
"""Rows of the table; of the last two maps hold the same, so nothing could tell the places apart."""


@dataclass(frozen=True)
class Place:
    """A map and where it stands for: `part` names a variant, a wing or a storey of `saved`."""

    saved: Saved
    part: str


def main() -> None:
    """Make the maps where they are missing, merge, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--corpus", type=Path, nargs="*", default=[])
    parser.add_argument("--others", type=int, default=800, help="pairs of different buildings")
    args = parser.parse_args()
    config = load_config("default")
    folder = args.out / "maps"
    made = [place for places in _all_places(folder, config) for place in places]
    real = [Place(saved, "") for walks in args.corpus for saved in corpus(walks)]
    pairs = [*_made_pairs(made), *_real_pairs(real, config), *_crossed(made + real, args.others)]
    rows = []
    for kind, a, b in pairs:
        row = measure_pair(a, b, kind, config)
        rows.append(row if kind in KINDS[3:7] else replace(row, overlap=0.0))
    text = json.dumps([vars(row) for row in rows], indent=1)
    (args.out / "pairs.json").write_text(text + "\n", encoding="utf-8")
    _print(rows)


def _all_places(folder: Path, config: ToolConfig) -> Iterable[list[Place]]:
    for base, (part, options) in itertools.product(BASES, VARIANTS.items()):
        yield _walked(f"{base},{options}", base, folder, config, {part: ()})
    for spec in WINGS:
        yield _walked(spec, spec, folder, config, _wings(load_building(spec)))
    for spec in STOREYS:
        yield _walked(spec, spec, folder, config, _storeys(load_building(spec)))
    for spec in ROWS:
        yield _walked(spec, spec, folder, config, {"row": ()}, overlap=0.0)


def _walked(
    spec: str,
    building: str,
    folder: Path,
    config: ToolConfig,
    parts: dict[str, tuple[int, ...]],
    overlap: float = 0.5,
) -> list[Place]:
    """Return the maps of two agents in each part; a part without rooms is walked at will."""
    places = []
    for number, (part, rooms) in enumerate(parts.items()):
        target = folder / f"{spec}__{part.replace(' ', '_')}"
        if not (target / "truth.json").is_file():
            simulation = SimulationConfig(overlap=overlap, visits=0 if rooms else ROOMS_WALKED)
            ready = cases.prepare(load_building(spec), simulation)
            walks = [Walk(rooms), Walk(rooms[::-1])] if rooms else []
            write_maps(ready, 7 + number, target, config, walks)
        truth = json.loads((target / "truth.json").read_text(encoding="utf-8"))
        for agent, T in sorted(truth.items()):
            saved = Saved(f"{target.name}/{agent}", building, False, np.array(T), folder)
            places.append(Place(saved, part))
    return places


def _wings(building: LabelledBuilding) -> dict[str, tuple[int, ...]]:
    """Return the rooms of each part of a building that its lobbies join."""
    lobbies = {room.id for room in building.rooms if room.kind == "lobby"}
    part = list(range(len(building.rooms)))
    for link in [link for link in building.links if not lobbies & set(link.rooms)] * len(part):
        part[link.rooms[0]] = part[link.rooms[1]] = min(part[r] for r in link.rooms)
    rooms = [r for r in range(len(part)) if r not in lobbies]
    groups = [tuple(r for r in rooms if part[r] == p) for p in sorted({part[r] for r in rooms})]
    return {f"wing {k}": group[:ROOMS_WALKED] for k, group in enumerate(groups)}


def _storeys(building: LabelledBuilding) -> dict[str, tuple[int, ...]]:
    """Return the first rooms of each storey, the corridor and the stairs among them."""
    return {
        f"storey {storey}": tuple(r.id for r in building.rooms if r.storey == storey)[:ROOMS_WALKED]
        for storey in sorted({room.storey for room in building.rooms})
    }


def corpus(folder: Path) -> list[Saved]:
    """Return the maps that `measure_merging.py` wrote."""
    saved = []
    for path in sorted(folder.glob("*/truth.json")):
        walk = path.parent.name
        for agent, T in sorted(json.loads(path.read_text(encoding="utf-8")).items()):
            noisy = "_noisy" in walk
            saved.append(Saved(f"{walk}/{agent}", walk.split("__")[0], noisy, np.array(T), folder))
    return saved


def _made_pairs(places: Sequence[Place]) -> Iterable[tuple[str, Saved, Saved]]:
    for a, b in itertools.combinations(places, 2):
        kind = _kind(a.part, b.part) if a.saved.building == b.saved.building else None
        if kind is not None:
            yield kind, a.saved, b.saved


def _kind(one: str, other: str) -> str | None:
    """Return what a pair of parts of one building is called; None where they share rooms."""
    parts = {one, other}
    if parts == {"bare"}:
        return KINDS[8]
    if parts == {"row"}:
        return KINDS[5]
    if len(parts) == 1:
        return None
    if one.startswith("wing"):
        return KINDS[4]
    if one.startswith("storey"):
        return KINDS[3]
    if "mirrored" in parts:
        return KINDS[1]
    return KINDS[2] if "bare" in parts else KINDS[0]


def _real_pairs(places: Sequence[Place], config: ToolConfig) -> Iterable[tuple[str, Saved, Saved]]:
    """Yield the pairs of maps of one building that share nothing."""
    for a, b in itertools.combinations([place.saved for place in places], 2):
        if a.building == b.building:
            T_true = a.T_agent_building @ inverse(b.T_agent_building)
            overlap = shared_part(prepare_map(a, config), prepare_map(b, config), T_true)
            if overlap < NO_OVERLAP:
                yield KINDS[6], a, b


def _crossed(places: Sequence[Place], count: int) -> list[tuple[str, Saved, Saved]]:
    maps = [place.saved for place in places]
    crossed = [(a, b) for a, b in itertools.combinations(maps, 2) if a.building != b.building]
    chosen = random.Random(0).sample(crossed, min(count, len(crossed)))
    chosen.sort(key=lambda pair: (pair[0].name, pair[1].name))
    return [(KINDS[7], a, b) for a, b in chosen]


def _print(rows: Sequence[Row]) -> None:
    print("| pairs | N | none or rejected | ambiguous | true pose accepted | wrong |")
    print("|---|---:|---:|---:|---:|---:|")
    for kind in KINDS:
        _line(kind, [row for row in rows if row.kind == kind])
    _line("all but the last", [row for row in rows if row.kind != KINDS[8]])
    print(f"\nCPU a pair: median {np.median([row.cpu for row in rows]):.1f} s")
    for row in rows:
        if _wrong(row):
            print(f"wrong: {row.kind}: {row.a} {row.b}: {row.reason}")


def _line(name: str, rows: Sequence[Row]) -> None:
    if not rows:
        return
    n, wrong = len(rows), sum(map(_wrong, rows))
    found = sum(row.error is not None and not _wrong(row) for row in rows)
    unsure = sum(row.status == "ambiguous" for row in rows)
    bound = f"{wrong} (below {upper_bound(wrong, n):.1%})"
    print(f"| {name} | {n} | {n - found - wrong - unsure} | {unsure} | {found} | {bound} |")


def _wrong(row: Row) -> bool:
    """Whether a pose was accepted that is not true: between variants none is."""
    if row.error is None:
        return False
    variants = row.kind in (*KINDS[:3], KINDS[8])
    return variants or row.error[0] >= RIGHT[0] or row.error[1] >= RIGHT[1]


if __name__ == "__main__":
    main()
