#!/usr/bin/env python3
"""Measure false merges on pairs of maps that must not be merged, by kind of look-alike.

    measure_negatives.py OUT [--seeds 0 100] [--corpus DIR ...] [--pairs DIR ...] [--limit N]

Buildings are made in variants: the same rooms with other furniture (an identical flat or storey, or
another day), mirrored, both, bare; further ones have wings, identical storeys with stairs between,
or rows of one room; --seeds makes more of each. Agents walk each; maps are extracted once and kept
in OUT/maps. --corpus adds the maps of `measure_merging.py` (its OUT/maps), --pairs the clouds of
pairs with truth (`topometric benchmark` keeps them): pairs of one building that share nothing, and
pairs of different buildings, --others in all. Each pair is merged end to end, kinds in turn, in an
order drawn by chance; what OUT/pairs.jsonl holds is not merged again, so a run can be broken off,
and --limit ends one. Prints a Markdown table. An answer is wrong where a pose is accepted that is
not the true one; pairs of variants have none.
"""

from __future__ import annotations

import argparse
import itertools
import json
import random
from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from look_alikes import Place, building_cells, corpus, made_places, of_pairs, shared_cells
from measure_merging import RIGHT, Row, Saved, measure_pair

from topometric_ros.evaluation.metrics_fusion import NO_OVERLAP, upper_bound
from topometric_ros.runtime.config import ToolConfig, load_config

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


_AT_ONCE = 60
"""Pairs drawn together, merged by name so that a map is prepared once for them."""


def main() -> None:
    """Make the maps where they are missing, merge what was not merged yet, print."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--seeds", type=int, nargs="*", default=[0], help="added to each seed")
    parser.add_argument("--corpus", type=Path, nargs="*", default=[])
    parser.add_argument("--pairs", type=Path, nargs="*", default=[], help="folders of pairs")
    parser.add_argument("--others", type=int, default=800, help="pairs of different buildings")
    parser.add_argument("--limit", type=int, default=None, help="pairs in all")
    args = parser.parse_args()
    config = load_config("default")
    folder = args.out / "maps"
    made = [p for k in args.seeds for places in made_places(folder, config, k) for p in places]
    real = [Place(saved, "") for walks in args.corpus for saved in corpus(walks)]
    real += [Place(saved, "") for saved in of_pairs(args.pairs, folder, config)]
    pairs = [*_made_pairs(made), *_real_pairs(real), *_crossed(made + real, args.others)]
    rows = _merged(_in_turn(pairs)[: args.limit], args.out / "pairs.jsonl", config)
    _print(rows)


def _in_turn(pairs: Sequence[tuple[str, Saved, Saved]]) -> list[tuple[str, Saved, Saved]]:
    """Return the pairs drawn by chance, of each kind one at a time."""
    kinds: dict[str, list[tuple[str, Saved, Saved]]] = {}
    for pair in random.Random(1).sample(list(pairs), len(pairs)):
        kinds.setdefault(pair[0], []).append(pair)
    turns = itertools.zip_longest(*(kinds[kind] for kind in sorted(kinds)))
    return [pair for turn in turns for pair in turn if pair is not None]


def _merged(pairs: Sequence[tuple[str, Saved, Saved]], file: Path, config: ToolConfig) -> list[Row]:
    """Return the rows of the pairs; those that the file lacks are merged and added to it."""
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    known = {(row.a, row.b): row for row in (Row(**json.loads(line)) for line in lines)}
    for start in range(0, len(pairs), _AT_ONCE):
        some = sorted(
            pairs[start : start + _AT_ONCE], key=lambda pair: (pair[1].name, pair[2].name)
        )
        for kind, a, b in some:
            if (a.name, b.name) in known:
                continue
            row = measure_pair(a, b, kind, config)
            row = row if kind in KINDS[3:7] else replace(row, overlap=0.0)
            known[a.name, b.name] = row
            with file.open("a", encoding="utf-8") as stream:
                stream.write(json.dumps(vars(row)) + "\n")
    return [known[a.name, b.name] for _, a, b in pairs]


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


def _real_pairs(places: Sequence[Place]) -> Iterable[tuple[str, Saved, Saved]]:
    """Yield the pairs of maps of one building that share nothing."""
    cells = {place.saved.name: building_cells(place.saved) for place in places}
    for a, b in itertools.combinations([place.saved for place in places], 2):
        if a.building == b.building and shared_cells(cells[a.name], cells[b.name]) < NO_OVERLAP:
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
