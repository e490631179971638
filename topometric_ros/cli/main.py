"""The `topometric` command: arguments in, an exit status out; the work is done elsewhere.

Exit status 0: done, also where nothing could be aligned. 2: bad input, told in one line.
"""

from __future__ import annotations

import argparse
import logging
import os
import sys
from collections.abc import Sequence
from typing import NoReturn

from topometric_ros.cli import (
    benchmark,
    evaluate,
    export,
    extract,
    merge,
    replay,
    run,
    simulate,
    view,
)
from topometric_ros.errors import TopometricError

BAD_INPUT = 2
INTERRUPTED = 130

_DOWNWARD = ("-x", "-y", "-z")
_COMMANDS = (extract, merge, replay, run, view, export, benchmark, evaluate, simulate)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command that the arguments name and return its exit status."""
    options = parser().parse_args(_joined(sys.argv[1:] if arguments is None else arguments))
    _log(options.verbose)
    try:
        return int(options.command(options))
    except TopometricError as error:
        return _fail(str(error))
    except BrokenPipeError:
        # The reader of our output has gone; Python's own flush at exit must not complain again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except OSError as error:
        where = f"{str(error.filename)[:200]}: " if error.filename else ""
        return _fail(f"{where}{error.strerror or error}")
    except MemoryError as error:
        return _fail(f"not enough memory: {error}")
    except KeyboardInterrupt:
        _fail("interrupted")
        return INTERRUPTED


def parser() -> argparse.ArgumentParser:
    """Return the parser of all commands."""
    top = _Parser(
        prog="topometric",
        description="Rooms and passages from point clouds, and one map from those of many agents.",
    )
    commands = top.add_subparsers(title="commands", required=True, metavar="COMMAND")
    for module in _COMMANDS:
        module.add_parser(commands)
    return top


def _joined(arguments: Sequence[str]) -> list[str]:
    """Return the arguments with `--up -y` as `--up=-y`: argparse takes `-y` for an option."""
    joined: list[str] = []
    for argument in arguments:
        if joined[-1:] == ["--up"] and argument in _DOWNWARD:
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


class _Parser(argparse.ArgumentParser):
    """Tells a wrong argument as every other error: in one line."""

    def error(self, message: str) -> NoReturn:
        """Exit with the status of bad input."""
        raise SystemExit(_fail(f"{message} (see {self.prog} --help)"))


def _log(verbose: bool) -> None:
    """Send warnings, or everything, to stderr, each on one line."""
    level = logging.INFO if verbose else logging.ERROR
    logging.basicConfig(level=level, format="%(name)s: %(message)s", stream=sys.stderr, force=True)


def _fail(message: str) -> int:
    """Print one line on stderr and return the exit status of bad input."""
    print(f"topometric: error: {' '.join(message.split())}", file=sys.stderr)
    return BAD_INPUT


if __name__ == "__main__":
    sys.exit(main())
