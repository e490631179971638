"""Write the bundled bag: two agents scan one small building, each in a frame of its own.

    python -m topometric_ros.simulation.demo bags/demo

writes the rosbag2 directory ``bags/demo`` and the truth beside it, ``bags/demo.truth.json``. The
same seed gives the same bytes.
"""

from __future__ import annotations

import argparse
import json
import logging
import sys
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.errors import TopometricError
from topometric_ros.simulation.agents import (
    WalkConfig,
    path_through,
    rotation,
    sensor_poses,
    translation,
)
from topometric_ros.simulation.building import Building
from topometric_ros.simulation.office import office
from topometric_ros.simulation.recording import AgentRecording, write_scans
from topometric_ros.simulation.scanner import LidarConfig, Scanner

logger = logging.getLogger(__name__)

ROOMS_WALKED: dict[str, tuple[int, ...]] = {
    "robot1": (1, 8, 2, 9, 3, 10),
    "robot2": (7, 6, 5, 4, 3, 10, 9),
}
"""Room ids of `office` in the order of each agent's visits; room 0, the corridor, is between."""


@dataclass(frozen=True)
class DemoConfig:
    """The demo's seed, sensor and way of walking."""

    seed: int = parameter(7, "Seed of everything random.", minimum=0)
    lidar_height: float = parameter(1.1, "Height of the sensor over the floor.", unit="m")
    walk: WalkConfig = field(default_factory=WalkConfig)
    lidar: LidarConfig = field(default_factory=LidarConfig)


def record_agent(
    name: str, building: Building, scanner: Scanner, config: DemoConfig
) -> AgentRecording:
    """Walk one agent through its rooms and scan at every step.

    The agent's map frame starts near its first pose, with a yaw and an offset of its own.
    """
    rng = np.random.default_rng([config.seed, sorted(ROOMS_WALKED).index(name)])
    poses = sensor_poses(path_through(building, ROOMS_WALKED[name]), config.walk, rng)
    x, y = poses[0][:2, 3]
    yaw = rng.uniform(-np.pi, np.pi)
    offset = translation(*rng.uniform((-2.0, -2.0, -0.4), (2.0, 2.0, 0.4)))
    T_map_building = offset @ rotation(0.0, 0.0, yaw) @ translation(-x, -y, 0.0)
    # What SLAM has corrected of the odometry: not identity, so that leaving it out shows.
    correction = translation(*rng.uniform((-0.3, -0.3, 0.0), (0.3, 0.3, 0.0)))
    T_map_odom = correction @ rotation(0.0, 0.0, rng.uniform(-0.1, 0.1))
    T_base_lidar = translation(0.0, 0.0, config.lidar_height)
    scans = [scanner.scan(pose @ T_base_lidar, rng) for pose in poses]
    logger.info("%s: %d scans, %d points", name, len(scans), sum(map(len, scans)))
    return AgentRecording(
        name=name,
        T_map_building=T_map_building,
        T_map_odom=T_map_odom,
        T_map_base=[T_map_building @ pose for pose in poses],
        T_base_lidar=T_base_lidar,
        scans=scans,
    )


def make_demo(directory: Path, config: DemoConfig | None = None) -> None:
    """Write the bag `directory` and `directory`.truth.json.

    Raises
    ------
    TopometricError
        The directory exists already.
    """
    config = config or DemoConfig()
    building = office()
    scanner = Scanner(building, config.lidar)
    agents = [record_agent(name, building, scanner, config) for name in ROOMS_WALKED]
    write_scans(directory, agents)
    truth = directory.with_name(directory.name + ".truth.json")
    truth.write_text(json.dumps(_truth(agents), indent=1) + "\n")


def _truth(agents: list[AgentRecording]) -> dict[str, object]:
    """Return what the merger should find, as plain numbers."""

    def rounded(T: NDArray[np.float64]) -> list[list[float]]:
        # Twelve digits: far below what matters, and the same on every machine.
        return (np.round(T, 12) + 0.0).tolist()

    first, second = (agent.T_map_building for agent in agents)
    truth: dict[str, object] = {
        "T_robot1_robot2": rounded(first @ np.linalg.inv(second)),
        "building": "topometric_ros.simulation.office",
        "rooms_walked": {name: [0, *rooms] for name, rooms in sorted(ROOMS_WALKED.items())},
    }
    for agent in agents:
        truth[f"T_{agent.name}_building"] = rounded(agent.T_map_building)
    return truth


def main(arguments: list[str] | None = None) -> int:
    """Run the script; returns the exit status, 2 on bad input."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("directory", type=Path, help="rosbag2 directory to write; must not exist")
    parser.add_argument("--seed", type=int, default=DemoConfig().seed)
    options = parser.parse_args(arguments)
    logging.basicConfig(level=logging.INFO, format="%(message)s")
    try:
        make_demo(options.directory, DemoConfig(seed=options.seed))
    except TopometricError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
