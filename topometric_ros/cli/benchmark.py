"""`topometric benchmark`: this package and what a user would pick instead, on the same pairs."""

from __future__ import annotations

import argparse
import sys
from dataclasses import asdict
from typing import Any

from topometric_ros.cli.common import (
    add_json,
    add_output,
    add_verbose,
    output_folder,
    progress_of,
    report,
)

PEERS = "topometric, topometric_thesis, birdseye, kiss_matcher, fpfh_ransac_icp, fgr_icp"
"""As `evaluation.peers.registry` has them, which takes a second to import."""
ROOMS, AGENTS = (10, 30, 100, 300, 1000), (2, 5, 10, 20)
"""Sizes that `--scaling` measures by default."""


def add_parser(commands: Any) -> None:
    """Add this command to the parser."""
    command = commands.add_parser(
        "benchmark",
        help="this package and other methods side by side on pairs with known truth",
        description="Write OUT/rows.csv and tables.md, and print the tables; the pairs of a suite "
        "are simulated first and kept in OUT/pairs. With --scaling write OUT/scaling.csv, "
        "scaling.md and scaling.png. Run it again to go on where it stopped. Exit status 1: "
        "nothing ran.",
    )
    command.add_argument(
        "pairs",
        nargs="*",
        metavar="PAIRS",
        help="folders of pairs, each with a.ply, b.ply and truth.json, or such folders themselves; "
        "or suites (YAML files or names: short, grid, ...)",
    )
    add_output(command)
    command.add_argument(
        "--peers",
        nargs="+",
        metavar="NAME",
        help=f"of {PEERS} (default: all that are installed, but the thesis preset)",
    )
    command.add_argument(
        "--limit", type=_count, default=0, metavar="N", help="at most N pairs, spread over all"
    )
    command.add_argument(
        "--timeout",
        type=float,
        default=600.0,
        metavar="S",
        help="seconds of wall clock after which a run is ended (default 600)",
    )
    command.add_argument(
        "--fresh", action="store_true", help="run all pairs again, after the code has changed"
    )
    command.add_argument(
        "--scaling",
        action="store_true",
        help="instead of pairs: what larger and larger generated offices and more agents cost",
    )
    for name, sizes in (("rooms", ROOMS), ("agents", AGENTS)):
        command.add_argument(
            f"--{name}",
            nargs="+",
            type=_count,
            metavar="N",
            default=sizes,
            help=f"of --scaling (default {' '.join(map(str, sizes))})",
        )
    add_json(command)
    add_verbose(command)
    command.set_defaults(command=benchmark)


def benchmark(options: argparse.Namespace) -> int:
    """Run the benchmark and print its tables."""
    from topometric_ros.evaluation.benchmark import ROWS, run_benchmark
    from topometric_ros.evaluation.benchmark_pairs import BenchmarkError, find_pairs
    from topometric_ros.evaluation.benchmark_tables import benchmark_tables
    from topometric_ros.evaluation.peers.registry import make_peer
    from topometric_ros.io.summaries import write_atomically

    if options.scaling == bool(options.pairs):
        raise BenchmarkError("give folders of pairs or suites, or --scaling without them")
    if options.scaling:
        return _scaling(options)
    peers, progress = options.peers or _installed(), progress_of(options)
    for peer in peers:
        make_peer(peer)  # What is not installed is told before hours of simulation.
    folder = output_folder(options)
    if options.fresh:
        (folder / ROWS).unlink(missing_ok=True)
    found = find_pairs(options.pairs, options.output, options.limit, progress)
    rows = run_benchmark(
        found.pairs, peers, options.output, timeout=options.timeout, progress=progress
    )
    tables = benchmark_tables(rows, found.origin, found.failed)
    write_atomically(options.output / "tables.md", tables.encode())
    report(options, {"rows": [asdict(row) for row in rows]}, (tables.rstrip(),))
    return 1 if all(row.error for row in rows) else 0


def _scaling(options: argparse.Namespace) -> int:
    """Measure what sizes cost, print the tables and draw the picture."""
    from topometric_ros.evaluation.scaling import run_scaling, sizes_of
    from topometric_ros.evaluation.scaling_tables import scaling_picture, scaling_tables
    from topometric_ros.io.summaries import write_atomically

    sizes = sizes_of(options.rooms, options.agents)
    out, progress = options.output, progress_of(options)
    known, failed = run_scaling(sizes, out, timeout=options.timeout, progress=progress)
    tables = scaling_tables(known, failed)
    write_atomically(out / "scaling.md", tables.encode())
    if known:
        write_atomically(out / "scaling.png", scaling_picture(known))
    rows = [{**asdict(size), **measures} for size, measures in known.items()]
    report(options, {"rows": rows}, (tables.rstrip(),))
    return 0 if known else 1


def _installed() -> list[str]:
    """Return the default methods; one whose library is missing is named on stderr."""
    from topometric_ros.evaluation.peers.base import PeerError
    from topometric_ros.evaluation.peers.registry import DEFAULT_PEERS, make_peer

    peers = []
    for name in DEFAULT_PEERS:
        try:
            make_peer(name)
        except PeerError as error:
            print(f"topometric: left out: {error}", file=sys.stderr)
        else:
            peers.append(name)
    return peers


def _count(text: str) -> int:
    """Return a number of things; raises ArgumentTypeError below 0."""
    if not text.isdigit():
        raise argparse.ArgumentTypeError(f"expected a number of at least 0, got {text!r}")
    return int(text)
