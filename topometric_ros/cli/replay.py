"""`topometric replay`: the nodes' code over recorded bags, to a global map and an output bag."""

from __future__ import annotations

import argparse
from typing import Any

from topometric_ros.cli.common import (
    add_arguments,
    config_of,
    inputs_of,
    output_folder,
    progress_of,
    report,
)
from topometric_ros.cli.merge import result_lines, write_result


def add_parser(commands: Any) -> None:
    """Add this command to the parser."""
    command = commands.add_parser(
        "replay",
        help="extract and merge from recorded bags, offline",
        description="Write OUT/bag (metadata.yaml and MCAP), merge.json, global.ply, global.tmap, "
        "report.html and timings.json.",
    )
    command.add_argument(
        "bags",
        nargs="+",
        metavar="[ID=]BAG[:TOPIC]",
        help="bags of rosbag2; without a topic, every first namespace with clouds is an agent",
    )
    command.add_argument(
        "--every",
        type=_seconds,
        default=0.0,
        metavar="S",
        help="extract and merge every S seconds of recorded time too (default: at the end only)",
    )
    add_arguments(command)
    command.set_defaults(command=replay)


def replay(options: argparse.Namespace) -> int:
    """Replay the bags and write what came of it."""
    from topometric_ros.io.merge_files import merge_summary
    from topometric_ros.io.summaries import rounded_timings
    from topometric_ros.runtime.replay import find_agents
    from topometric_ros.runtime.replay import replay as replay_bags

    config, progress = config_of(options), progress_of(options)
    agents = find_agents(options.bags)
    folder = output_folder(options)
    replayed = replay_bags(
        agents, folder, config, inputs_of(options), every=options.every, progress=progress
    )
    progress("writing the report")
    maps, trajectories = list(replayed.maps), replayed.trajectories
    qualities = replayed.qualities
    write_result(folder, replayed.result, maps, replayed.timings, trajectories, qualities)
    content = {
        **merge_summary(replayed.result),
        "timings": rounded_timings(replayed.timings),
    }
    report(options, content, [*result_lines(replayed.result, maps), f"written to {folder}"])
    return 0


def _seconds(text: str) -> float:
    """Return a time; raises ArgumentTypeError for what is none, or below 0."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0 <= seconds < 1e9:
        raise argparse.ArgumentTypeError(f"expected a number of seconds from 0 on, got {text!r}")
    return seconds
