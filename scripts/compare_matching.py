#!/usr/bin/env python3
"""Compare what describes rooms, how their neighbourhood enters, and growing hypotheses or not.

    compare_matching.py PAIRS [PAIRS ...]

PAIRS holds folders of pairs with truth (a.ply, b.ply, truth.json, truth.npz) as `topometric
simulate` writes them; pairs that share less than a tenth are left out. Each cloud is extracted once
under preset default. Prints Markdown tables: precision / recall / F1 of the matches made by the
descriptors alone (thesis eq. 52) and by the best grown hypothesis (§4.3.6), all pairs together; a
match is right by the thesis' rule (§5.3). Distances are standardised, with one row for the learned
one; parameters are swept by `sweep_matching.py`.
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.evaluation.case import pair_folders
from topometric_ros.evaluation.metrics_fusion import LITTLE_OVERLAP
from topometric_ros.evaluation.metrics_matching import (
    MatchCounts,
    match_counts,
    right_by_counterpart,
)
from topometric_ros.evaluation.score_pair import ScoredAgent, matches_by_stage, scored_agent
from topometric_ros.matching.config import (
    ContextConfig,
    DescriptorConfig,
    MatchingConfig,
)
from topometric_ros.matching.descriptors import describe
from topometric_ros.runtime.config import load_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation.case_files import read_case

DESCRIPTORS = {
    "engineered": ("engineered",),
    "spectral": ("spectral",),
    "shape": ("shape",),
    "learned": ("learned",),
    "engineered + spectral": ("engineered", "spectral"),
    "engineered + spectral + shape": ("engineered", "spectral", "shape"),
    "shape + learned": ("shape", "learned"),
    "topology alone": ("topological",),
    "all four": ("engineered", "spectral", "shape", "topological"),
}
CONTEXTS = {
    "none": ContextConfig(),
    "one step": ContextConfig("convolution", steps=1),
    "two steps": ContextConfig("convolution", steps=2),
    "merged": ContextConfig("merged"),
}
QUICK = MatchingConfig(descriptors=DescriptorConfig(names=("topological",)))
"""What a cloud is extracted with: it is described anew with everything that is compared."""

LEARNED = ("learned",) if importlib.util.find_spec("onnxruntime") else ()
"""The learned descriptor is left out where its extra is not installed."""

SCORED = DescriptorConfig(names=("engineered", "spectral", "shape", "topological", *LEARNED))
NONE = Alignment(("a", "b"), AlignmentStatus.NONE, "")

Pairs = list[tuple[ScoredAgent, ScoredAgent]]


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("pairs", type=Path, nargs="+")
    args = parser.parse_args()
    pairs = [pair for root in args.pairs for pair in _load(root)]
    base = replace(MatchingConfig(), distance="standardised", alone=1e6)
    rows = (
        (f"{name} | {context}", _with(base, names, CONTEXTS[context]))
        for name, names in DESCRIPTORS.items()
        if LEARNED or "learned" not in names
        for context in CONTEXTS
    )
    _print(
        "descriptor | context", [*rows, ("shape, learned distance | none", MatchingConfig())], pairs
    )


def _load(root: Path) -> Pairs:
    """Extract and describe the clouds of all pairs that overlap."""
    config = load_config("default")
    everything = MatchingConfig(descriptors=SCORED, context=CONTEXTS["merged"])
    pairs: Pairs = []
    for folder in pair_folders(root):
        case = read_case(folder)
        if case.overlap[0] < LITTLE_OVERLAP:
            continue
        a, b = (
            scored_agent(
                agent,
                describe(
                    extract_map(agent.points, config.extraction, QUICK, agent=agent.id).map,
                    everything,
                ),
            )
            for agent in case.agents
        )
        pairs.append((a, b))
    return pairs


def _with(base: MatchingConfig, names: tuple[str, ...], context: ContextConfig) -> MatchingConfig:
    return replace(base, descriptors=DescriptorConfig(names=names), context=context)


def _print(head: str, rows: Iterable[tuple[str, MatchingConfig]], pairs: Pairs) -> None:
    print(f"\n{len(pairs)} pairs\n")
    print(f"| {head} | descriptors alone | F1 | grown | F1 |")
    print("|---|---|---|---:|---|---:|")
    for name, config in rows:
        total = {"assigned": MatchCounts(), "grown": MatchCounts()}
        for a, b in pairs:
            right = right_by_counterpart(a.overlap, b.overlap)
            size = len(a.overlap.found_ids), len(b.overlap.found_ids)
            made = matches_by_stage(a.map, b.map, NONE, config)
            for stage in total:
                total[stage] += match_counts(made[stage], right, *size)
        cells = [
            f"{100 * c.precision:.0f} % ({c.right}/{c.made}) / {100 * c.recall:.0f} % | {c.f1:.2f}"
            for c in total.values()
        ]
        print(f"| {name} | {' | '.join(cells)} |", flush=True)


if __name__ == "__main__":
    main()
