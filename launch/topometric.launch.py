"""Start one extractor for each agent and one merger, all named in an agents file."""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.action import Action
from launch.actions import DeclareLaunchArgument, OpaqueFunction, SetEnvironmentVariable
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import Node

from launch import LaunchContext, LaunchDescription
from topometric_ros.runtime.agents_file import read_agents_file
from topometric_ros.runtime.fleet_processes import (
    PROFILE,
    RESPAWN_S,
    FleetOptions,
    dds_environment,
    fleet_processes,
)


def generate_launch_description() -> LaunchDescription:
    """Return the arguments, and the processes that follow from them."""
    config = Path(get_package_share_directory("topometric_ros"), "config")
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "agents_file",
                default_value=str(config / "agents.yaml"),
                description="YAML file that names the agents, their namespaces and their clouds",
            ),
            DeclareLaunchArgument(
                "params_file",
                default_value="",
                description="ROS parameter file for all nodes; the agents file wins over it",
            ),
            DeclareLaunchArgument(
                "use_sim_time",
                default_value="false",
                description="take the time from /clock, for bags played with --clock",
            ),
            DeclareLaunchArgument(
                "log_level",
                default_value="info",
                description="debug, info, warn, error or fatal",
            ),
            DeclareLaunchArgument(
                "managed",
                default_value="false",
                description="start the managed nodes, which wait for a lifecycle manager",
            ),
            DeclareLaunchArgument(
                "respawn",
                default_value="false",
                description="start a node again that has ended",
            ),
            DeclareLaunchArgument(
                "fastdds_profile",
                default_value=str(config / PROFILE),
                description="Fast DDS profile, unless the environment names one; empty: none",
            ),
            OpaqueFunction(function=_processes),
        ]
    )


def _processes(context: LaunchContext) -> list[Action]:
    names = ("agents_file", "params_file", "use_sim_time", "log_level", "managed")
    value = {
        name: LaunchConfiguration(name).perform(context) for name in (*names, "fastdds_profile")
    }
    options = FleetOptions(
        params_file=value["params_file"],
        use_sim_time=value["use_sim_time"].lower() == "true",
        log_level=value["log_level"].lower(),
        managed=value["managed"].lower() == "true",
    )
    respawn = LaunchConfiguration("respawn").perform(context).lower() == "true"
    fleet = read_agents_file(value["agents_file"])
    variables = dds_environment(value["fastdds_profile"], os.environ)
    return [
        *(SetEnvironmentVariable(name, text) for name, text in variables.items()),
        *(_node(p.executable, p.arguments, respawn) for p in fleet_processes(fleet, options)),
    ]


def _node(executable: str, arguments: Sequence[str], respawn: bool) -> Node:
    return Node(
        package="topometric_ros",
        executable=executable,
        arguments=list(arguments),
        respawn=respawn,
        respawn_delay=RESPAWN_S,
        output="screen",
    )
