"""What a case is: the agents of one building, and how much of it they share."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.simulation.degrade import cell_codes
from topometric_ros.simulation.labelled import LabelledBuilding, TrueLink
from topometric_ros.simulation.trajectories import OVERLAP_VOXEL


class CaseError(TopometricError):
    """A case that cannot be made, read or written."""


@dataclass(frozen=True)
class SimulatedAgent:
    """One agent's map and the truth about it."""

    id: str
    """"a", "b", ... in the order of the agents."""
    points: NDArray[np.float64]
    """(N, 3), m, agent frame, single precision; scan by scan."""
    room: NDArray[np.int32]
    """(N,): the true room of each point, -1 none."""
    poses: NDArray[np.float64]
    """(S, 4, 4) T_agent_sensor as the agent believes them; (0, 4, 4) where unknown."""
    scan_of_point: NDArray[np.int32]
    """(N,): index of the pose, -1 where unknown."""
    T_agent_building: NDArray[np.float64]
    """(4, 4): the truth. With drift, the yaw and translation that leave the least of it."""
    rooms_walked: tuple[int, ...]
    """Ids of the rooms walked through, in the order of the first visit."""


@dataclass(frozen=True)
class Case:
    """The agents of one building; `building` is None where the case was read from files."""

    plan: str
    seed: int
    agents: tuple[SimulatedAgent, ...]
    overlap: NDArray[np.float64]
    """(P,): for the pairs (0, 1), (0, 2), ... of agents, the shared part of the smaller map's
    0.2 m voxels."""
    edges: tuple[tuple[int, int], ...]
    """Pairs of rooms that links join, the lower id first; empty where unknown."""
    building: LabelledBuilding | None = None

    def T_a_b(self, a: int, b: int) -> NDArray[np.float64]:
        """Return the true transform (4, 4) from the frame of agent `b` to that of agent `a`."""
        T_a_building, T_b_building = (self.agents[k].T_agent_building for k in (a, b))
        T: NDArray[np.float64] = T_a_building @ np.linalg.inv(T_b_building)
        return T

    def pairs(self) -> list[tuple[int, int]]:
        """Return the pairs of agents in the order of `overlap`."""
        return list(itertools.combinations(range(len(self.agents)), 2))


def edges_of(links: Sequence[TrueLink]) -> tuple[tuple[int, int], ...]:
    """Return the pairs of rooms that links join, the lower id first."""
    pairs = {(min(link.rooms), max(link.rooms)) for link in links}
    return tuple(sorted(pair for pair in pairs if pair[0] != pair[1]))


def overlaps_of(seen: Sequence[NDArray[np.float64]]) -> NDArray[np.float64]:
    """Return the overlap of every two agents: (P,).

    Parameters
    ----------
    seen : for each agent, where its points really are: (N, 3), m, building frame
    """
    codes = [np.unique(cell_codes(points, OVERLAP_VOXEL)) for points in seen]
    pairs = itertools.combinations(codes, 2)
    return np.array(
        [len(np.intersect1d(a, b, assume_unique=True)) / min(len(a), len(b)) for a, b in pairs]
    )
