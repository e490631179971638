"""Start a simulated fleet: a player, one extractor for each agent and a merger."""

from __future__ import annotations

from pathlib import Path

from ament_index_python.packages import get_package_share_directory
from launch.actions import DeclareLaunchArgument, IncludeLaunchDescription
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import LaunchConfiguration

from launch import LaunchDescription


def generate_launch_description() -> LaunchDescription:
    """Return the fleet's launch file with the simulated agents in the place of real ones."""
    share = Path(get_package_share_directory("topometric_ros"))
    return LaunchDescription(
        [
            DeclareLaunchArgument(
                "agents_file",
                default_value=str(share / "config" / "simulated_fleet.yaml"),
                description="YAML file of a fleet, with a `simulation`",
            ),
            IncludeLaunchDescription(
                PythonLaunchDescriptionSource(str(share / "launch" / "topometric.launch.py")),
                launch_arguments={"agents_file": LaunchConfiguration("agents_file")}.items(),
            ),
        ]
    )
