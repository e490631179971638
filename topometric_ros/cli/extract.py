"""`topometric extract`: rooms, passages and storeys from one cloud."""

from __future__ import annotations

import argparse
import dataclasses
from typing import Any

from topometric_ros.cli.common import (
    add_arguments,
    config_of,
    inputs_of,
    note_lines,
    output_folder,
    progress_of,
    report,
    warning_lines,
)


def add_parser(commands: Any) -> None:
    """Add this command to the parser."""
    command = commands.add_parser(
        "extract",
        help="rooms and passages from one point cloud",
        description="Write OUT/map.json, rooms.ply, map.tmap and timings.json.",
    )
    command.add_argument(
        "cloud",
        metavar="CLOUD",
        help=".ply, .pcd, .las, .laz, .e57, .npy, .npz, text (.xyz, .txt, .csv, .asc, .pts), or "
        "BAG[:TOPIC]",
    )
    command.add_argument(
        "--agent", metavar="ID", help="name of the agent (default: topic's namespace or file stem)"
    )
    add_arguments(command)
    command.set_defaults(command=extract)


def extract(options: argparse.Namespace) -> int:
    """Extract one map and write it."""
    from topometric_ros.io.map_files import save_map
    from topometric_ros.io.summaries import (
        map_summary,
        rounded_timings,
        write_json,
        write_rooms_ply,
    )
    from topometric_ros.io.trajectories import write_trajectories
    from topometric_ros.runtime.bag_sources import parse_source, require_name
    from topometric_ros.runtime.sources import load_source
    from topometric_ros.visualization.page import counted

    source = parse_source(options.cloud)
    if options.agent is not None:
        source = dataclasses.replace(source, agent=require_name(options.agent))
    config = config_of(options)
    loaded = load_source(source, config, inputs_of(options), progress_of(options))
    folder = output_folder(options)
    m = loaded.map
    summary = map_summary(m, loaded.quality)
    timings = rounded_timings(loaded.timings)
    write_json(folder / "map.json", summary)
    write_rooms_ply(folder / "rooms.ply", m)
    save_map(folder / "map.tmap", m)
    write_trajectories(folder / "map.tmap", [loaded.trajectory] if loaded.trajectory else [])
    write_json(folder / "timings.json", timings)
    lines = [
        f"{m.agent}: {counted(len(m.rooms), 'room')}, {counted(len(m.passages), 'passage')}, "
        f"{counted(len(m.storeys), 'storey')}, {counted(len(m.voxels), 'voxel')} "
        f"in {sum(loaded.timings.values()):.1f} s of CPU time",
        *warning_lines(m.warnings),
        *note_lines(loaded.quality),
        f"written to {folder}",
    ]
    report(options, {**summary, "timings": timings}, lines)
    return 0
