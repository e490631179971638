"""A case as a bag: single scans with /tf, or the growing map clouds of each agent."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.simulation.agents import rotation, translation
from topometric_ros.simulation.case import Case, CaseError, SimulatedAgent
from topometric_ros.simulation.degrade import thinned
from topometric_ros.simulation.recording import (
    PERIOD,
    START,
    AgentRecording,
    MapRecording,
    write_maps,
    write_scans,
)

KINDS = ("scans", "maps")

_MOUNT = translation(0.0, 0.0, 1.0)
"""T_base_lidar: where the bags say that the sensor sits on the robot."""
_CORRECTION = translation(0.2, -0.1, 0.0) @ rotation(0.0, 0.0, 0.05)
"""T_map_odom: what SLAM has corrected; not identity, so that leaving it out shows."""
_MAPS = 4
"""Messages in which a map grows to its end."""
_MAP_CELL = 0.05
"""Edge of the cells of a map cloud that keep one point each, m."""


def write_bag(case: Case, directory: Path, kind: str) -> None:
    """Write a case as a new bag in which agent X is /X/scan_cloud or /X/cloud_map.

    The scans hold the points of the agent's map, each once; put together by /tf they are the map.

    Raises
    ------
    CaseError
        The kind is none of "scans" and "maps", or scans are asked for whose poses are unknown.
    RecordingError
        The directory exists already.
    """
    if kind not in KINDS:
        raise CaseError(f"bag: expected one of {', '.join(KINDS)}, got {kind!r}")
    if kind == "maps":
        write_maps(directory, [_maps_of(agent) for agent in case.agents])
    else:
        write_scans(directory, [_scans_of(agent) for agent in case.agents])


def _scans_of(agent: SimulatedAgent) -> AgentRecording:
    if len(agent.poses) == 0:
        raise CaseError(f"agent {agent.id}: the poses of its scans are unknown")
    poses, scans = [], []
    for i, pose in enumerate(agent.poses):
        points = agent.points[agent.scan_of_point == i]
        if len(points):
            T_sensor_agent = np.linalg.inv(pose)
            seen = points @ T_sensor_agent[:3, :3].T + T_sensor_agent[:3, 3]
            poses.append(pose @ np.linalg.inv(_MOUNT))
            scans.append(seen.astype(np.float32))
    return AgentRecording(agent.id, agent.T_agent_building, _CORRECTION, poses, _MOUNT, scans)


def _maps_of(agent: SimulatedAgent) -> MapRecording:
    count = max(len(agent.poses), 1)
    clouds: list[tuple[int, NDArray[np.float32]]] = []
    for share in range(1, _MAPS + 1):
        last = -(-count * share // _MAPS)
        points = agent.points[agent.scan_of_point < last]
        grown = points[thinned(points, _MAP_CELL)].astype(np.float32)
        clouds.append((START + last * PERIOD, grown))
    return MapRecording(agent.id, clouds)
