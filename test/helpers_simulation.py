"""Small buildings and light sensors for the tests of simulated agents."""

import numpy as np

from topometric_ros.configuration import with_values
from topometric_ros.simulation.cases import SimulationConfig, Walk

SPEC = "office:seed=3,rooms=6"
LIGHT = {"sensor.lidar.rings": 24, "sensor.lidar.azimuths": 200}
"""A sensor with few rays: most statements do not need many."""
ONE_WALK = (Walk(rooms=(1, 2)), Walk(rooms=(1, 2)))


def configured(**values):
    """Return a configuration with a light sensor; names have __ for the dots."""
    named = {name.replace("__", "."): value for name, value in values.items()}
    return with_values(SimulationConfig(), {**LIGHT, **named})


def in_building(agent):
    """Return an agent's points put into the building by the truth."""
    T = np.linalg.inv(agent.T_agent_building)
    return agent.points @ T[:3, :3].T + T[:3, 3]
