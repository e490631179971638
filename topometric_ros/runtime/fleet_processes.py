"""The processes that make up a fleet, for the launch file and for `topometric run` alike.

An :class:`AgentsFile` says who takes part, :class:`FleetOptions` what holds for all nodes; together
they give the executables and their arguments. Only starting them is left to the caller.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from topometric_ros.errors import TopometricError
from topometric_ros.runtime.agents_file import (
    AgentsFile,
    extractor_arguments,
    merger_arguments,
    player_arguments,
)

LOG_LEVELS = ("debug", "info", "warn", "error", "fatal")
RESPAWN_S = 2.0
"""After which time a node that ended is started again, where that is wanted."""
PROFILE_VARIABLE = "FASTRTPS_DEFAULT_PROFILES_FILE"
PROFILE = "fastdds_large_clouds.xml"


class FleetError(TopometricError):
    """Options that a fleet cannot be started with."""


@dataclass(frozen=True)
class FleetOptions:
    """What holds for every node of a fleet.

    `params_file` is a ROS parameter file. The agents file wins over it, but not where ROS itself
    lets a node's name win: in a file that names `/**` before that node. `managed` starts the nodes
    that wait for a lifecycle manager.

    Raises
    ------
    FleetError
        The parameter file is not there, or the log level is none.
    """

    params_file: str = ""
    use_sim_time: bool = False
    log_level: str = "info"
    managed: bool = False

    def __post_init__(self) -> None:
        if self.params_file and not Path(self.params_file).is_file():
            raise FleetError(f"params_file: no file {self.params_file}")
        if self.log_level not in LOG_LEVELS:
            known = ", ".join(LOG_LEVELS)
            raise FleetError(f"log_level: expected one of {known}, got {self.log_level!r}")


@dataclass(frozen=True)
class FleetProcess:
    """One node: what it is called, the executable (as `ros2 run` names it) and its arguments."""

    name: str
    executable: str
    arguments: tuple[str, ...]


def fleet_processes(fleet: AgentsFile, options: FleetOptions) -> list[FleetProcess]:
    """Return the processes of a fleet: the extractors, the player of a simulated one, the merger.

    Examples
    --------
    >>> from topometric_ros.runtime.agents_file import simulated_fleet
    >>> [p.name for p in fleet_processes(simulated_fleet({}, 1), FleetOptions())]
    ['extractor of robot1', 'player', 'merger']
    """
    told = ["--ros-args", "--log-level", options.log_level]
    # rcl lets those names of nodes win that are named last for the first time: the file's must
    # stand before the `/**` that every `-p` means.
    common = [*told, *(["--params-file", options.params_file] if options.params_file else [])]
    common += ["-p", f"use_sim_time:={str(options.use_sim_time).lower()}"]
    kind = "managed_" if options.managed else ""
    processes = [
        FleetProcess(
            f"extractor of {agent.id}",
            f"{kind}extractor",
            (*common, *extractor_arguments(fleet, agent)),
        )
        for agent in fleet.live
    ]
    if fleet.simulation is not None:
        # It stamps with the time of day, and so must not wait for /clock.
        processes.append(FleetProcess("player", "player", (*told, *player_arguments(fleet))))
    merger = (*common, *merger_arguments(fleet))
    return [*processes, FleetProcess("merger", f"{kind}merger", merger)]


def shipped(name: str) -> Path | None:
    """Return where a file of `config/` is: installed, in a colcon workspace or in a clone."""
    prefixes = [*os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep), sys.prefix]
    folders = [Path(prefix) / "share" / "topometric_ros" for prefix in prefixes if prefix]
    folders.append(Path(__file__).resolve().parents[2])
    found = (folder / "config" / name for folder in folders)
    return next((path for path in found if path.is_file()), None)


def dds_environment(profile: str, environment: Mapping[str, str]) -> dict[str, str]:
    """Return the variables that make Fast DDS use a profile; none where the environment names one.

    Raises
    ------
    FleetError
        The profile is not there: Fast DDS would go on without it and say nothing.
    """
    if not profile or PROFILE_VARIABLE in environment:
        return {}
    if not Path(profile).is_file():
        raise FleetError(f"fastdds_profile: no file {profile}")
    return {PROFILE_VARIABLE: str(Path(profile).resolve())}
