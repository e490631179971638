"""Sessions and maps of one flat, shared by the tests of the runtime's state."""

from __future__ import annotations

import dataclasses
from functools import cache

from test.helpers import moved, yaw_transform
from test.helpers_bags import flat
from test.helpers_io import random_map
from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.io.clouds import up_rotation
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.runtime.extractor_session import ExtractorSession
from topometric_ros.topometric_map import TopometricMap


def session(agent: str = "robot1", up: str = "z") -> ExtractorSession:
    names = (f"{agent}-{i}" for i in range(100))
    return ExtractorSession(
        agent, ExtractionConfig(), MatchingConfig(), lambda: next(names), up_rotation(up)
    )


@cache
def flat_map(agent: str, seed: int = 0) -> TopometricMap:
    """Return the flat's map in a frame that depends on the seed."""
    one = session(agent)
    T = yaw_transform(0.4 * seed, (seed, 2.0 * seed, 0.0))
    one.add_map_cloud(moved(flat(), T), f"{agent}/map", 5)
    return one.extract().map


def restarted(agent: str) -> TopometricMap:
    """Return a map of another place, of a session that follows the flat's."""
    return dataclasses.replace(random_map(9, agent), session="new", sequence=1)
