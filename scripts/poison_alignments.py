#!/usr/bin/env python3
"""Poison alignments of a fleet in one building and see whether they are found.

    poison_alignments.py [BUILDING] [--agents 10] [--poison 3] [--seed 0]

Simulates the agents, extracts and merges their maps, then turns, shifts or lifts some of the
accepted alignments, makes them the most confident of all, and forms the groups again. Prints one
line for the untouched fleet and one for the poisoned.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from topometric_ros.alignment import Alignment, AlignmentStatus, MergeResult
from topometric_ros.fusion.merge import merge
from topometric_ros.fusion.poses import apart, yaw_pose
from topometric_ros.runtime.config import load_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.cases import Case, SimulationConfig, simulate
from topometric_ros.topometric_map import TopometricMap

POISON = (
    yaw_pose(np.pi, (0.0, 0.0, 0.0)),
    yaw_pose(0.0, (3.0, 0.0, 0.0)),
    yaw_pose(0.0, (0.0, 0.0, 3.0)),
)
"""A half turn, a shift along a corridor, another storey."""


def main() -> None:
    """Print both lines."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("building", nargs="?", default="office:seed=3,rooms=30,corridor=ring")
    parser.add_argument("--agents", type=int, default=10)
    parser.add_argument("--poison", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    wanted = SimulationConfig(agents=args.agents, overlap=0.5)
    case = simulate(load_building(args.building), wanted, args.seed)
    config = load_config("default")
    maps = [
        extract_map(agent.points, config.extraction, config.merge.matching, agent=agent.id).map
        for agent in case.agents
    ]
    clean = merge(maps, config.merge)
    print(
        "| fleet | pairs | accepted | poisoned | found | wrongly withdrawn | agents placed | off |"
    )
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    _print("as merged", clean, (), case, maps)
    accepted = [k for k, x in enumerate(clean.alignments) if x.accepted]
    drawn = np.random.default_rng(args.seed).choice(accepted, args.poison, replace=False)
    alignments = list(clean.alignments)
    for number, k in enumerate(sorted(drawn.tolist())):
        T = alignments[k].T_a_b @ POISON[number % len(POISON)]
        alignments[k] = replace(alignments[k], T_a_b=T, confidence=0.99)
    poisoned = [alignments[k].agents for k in drawn]
    known: Mapping[tuple[str, str], Alignment] = {x.agents: x for x in alignments}
    _print("poisoned", merge(maps, config.merge, known=known), poisoned, case, maps)


def _print(
    name: str,
    result: MergeResult,
    poisoned: Sequence[tuple[str, str]],
    case: Case,
    maps: Sequence[TopometricMap],
) -> None:
    """Print one line; "off" is the largest mean displacement of an agent's voxels."""
    withdrawn = {x.agents for x in result.alignments if x.status is AlignmentStatus.WITHDRAWN}
    off = []
    for k, (place, m) in enumerate(zip(result.agents, maps, strict=True)):
        if place.T_global_agent is not None:
            T_input_level = np.linalg.inv(m.T_level_input)
            points = m.centres() @ T_input_level[:3, :3].T + T_input_level[:3, 3]
            off.append(apart(place.T_global_agent, case.T_a_b(0, k), points))
    print(
        f"| {name} | {len(result.alignments)} | {sum(x.accepted for x in result.alignments)} "
        f"| {len(poisoned)} | {len(withdrawn & set(poisoned))} | {len(withdrawn - set(poisoned))} "
        f"| {len(off)} of {len(maps)} | {100 * max(off):.1f} cm |"
    )


if __name__ == "__main__":
    main()
