"""What the subcommands share: common arguments, progress on a terminal, results on stdout.

A subcommand imports what it works with inside its functions: the stages take a second to import,
which `--help` and a mistyped option should not cost.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

from topometric_ros.runtime.agents_file import MODES

if TYPE_CHECKING:
    from topometric_ros.extraction.quality import Quality
    from topometric_ros.runtime.config import ToolConfig
    from topometric_ros.runtime.sources import InputOptions


def add_arguments(command: argparse.ArgumentParser) -> None:
    """Add the arguments that every command on recorded data has."""
    add_output(command)
    command.add_argument(
        "--config",
        default="default",
        metavar="F",
        help="YAML file, or a preset: default or thesis",
    )
    command.add_argument(
        "--voxel-size", type=float, metavar="M", help="edge of a voxel in metres (default 0.1)"
    )
    add_cloud_arguments(command)
    command.add_argument(
        "--mode",
        choices=MODES,
        default="auto",
        help="whether a bag's clouds are whole maps or single scans; auto: scans where /tf leads "
        "from their frame to the map's",
    )
    command.add_argument(
        "--map-frame",
        default="",
        metavar="FRAME",
        help="frame in which a bag's scans are gathered; by default the nearest one above them "
        "that is named map, else the root of their TF tree",
    )
    command.add_argument("--seed", type=int, default=0, help="of the session ids (default 0)")
    add_json(command)
    add_verbose(command)


def add_output(command: argparse.ArgumentParser, required: bool = True) -> None:
    """Add the argument that names the folder for the results."""
    command.add_argument(
        "-o", "--output", type=_folder, required=required, metavar="OUT", help="folder to write to"
    )


def _folder(text: str) -> Path:
    """Return a path to write to, told before any work; raises ArgumentTypeError for a file."""
    path = Path(text)
    if path.exists() and not path.is_dir():
        raise argparse.ArgumentTypeError(f"expected a folder to write to, got the file {path}")
    return path


def add_cloud_arguments(command: argparse.ArgumentParser) -> None:
    """Add the arguments that say how cloud files are to be read."""
    command.add_argument(
        "--up",
        choices=("x", "y", "z", "-x", "-y", "-z"),
        default="z",
        help="axis of the clouds that points up",
    )
    command.add_argument(
        "--scale",
        type=float,
        default=1.0,
        metavar="M",
        help="length in metres of the unit that cloud files are in, as 0.001 for millimetres",
    )


def add_json(command: argparse.ArgumentParser) -> None:
    """Add the argument of every command that has a result."""
    command.add_argument("--json", action="store_true", help="print the result on stdout as JSON")


def add_verbose(command: argparse.ArgumentParser) -> None:
    """Add the argument that every command has."""
    command.add_argument("-v", "--verbose", action="store_true", help="say more on stderr")


def config_of(options: argparse.Namespace) -> ToolConfig:
    """Return the configuration that `--config` and `--voxel-size` name."""
    from topometric_ros.runtime.config import load_config, with_voxel_size

    return with_voxel_size(load_config(options.config), options.voxel_size)


def inputs_of(options: argparse.Namespace) -> InputOptions:
    """Return how the inputs are to be read."""
    from topometric_ros.runtime.sources import InputOptions

    return InputOptions(options.up, options.mode, options.map_frame, options.seed, options.scale)


def output_folder(options: argparse.Namespace) -> Path:
    """Make the folder to write to, unless it is there."""
    folder: Path = options.output
    folder.mkdir(parents=True, exist_ok=True)
    return folder


def progress_of(options: argparse.Namespace) -> Callable[[str], None]:
    """Return what says what is being done: one changing line on a terminal, lines with -v.

    A pipe or a file gets nothing without -v.
    """
    if options.verbose:
        return lambda text: print(text, file=sys.stderr, flush=True)
    if not sys.stderr.isatty():
        return lambda text: None
    return lambda text: print(f"\r\033[K{text} …", end="", file=sys.stderr, flush=True)


def finish_progress(options: argparse.Namespace) -> None:
    """Clear the line of progress."""
    if sys.stderr.isatty() and not options.verbose:
        print("\r\033[K", end="", file=sys.stderr, flush=True)


def report(options: argparse.Namespace, content: Mapping[str, Any], lines: Iterable[str]) -> None:
    """Print the result: JSON where it was asked for, else lines for a person."""
    finish_progress(options)
    if options.json:
        print(json.dumps(_without_nan(content), allow_nan=False))
        return
    for line in lines:
        print(line)


def _without_nan(value: Any) -> Any:
    """Return JSON's null in place of what was not measured."""
    if isinstance(value, Mapping):
        return {key: _without_nan(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_without_nan(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def warning_lines(warnings: Iterable[str]) -> list[str]:
    """Return warnings as lines for a person."""
    return [f"warning: {warning}" for warning in warnings]


def note_lines(quality: Quality | None) -> list[str]:
    """Return what a map lacks though nobody need act, as lines for a person."""
    notes = () if quality is None else (f for f in quality.findings if not f.is_warning)
    return [f"note: {note}" for note in notes]
