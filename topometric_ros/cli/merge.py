"""`topometric merge`: one global map from the maps or clouds of two or more agents."""

from __future__ import annotations

import argparse
import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topometric_ros.cli.common import (
    add_arguments,
    config_of,
    inputs_of,
    output_folder,
    progress_of,
    report,
    warning_lines,
)
from topometric_ros.errors import TopometricError

if TYPE_CHECKING:
    from topometric_ros.alignment import MergeResult
    from topometric_ros.extraction.quality import Quality
    from topometric_ros.io.trajectories import AgentTrajectory
    from topometric_ros.topometric_map import TopometricMap


class MergeArgumentError(TopometricError):
    """Too few agents to merge, or a prior of none of them."""


def add_parser(commands: Any) -> None:
    """Add this command to the parser."""
    command = commands.add_parser(
        "merge",
        help="one global map from the maps of several agents",
        description="Write OUT/merge.json, global.ply, global.tmap, report.html and timings.json. "
        "The exit status is 0 also where nothing could be aligned.",
    )
    command.add_argument(
        "sources",
        nargs="+",
        metavar="[ID=]SOURCE",
        help="two or more clouds, bags (BAG[:TOPIC]), .tmap files or folders that extract wrote; "
        "the first is the anchor",
    )
    add_arguments(command)
    command.add_argument(
        "--prior",
        action="append",
        default=[],
        metavar="YAML",
        help="what is known beforehand, as 'between: [a, b], position: [12, 3, 0], yaw: 90, "
        "sigma: 1.5, yaw_sigma: 15' (m, degrees); may be given several times",
    )
    command.set_defaults(command=merge)


def merge(options: argparse.Namespace) -> int:
    """Load every source, merge the maps and write the result."""
    from topometric_ros.fusion.merge import merge as merge_maps
    from topometric_ros.fusion.priors import parse_priors, pointless
    from topometric_ros.io.merge_files import merge_summary
    from topometric_ros.io.summaries import rounded_timings
    from topometric_ros.runtime.sources import load_source, named_sources
    from topometric_ros.stopwatch import Stopwatch

    if len(options.sources) < 2:
        raise MergeArgumentError(
            f"merging takes at least two sources, got {len(options.sources)}: {options.sources[0]}"
        )
    config, progress = config_of(options), progress_of(options)
    of_file = config.merge.priors
    priors = (*of_file, *(f"{{{text.strip('{} ')}}}" for text in options.prior))
    config = dataclasses.replace(config, merge=dataclasses.replace(config.merge, priors=priors))
    named = named_sources(options.sources)
    for index, told in pointless(parse_priors(priors), [source.agent or "" for source in named]):
        if index >= len(of_file):
            raise MergeArgumentError(f"--prior: {told}")
    loaded = [load_source(source, config, inputs_of(options), progress) for source in named]
    watch = Stopwatch()
    for entry in loaded:
        watch.add(entry.timings, "extract.")
    maps = [entry.map for entry in loaded]
    sources = {entry.map.agent: entry.source for entry in loaded}
    result = merge_maps(maps, config.merge, sources=sources, progress=progress)
    timings = watch.seconds | result.timings
    folder = output_folder(options)
    progress("writing the report")
    ways = [entry.trajectory for entry in loaded if entry.trajectory]
    qualities = {entry.map.agent: entry.quality for entry in loaded if entry.quality}
    write_result(folder, result, maps, timings, ways, qualities)
    content = {**merge_summary(result), "timings": rounded_timings(timings)}
    report(options, content, [*result_lines(result, maps), f"written to {folder}"])
    return 0


def write_result(
    folder: Path,
    result: MergeResult,
    maps: list[TopometricMap],
    timings: dict[str, float],
    trajectories: Sequence[AgentTrajectory],
    qualities: Mapping[str, Quality],
) -> None:
    """Write the files of a merge with the report."""
    from topometric_ros.io.merge_files import write_merge_files
    from topometric_ros.io.summaries import rounded_timings, write_json
    from topometric_ros.io.trajectories import write_trajectories
    from topometric_ros.visualization.report import write_report

    write_merge_files(folder, result)
    write_trajectories(folder / "global.tmap", trajectories)
    write_json(folder / "timings.json", rounded_timings(timings))
    write_report(result, maps, folder / "report.html", qualities=qualities)


def result_lines(result: MergeResult, maps: Sequence[TopometricMap]) -> Iterator[str]:
    """Yield the result, and what the maps themselves warn of, as lines for a person."""
    from topometric_ros.fusion.poses import matrix_lines

    for agent in result.agents:
        yield f"{agent.id}: {agent.status} ({agent.reason})"
    for alignment in result.alignments:
        yield f"{' - '.join(alignment.agents)}: {alignment.status}: {alignment.reason}"
        if alignment.accepted and alignment.T_a_b is not None:
            a, b = alignment.agents
            yield f"  T_{a}_{b}, from the frame of {b} to that of {a}, m:"
            yield from (f"  {row}" for row in matrix_lines(alignment.T_a_b))
    yield from warning_lines(f"{m.agent}: {told}" for m in maps for told in m.warnings)
    yield from warning_lines(result.warnings)
