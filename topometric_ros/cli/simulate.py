"""`topometric simulate`: partial maps of a building with full truth, as folders of pairs."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topometric_ros.cli.common import (
    add_output,
    add_verbose,
    finish_progress,
    output_folder,
    progress_of,
    report,
    warning_lines,
)
from topometric_ros.configuration import with_values
from topometric_ros.errors import TopometricError

if TYPE_CHECKING:
    from topometric_ros.simulation.cases import SimulationConfig
    from topometric_ros.simulation.labelled import LabelledBuilding

BAGS = ("scans", "maps")


class SimulateArgumentError(TopometricError):
    """Arguments that do not go together."""


def add_parser(commands: Any) -> None:
    """Add this command to the parser."""
    command = commands.add_parser(
        "simulate",
        help="make agents' maps of a building, with the truth",
        description="Write OUT/NAME_SEED/ with a.ply, b.ply, truth.json, truth.npz and, where "
        "asked for, bag/, for each case; an earlier case of that name is replaced. The same "
        "arguments give the same bytes.",
    )
    command.add_argument(
        "building",
        metavar="BUILDING",
        help="office:seed=3,rooms=20 and the like, or a file or folder: see docs/simulation.md",
    )
    add_output(command, required=False)
    command.add_argument(
        "--propose-graph",
        type=Path,
        metavar="FILE",
        help="write which rooms are joined, as found without a sidecar file, to correct by hand; "
        "without -o nothing else is done",
    )
    command.add_argument(
        "--agents",
        type=int,
        metavar="N",
        help="number of agents (default: as many as there are walks by hand, else 2)",
    )
    command.add_argument(
        "--overlap",
        type=float,
        metavar="SHARE",
        help="wanted part of the smaller map's voxels that agents share, 0 to 1 (default 0.5)",
    )
    command.add_argument("--seed", type=int, default=0, help="of the first case (default 0)")
    command.add_argument(
        "--count", type=int, default=1, metavar="N", help="cases, with seeds from SEED on"
    )
    command.add_argument("--config", type=Path, metavar="F", help="YAML file of parameters")
    command.add_argument(
        "--walk",
        action="append",
        default=[],
        metavar="W",
        help="an agent's walk by hand, once for each: room ids (0,4,7), or waypoints in metres "
        "(1.5 2 0; 4 2 0)",
    )
    command.add_argument(
        "--bag", choices=BAGS, default="", help="write a bag too: single scans, or growing maps"
    )
    command.add_argument("--json", action="store_true", help="print the result on stdout as JSON")
    add_verbose(command)
    command.set_defaults(command=simulate)


def simulate(options: argparse.Namespace) -> int:
    """Propose a graph, or simulate and write all cases, or both."""
    if options.output is None and options.propose_graph is None:
        raise SimulateArgumentError("expected -o OUT, or --propose-graph FILE")
    if options.propose_graph is not None:
        _propose_graph(options)
    return 0 if options.output is None else _simulate_cases(options)


def _propose_graph(options: argparse.Namespace) -> None:
    """Write a building's links; a file that may have been corrected is left as it is."""
    from topometric_ros.simulation.buildings import load_building
    from topometric_ros.simulation.sidecars import write_graph

    if options.propose_graph.exists():
        raise SimulateArgumentError(f"{options.propose_graph}: is there already; remove it first")
    progress_of(options)(f"reading {options.building}")
    building = load_building(options.building, sidecars=False)
    write_graph(building, options.propose_graph)
    finish_progress(options)
    if not (options.json and options.output):
        rooms, links = len(building.rooms), len(building.links)
        lines = [f"{options.propose_graph}: {links} links of {rooms} rooms, to correct by hand"]
        report(options, {"rooms": rooms, "links": links}, lines)


def _simulate_cases(options: argparse.Namespace) -> int:
    from topometric_ros.simulation import cases
    from topometric_ros.simulation.buildings import load_building
    from topometric_ros.simulation.simulation_config import parse_walk

    for name, least in (("seed", 0), ("count", 1)):
        if getattr(options, name) < least:
            given = getattr(options, name)
            raise SimulateArgumentError(f"--{name}: expected at least {least}, got {given}")
    walks = [parse_walk(text) for text in options.walk]
    progress = progress_of(options)
    progress(f"reading {options.building}")
    building = load_building(options.building)
    config = _config(options, len(walks), len(building.trajectories))
    ready = cases.prepare(building, config)
    folder = output_folder(options)
    rows = []
    for seed in range(options.seed, options.seed + options.count):
        progress(f"case {seed - options.seed + 1} of {options.count}")
        case = cases.simulate(ready, config, seed, walks)
        name = f"{re.sub(r'[^A-Za-z0-9.-]+', '_', building.name)}_{seed}"
        cases.write_case(case, folder / name, options.bag)
        rows.append(_row(name, case))
    finish_progress(options)
    warnings = _warnings(options, building, config)
    lines = [*map(_line, rows), *warning_lines(warnings), f"written to {folder}"]
    report(options, {"cases": rows, "warnings": warnings}, lines)
    return 0


def _config(options: argparse.Namespace, given: int, beside: int) -> SimulationConfig:
    """Return the parameters; walks given, else those beside the building, make the agents."""
    from topometric_ros.simulation.cases import SimulationConfig
    from topometric_ros.simulation.simulation_config import load_simulation_config

    usual = SimulationConfig()
    if beside and not given:
        # Not the last word, as walks given are: the file of parameters may ask for others.
        usual = with_values(usual, {"agents": beside})
    agents = options.agents if options.agents is not None else given or None
    wanted = {"agents": agents, "overlap": options.overlap}
    return load_simulation_config(options.config, wanted, usual)


def _warnings(
    options: argparse.Namespace, building: LabelledBuilding, config: SimulationConfig
) -> list[str]:
    """Return what was asked for and cannot be had."""
    from topometric_ros.simulation.degrade import furniture_pieces

    warnings = []
    if options.overlap is not None and (options.walk or building.trajectories):
        warnings.append("overlap: not sought, as the agents walk as they were told")
    if config.degrade.moved > 0.0 and not furniture_pieces(building):
        warnings.append(f"degrade.moved: {building.name} has no furniture that could be moved")
    return warnings


def _row(name: str, case: Any) -> dict[str, Any]:
    return {
        "name": name,
        "pairs": [[case.agents[k].id for k in pair] for pair in case.pairs()],
        "overlap": [round(float(value), 4) for value in case.overlap],
        "points": {agent.id: len(agent.points) for agent in case.agents},
        "rooms": {agent.id: list(agent.rooms_walked) for agent in case.agents},
    }


def _line(row: dict[str, Any]) -> str:
    shares = [f"{100 * value:.0f} %" for value in row["overlap"]]
    if len(shares) > 1:
        names = ("–".join(pair) for pair in row["pairs"])
        shares = [f"{name} {share}" for name, share in zip(names, shares, strict=True)]
    overlap = ", ".join(shares) or "none"
    agents = ", ".join(
        f"{key}: {count:,} points in {len(row['rooms'][key])} rooms"
        for key, count in row["points"].items()
    )
    return f"{row['name']}: overlap {overlap}; {agents}"
