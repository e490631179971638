"""The maps of a scene of the Collaborative SLAM data set as agents: nothing is simulated.

Each map becomes an agent in a frame of its own, so that nothing tells where it belongs; the truth
is where the data set puts it.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.case import Case, CaseError, SimulatedAgent, edges_of, overlaps_of
from topometric_ros.simulation.degrade import DegradeConfig, cell_codes, random_frame
from topometric_ros.simulation.labelled import LabelledBuilding
from topometric_ros.simulation.labelled_clouds import cslamd_maps
from topometric_ros.simulation.trajectories import OVERLAP_VOXEL

_VISITED = 0.5
"""Share of a room's 0.2 m voxels that an agent must have seen to have been there."""
_MOST = 26


def released_case(path: Path, seed: int) -> Case:
    """Return a scene's maps as agents, gravity-aligned, in frames that are drawn from a seed.

    The agents are called a, b, ... in the order of the files. Their poses are unknown, and a room
    of which a map has half counts as walked through.

    Raises
    ------
    BuildingError
        As `load_cslamd`.
    CaseError
        There are fewer than two maps, or more than there are letters.
    """
    clouds = [points for points, _ in cslamd_maps(path)]
    if not 2 <= len(clouds) <= _MOST:
        raise CaseError(f"{path}: expected 2 to {_MOST} maps as agents, got {len(clouds)}")
    building = load_building(str(path))
    assert building.labels is not None
    labels = np.split(building.labels, np.cumsum([len(points) for points in clouds])[:-1])
    rng = np.random.default_rng(seed)
    agents = []
    for k, (points, room) in enumerate(zip(clouds, labels, strict=True)):
        T = random_frame(DegradeConfig(), rng)
        seen = points @ T[:3, :3].T + T[:3, 3]
        agents.append(
            SimulatedAgent(
                id=chr(ord("a") + k),
                points=seen.astype(np.float32).astype(np.float64),
                room=room,
                poses=np.zeros((0, 4, 4)),
                scan_of_point=np.full(len(points), -1, dtype=np.int32),
                T_agent_building=T,
                rooms_walked=_visited(building, points, room),
            )
        )
    edges = edges_of(building.links)
    return Case(building.name, seed, tuple(agents), overlaps_of(clouds), edges, building)


def _visited(
    building: LabelledBuilding, points: NDArray[np.float64], room: NDArray[np.int32]
) -> tuple[int, ...]:
    """Return the rooms of which an agent's points (N, 3), m, building frame, show enough."""
    assert building.points is not None
    assert building.labels is not None
    found = []
    for one in np.unique(room[room >= 0]):
        whole = np.unique(cell_codes(building.points[building.labels == one], OVERLAP_VOXEL))
        own = np.unique(cell_codes(points[room == one], OVERLAP_VOXEL))
        if len(own) >= _VISITED * len(whole):
            found.append(int(one))
    return tuple(found)
