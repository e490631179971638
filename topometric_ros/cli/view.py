"""`topometric view`: a map as one HTML page that opens in any browser, or as PNG files."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topometric_ros.cli.common import (
    add_cloud_arguments,
    add_verbose,
    config_of,
    finish_progress,
    inputs_of,
    progress_of,
)

if TYPE_CHECKING:
    from topometric_ros.visualization.stage_files import FileStages
    from topometric_ros.visualization.view import ViewError


def add_parser(commands: Any) -> None:
    """Add this command to the parser."""
    command = commands.add_parser(
        "view",
        help="a map in 3D as one HTML page that needs no network",
        description="Write one HTML page: points by room, agent or storey, the topological graph, "
        "the rooms' attributes and matches, and the stages of the extraction; with --save the same "
        "as PNG files.",
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
        help="stages to show in the page or, with --save, to draw: navigable, distance, isovist, "
        "similarity, rooms, matches (of a merge's output folder), trajectories, or all that FILE "
        "can show",
    )
    command.add_argument(
        "--config", default="default", metavar="F", help="of the extraction: YAML file or preset"
    )
    command.add_argument("--voxel-size", type=float, metavar="M", help="of the extraction, metres")
    add_cloud_arguments(command)
    add_verbose(command)
    command.set_defaults(command=view, mode="auto", map_frame="", seed=0)


def view(options: argparse.Namespace) -> int:
    """Load what is to be shown and write page and pictures."""
    from topometric_ros.visualization.stage_files import FileStages, save_stages, stage_names
    from topometric_ros.visualization.view_pictures import save_pictures
    from topometric_ros.visualization.view_sources import load_view

    progress, config, inputs = progress_of(options), config_of(options), inputs_of(options)
    asked = stage_names(options.stage or ())
    shown = load_view(options.file, config, inputs, progress)
    stages = FileStages(shown, options.file, config, inputs, progress)
    written, missing = [], []
    if options.output or not options.save:
        missing = _write_page(stages, options.output or Path("view.html"), asked)
        written.append(options.output or Path("view.html"))
    if asked and options.save:
        pictures, missing = save_stages(stages, asked, options.save)
        written += pictures
    elif options.save:
        progress("drawing")
        written += save_pictures(shown, options.save)
    if missing and asked and ("all" not in options.stage or not written):
        raise missing[0]
    finish_progress(options)
    for path in written:
        print(f"written: {path}")
    for error in missing if asked else ():
        print(f"not drawn: {error}", file=sys.stderr)
    return 0


def _write_page(stages: FileStages, page: Path, asked: Sequence[str]) -> list[ViewError]:
    """Write the page; returns an error for every stage that it cannot show."""
    from topometric_ros.io.summaries import write_atomically
    from topometric_ros.visualization.page_stages import page_stages
    from topometric_ros.visualization.view_page import view_html

    shown, missing = page_stages(stages, asked)
    stages.progress("writing the page")
    write_atomically(page, view_html(stages.view, shown).encode())
    return missing
