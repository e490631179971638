"""`topometric benchmark`: this package and what a user would pick instead, on the same pairs."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path
from typing import Any

from topometric_ros.cli.common import add_verbose, finish_progress, progress_of
from topometric_ros.evaluation.benchmark import find_pairs, run_benchmark
from topometric_ros.evaluation.benchmark_tables import benchmark_tables
from topometric_ros.evaluation.peers.base import PeerError
from topometric_ros.evaluation.peers.registry import DEFAULT_PEERS, PEER_NAMES, make_peer
from topometric_ros.io.summaries import write_atomically


def add_parser(commands: Any) -> None:
    """Add this command to the parser."""
    command = commands.add_parser(
        "benchmark",
        help="this package and other methods side by side on pairs with known truth",
        description="Write OUT/rows.csv and tables.md, and print the tables. Run it again to go on "
        "where it stopped.",
    )
    command.add_argument(
        "pairs",
        nargs="+",
        type=Path,
        metavar="PAIRS",
        help="folders of pairs, each with a.ply, b.ply and truth.json, or such folders themselves",
    )
    command.add_argument("-o", "--output", type=Path, required=True, metavar="OUT")
    command.add_argument(
        "--peers",
        nargs="+",
        metavar="NAME",
        help=f"of {', '.join(PEER_NAMES)} (default: all that are installed, but the thesis preset)",
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
    add_verbose(command)
    command.set_defaults(command=benchmark)


def benchmark(options: argparse.Namespace) -> int:
    """Run the benchmark and print its tables."""
    pairs = find_pairs(options.pairs, options.limit)
    peers = options.peers or _installed()
    rows = run_benchmark(
        pairs, peers, options.output, timeout=options.timeout, progress=progress_of(options)
    )
    tables = benchmark_tables(rows)
    write_atomically(options.output / "tables.md", tables.encode())
    finish_progress(options)
    print(tables, end="")
    return 0


def _installed() -> list[str]:
    """Return the default methods; one whose library is missing is named on stderr."""
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
    count = int(text)
    if count < 0:
        raise ValueError(text)
    return count
