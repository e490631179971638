"""`topometric view`: a map as one HTML page that opens in any browser, or as PNG files."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topometric_ros.cli.common import (
    add_verbose,
    config_of,
    finish_progress,
    inputs_of,
    progress_of,
)

if TYPE_CHECKING:
    from topometric_ros.visualization.view import View


def add_parser(commands: Any) -> None:
    """Add this command to the parser."""
    command = commands.add_parser(
        "view",
        help="a map in 3D as one HTML page that needs no network",
        description="Write one HTML page: points by room, agent or storey, the topological graph, "
        "the rooms' attributes and matches; with --save the same as PNG files, or with --stage too "
        "what the stages of the extraction made.",
    )
    command.add_argument(
        "file",
        metavar="FILE",
        help="cloud, BAG[:TOPIC], .tmap file, or the output folder of extract, merge or replay",
    )
    command.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="PAGE",
        help="page to write (default: view.html; none with --save)",
    )
    command.add_argument("--save", type=Path, metavar="DIR", help="write PNG files into DIR")
    command.add_argument(
        "--stage",
        nargs="+",
        action="extend",
        metavar="NAME",
        help="with --save, draw stages of the extraction instead: navigable, distance, isovist, "
        "similarity, rooms, matches (of a merge's output folder), trajectories, or all that FILE "
        "can show",
    )
    command.add_argument(
        "--config", default="default", metavar="F", help="of the extraction: YAML file or preset"
    )
    command.add_argument("--voxel-size", type=float, metavar="M", help="of the extraction, metres")
    command.add_argument(
        "--up", choices=("x", "y", "z"), default="z", help="axis of the cloud that points up"
    )
    add_verbose(command)
    command.set_defaults(command=view, mode="auto", map_frame="", seed=0)


def view(options: argparse.Namespace) -> int:
    """Load what is to be shown and write page and pictures."""
    from topometric_ros.io.summaries import write_atomically
    from topometric_ros.visualization.view_page import view_html
    from topometric_ros.visualization.view_sources import load_view

    progress = progress_of(options)
    stages = _stages(options)
    shown = load_view(options.file, config_of(options), inputs_of(options), progress)
    written = []
    if options.output or not options.save:
        progress("writing the page")
        page = options.output or Path("view.html")
        write_atomically(page, view_html(shown).encode())
        written.append(page)
    if stages:
        written += _draw_stages(options, shown, stages)
    elif options.save:
        from topometric_ros.visualization.view_pictures import save_pictures

        progress("drawing")
        written += save_pictures(shown, options.save)
    finish_progress(options)
    for path in written:
        print(f"written: {path}")
    return 0


def _stages(options: argparse.Namespace) -> tuple[str, ...]:
    """Return the stages that were asked for; raises ViewError where that makes no sense."""
    from topometric_ros.visualization.stage_files import stage_names
    from topometric_ros.visualization.view import ViewError

    if options.stage and not options.save:
        raise ViewError("--stage draws PNG files: name their folder with --save DIR")
    return stage_names(options.stage or ())


def _draw_stages(options: argparse.Namespace, shown: View, stages: tuple[str, ...]) -> list[Path]:
    """Draw stages; under `all` those that the file cannot show are told and left out."""
    from topometric_ros.visualization.stage_files import FileStages, save_stages

    config, inputs = config_of(options), inputs_of(options)
    source = FileStages(shown, options.file, config, inputs, progress_of(options))
    written, missing = save_stages(source, stages, options.save)
    if missing and ("all" not in options.stage or not written):
        raise missing[0]
    finish_progress(options)
    for error in missing:
        print(f"not drawn: {error}", file=sys.stderr)
    return written
