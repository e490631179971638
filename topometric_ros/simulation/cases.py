"""One case: agents that walk through a building, their maps, and the truth about them.

    case = simulate(load_building("office:seed=3"), SimulationConfig(overlap=0.5), seed=1)
    write_case(case, folder)

The same building, configuration and seed give the same bytes.
"""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.simulation import degrade
from topometric_ros.simulation.agents import WalkConfig
from topometric_ros.simulation.case import Case, CaseError, SimulatedAgent, edges_of, overlaps_of
from topometric_ros.simulation.case_files import read_case, write_case
from topometric_ros.simulation.degrade import DegradeConfig
from topometric_ros.simulation.labelled import LabelledBuilding
from topometric_ros.simulation.sensors import Returns, SensorConfig, scan_from, with_views
from topometric_ros.simulation.trajectories import (
    Forecast,
    Walk,
    poses_along,
    rooms_on,
    sampled_walks,
    way_of,
)
from topometric_ros.simulation.walkable import Walkable, WalkableConfig
from topometric_ros.simulation.world import World, make_world

__all__ = [
    "Case",
    "CaseError",
    "SimulatedAgent",
    "SimulationConfig",
    "Walk",
    "prepare",
    "read_case",
    "simulate",
    "write_case",
]

logger = logging.getLogger(__name__)

_IN_THE_WAY = 0.1
"""A sensor nearer than this to a surface does not scan, m: moved furniture, a stairwell's edge."""


@dataclass(frozen=True)
class SimulationConfig:
    """How many agents, how they walk, what they carry and what goes wrong."""

    agents: int = parameter(2, "Number of agents.", minimum=1, maximum=26)
    overlap: float = parameter(
        0.5,
        "Wanted part of the smaller map's 0.2 m voxels that each agent shares with the next.",
        minimum=0.0,
        maximum=1.0,
    )
    visits: int = parameter(
        0, "Rooms that each agent visits; 0: drawn, up to 14.", minimum=0, maximum=1000
    )
    walk: WalkConfig = field(default_factory=WalkConfig)
    walkable: WalkableConfig = field(default_factory=WalkableConfig)
    sensor: SensorConfig = field(default_factory=SensorConfig)
    degrade: DegradeConfig = field(default_factory=DegradeConfig)


@dataclass(frozen=True)
class Prepared:
    """A building ready to be walked through, for as many cases as wanted."""

    building: LabelledBuilding
    config: SimulationConfig
    world: World
    walkable: Walkable
    forecast: Forecast


def prepare(building: LabelledBuilding, config: SimulationConfig) -> Prepared:
    """Find where a building can be walked; raises TopometricError where nowhere."""
    world = make_world(building)
    walkable = Walkable(building, world, config.walkable)
    forecast = Forecast(world, walkable, config.sensor.height, config.sensor.maximum_range)
    return Prepared(building, config, world, walkable, forecast)


def simulate(
    building: LabelledBuilding | Prepared,
    config: SimulationConfig,
    seed: int,
    walks: Sequence[Walk] = (),
) -> Case:
    """Return what agents make of a building, with the truth.

    Parameters
    ----------
    building : or what `prepare` made of it with the same configuration, which saves time
    seed : of everything that is drawn
    walks : one for each agent; empty: the building's own, sampled where it has none

    Raises
    ------
    TopometricError
        The building cannot be walked so, there are not as many walks as agents, or an agent has
        seen nothing.
    """
    ready = building if isinstance(building, Prepared) else prepare(building, config)
    building = ready.building
    planning, *streams = np.random.SeedSequence(seed).spawn(1 + config.agents)
    walks = list(walks) or [Walk(t.rooms, t.waypoints) for t in building.trajectories]
    if walks and len(walks) != config.agents:
        raise CaseError(
            f"{building.name}: expected a walk for each of {config.agents} agents, got {len(walks)}"
        )
    if not walks:
        rng = np.random.default_rng(planning)
        wanted = (config.overlap, config.agents, config.visits)
        walks = sampled_walks(ready.walkable, ready.forecast, *wanted, rng)
    cells = degrade.resolutions_of(config.degrade, config.agents)
    agents, seen = [], []
    for k, (walk, stream) in enumerate(zip(walks, streams, strict=True)):
        agent, hits = _agent(ready, config, k, cells[k], walk, stream)
        agents.append(agent)
        seen.append(hits)
    edges = edges_of(building.links)
    return Case(building.name, seed, tuple(agents), overlaps_of(seen), edges, building)


def _agent(
    ready: Prepared,
    config: SimulationConfig,
    k: int,
    cell: float,
    walk: Walk,
    stream: np.random.SeedSequence,
) -> tuple[SimulatedAgent, NDArray[np.float64]]:
    """Walk, scan and degrade one agent; also the true places of its points (N, 3), m."""
    # A stream for each purpose: more noise must not send the agent another way.
    rngs = [np.random.default_rng(child) for child in stream.spawn(6)]
    of_walk, of_scan, of_dropout, of_drift, of_frame, of_furniture = rngs
    world, building = ready.world, ready.building
    if k > 0 and config.degrade.moved > 0.0 and not building.is_cloud:
        world = make_world(building, degrade.move_furniture(building, config.degrade, of_furniture))
    way = way_of(walk, ready.walkable)
    stops = poses_along(ready.walkable.places[way], config.sensor.height, config.walk, of_walk)
    clear = world.clearance(np.array([pose[:3, 3] for pose in stops])) >= _IN_THE_WAY
    poses = with_views([p for p, ok in zip(stops, clear, strict=True) if ok], config.sensor)
    returns = scan_from(world, poses, config.sensor, of_scan)
    returns = returns.where(of_dropout.random(len(returns.hits)) >= config.degrade.dropout)
    if len(returns.hits) == 0:
        raise CaseError(f"{building.name}: agent {k} saw nothing on a walk of {len(poses)} poses")
    T_agent_building = degrade.random_frame(config.degrade, of_frame)
    believed = T_agent_building @ degrade.drifted(poses, config.degrade, of_drift)
    points, returns = _mapped(poses, believed, returns, cell)
    room = building.room_of(returns.hits, returns.towards)
    if not degrade.sees_ceiling(config.degrade, k):
        kept = degrade.below_ceiling(building, returns.hits, room)
        points, returns, room = points[kept], returns.where(kept), room[kept]
    agent = SimulatedAgent(
        id=chr(ord("a") + k),
        points=points,
        room=room,
        poses=believed,
        scan_of_point=returns.scan,
        T_agent_building=T_agent_building,
        rooms_walked=rooms_on(way, ready.walkable),
    )
    logger.info("agent %s: %d poses, %d points", agent.id, len(poses), len(points))
    return agent, returns.hits


def _mapped(
    poses: NDArray[np.float64],
    believed: NDArray[np.float64],
    returns: Returns,
    cell: float,
) -> tuple[NDArray[np.float64], Returns]:
    """Put returns where the agent believes that they are: points (N, 3), agent frame.

    One is kept in each cell of edge `cell`, m.
    """
    measured = returns.hits - returns.towards * returns.error[:, None]
    moves = believed @ np.linalg.inv(poses)
    points = np.empty_like(measured)
    # The returns of a scan follow one another.
    ends = np.searchsorted(returns.scan, np.arange(len(poses) + 1))
    for move, start, end in zip(moves, ends[:-1], ends[1:], strict=True):
        points[start:end] = measured[start:end] @ move[:3, :3].T + move[:3, 3]
    # Single precision, as files and messages hold them.
    points = points.astype(np.float32).astype(np.float64)
    kept = degrade.thinned(points, cell)
    return points[kept], returns.where(kept)
