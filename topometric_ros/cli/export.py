"""`topometric export`: a map in the formats of other programs, Nav2's among them."""

from __future__ import annotations

import argparse
from pathlib import Path
from typing import Any

from topometric_ros.cli.common import add_output, add_verbose, output_folder

_FORMATS = ("ply", "pcd", "laz", "pgm", "geojson", "graphml")


def add_parser(commands: Any) -> None:
    """Add this command to the parser."""
    command = commands.add_parser(
        "export",
        help="a map as cloud (PLY, PCD, LAZ), Nav2 grid and route graph, or GraphML",
        description="Write cloud.ply, cloud.pcd and cloud.laz, storey_N.pgm with .yaml (map server "
        "of Nav2), storey_N.geojson (route server of Nav2) and graph.graphml.",
    )
    command.add_argument(
        "map", metavar="MAP", help=".tmap file, or the output folder of extract, merge or replay"
    )
    add_output(command)
    command.add_argument(
        "--formats",
        nargs="+",
        choices=_FORMATS,
        metavar="NAME",
        help=f"of {', '.join(_FORMATS)} (default: all, laz only where laspy is installed)",
    )
    add_verbose(command)
    command.set_defaults(command=export)


def export(options: argparse.Namespace) -> int:
    """Load the map and write it."""
    from topometric_ros.io.exports import export_map
    from topometric_ros.io.map_files import load_global_map, map_file_of
    from topometric_ros.io.map_format import MapFileError

    path = Path(options.map)
    file = map_file_of(path) if path.is_dir() else path
    if file is None:
        raise MapFileError(f"{path}: expected global.tmap or map.tmap in the folder, got neither")
    m, observed_by, _ = load_global_map(file)
    folder = output_folder(options)
    for path in export_map(folder, m, options.formats or _writable(), observed_by):
        print(f"written: {path}")
    return 0


def _writable() -> list[str]:
    """Return the formats whose libraries are installed."""
    from importlib.util import find_spec

    laz = all(find_spec(name) is not None for name in ("laspy", "lazrs"))
    return [name for name in _FORMATS if laz or name != "laz"]
