"""`topometric run`: an extractor for every agent of a file and a merger, as processes.

What the launch file does, with the same options, where `launch` is not installed. SIGINT and
SIGTERM end all of them; so does the end of any one, but with `--respawn` it is started again.
"""

from __future__ import annotations

import argparse
import os
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import FrameType
from typing import Any

from topometric_ros.cli.common import add_verbose
from topometric_ros.errors import TopometricError
from topometric_ros.runtime.agents_file import AgentsFile, read_agents_file, simulated_fleet
from topometric_ros.runtime.fleet_processes import (
    LOG_LEVELS,
    PROFILE,
    PROFILE_VARIABLE,
    RESPAWN_S,
    FleetOptions,
    dds_environment,
    fleet_processes,
    shipped,
)

_POLL_S = 0.2
_GRACE_S = 10.0
_REFUSED = 2
"""Exit status of a node that refuses its parameters: it would do so again."""


class RunError(TopometricError):
    """The fleet's processes cannot be started."""


def add_parser(commands: Any) -> None:
    """Add this command to the parser."""
    command = commands.add_parser(
        "run",
        help="start the extractors and the merger of an agents file",
        description="Start one extractor an agent and a merger, and end them together; for a "
        "simulated fleet a player too. The exit "
        "status is 0 after SIGINT or SIGTERM, 1 where a process ended by itself and was not to be "
        "started again.",
    )
    command.add_argument(
        "agents", type=Path, metavar="AGENTS.yaml", nargs="?", help="the agents file"
    )
    command.add_argument(
        "--simulate",
        metavar="BUILDING",
        help="instead of a file: a fleet of simulated agents in office:rooms=6 or the like",
    )
    command.add_argument(
        "--agents", dest="count", type=int, default=2, metavar="N", help="how many (default 2)"
    )
    _add_node_arguments(command)
    add_verbose(command)
    command.set_defaults(command=run)


def _add_node_arguments(command: argparse.ArgumentParser) -> None:
    """Add what the launch file takes too."""
    command.add_argument(
        "--params-file",
        default="",
        metavar="F",
        help="ROS parameter file for all nodes; the agents file wins over it",
    )
    command.add_argument(
        "--use-sim-time",
        action="store_true",
        help="take the time from /clock, for bags played with --clock",
    )
    command.add_argument(
        "--log-level", choices=LOG_LEVELS, help="of all nodes (default info; with -v debug)"
    )
    command.add_argument(
        "--managed",
        action="store_true",
        help="start the managed nodes, which wait for a lifecycle manager",
    )
    command.add_argument(
        "--respawn",
        action="store_true",
        help=f"start a node again {RESPAWN_S:g} s after it has ended, unless it refused its "
        "parameters (status 2)",
    )
    command.add_argument(
        "--fastdds-profile",
        metavar="F",
        help=f"Fast DDS profile, unless {PROFILE_VARIABLE} names one; '' for none "
        f"(default: the {PROFILE} that is installed)",
    )


def run(options: argparse.Namespace) -> int:
    """Start the fleet and wait for its end."""
    told = FleetOptions(
        params_file=options.params_file,
        use_sim_time=options.use_sim_time,
        log_level=options.log_level or ("debug" if options.verbose else "info"),
        managed=options.managed,
    )
    profile = options.fastdds_profile
    if profile is None:
        profile = str(shipped(PROFILE) or "")
    environment = {**os.environ, **dds_environment(profile, os.environ)}
    commands = {
        process.name: [*_executable(process.executable), *process.arguments]
        for process in fleet_processes(_fleet(options), told)
    }
    return _Fleet(commands, environment, options.respawn).run()


def _fleet(options: argparse.Namespace) -> AgentsFile:
    if (options.agents is None) == (options.simulate is None):
        raise RunError("expected either AGENTS.yaml or --simulate BUILDING")
    if options.agents is not None:
        return read_agents_file(options.agents)
    if not 1 <= options.count <= 26:
        raise RunError(f"--agents: expected 1 to 26, got {options.count}")
    return simulated_fleet({"building": options.simulate}, options.count)


def _executable(name: str) -> list[str]:
    """Return how to start a node: the script beside this Python, on the PATH, or the module."""
    script = f"topometric-{name.replace('_', '-')}"
    beside = Path(sys.executable).with_name(script)
    found = str(beside) if beside.exists() else shutil.which(script)
    if found:
        return [found]
    if name.startswith("managed_"):
        return [sys.executable, "-m", "topometric_ros.nodes.managed", name.removeprefix("managed_")]
    return [sys.executable, "-m", f"topometric_ros.nodes.{name}"]


class _Fleet:
    """Processes that live and end together; with `respawn` those that end are started again."""

    def __init__(
        self,
        commands: Mapping[str, Sequence[str]],
        environment: Mapping[str, str],
        respawn: bool = False,
    ) -> None:
        self._commands = commands
        self._environment = environment
        self._respawn = respawn
        self._due: dict[str, float] = {}
        self._processes: dict[str, subprocess.Popen[bytes]] = {}
        self._stopping = False

    def run(self) -> int:
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, self._stop)
        try:
            self._start()
            ended = self._wait()
        finally:
            self._end()
        if self._stopping:
            return 0
        print(f"topometric: {ended}; the others were ended", file=sys.stderr)
        return 1

    def _stop(self, number: int, frame: FrameType | None) -> None:
        self._stopping = True

    def _start(self) -> None:
        for name in self._commands:
            self._start_one(name)

    def _start_one(self, name: str) -> None:
        try:
            # A session of its own: Ctrl-C reaches the processes once, from here, in order.
            self._processes[name] = subprocess.Popen(
                self._commands[name], env=self._environment, start_new_session=True
            )
        except OSError as error:
            raise RunError(f"{name}: cannot be started: {error}") from error
        print(f"topometric: {name}: process {self._processes[name].pid}", file=sys.stderr)

    def _wait(self) -> str:
        """Wait for a signal or an end that nothing follows; return what happened in words."""
        while not self._stopping:
            for name, process in self._processes.items():
                if process.poll() is None:
                    continue
                told = f"{name} ended with {_status(process.returncode)}"
                if not self._respawn or process.returncode == _REFUSED:
                    return told
                if name not in self._due:
                    print(f"topometric: {told}; it is started again", file=sys.stderr)
                    self._due[name] = time.monotonic() + RESPAWN_S
            for name in [name for name, due in self._due.items() if due <= time.monotonic()]:
                del self._due[name]
                self._start_one(name)
            time.sleep(_POLL_S)
        return "stopped"

    def _end(self) -> None:
        """Ask every process to end, and kill what does not within the time of grace."""
        for process in self._processes.values():
            if process.poll() is None:
                # Nodes take SIGINT alike, but Python answers it with a traceback while it imports.
                process.send_signal(signal.SIGTERM)
        limit = time.monotonic() + _GRACE_S
        for name, process in self._processes.items():
            try:
                process.wait(max(0.1, limit - time.monotonic()))
            except subprocess.TimeoutExpired:
                print(f"topometric: {name} did not end; killed", file=sys.stderr)
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()


def _status(code: int) -> str:
    return f"signal {signal.Signals(-code).name}" if code < 0 else f"status {code}"
