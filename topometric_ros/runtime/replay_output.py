"""The bag that replay writes: what the nodes would have published, at the times of the input."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from types import TracebackType

from topometric_ros.io.bag_messages import (
    ALIGNMENTS_TYPE,
    CLOUD_TYPE,
    MAP_TYPE,
    TRANSFORM_TYPE,
    message_classes,
)
from topometric_ros.io.bag_writer import BagWriter
from topometric_ros.runtime.alignment_codec import alignments_to_message
from topometric_ros.runtime.cloud_message import map_cloud
from topometric_ros.runtime.frames import published_frames, transforms_message
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.message_codec import map_to_message
from topometric_ros.topometric_map import TopometricMap

GLOBAL_MAP = "/global_map"
GLOBAL_CLOUD = "/global_cloud"
ALIGNMENTS = "/alignments"


def topic_token(agent: str) -> str:
    """Return an agent's id as a part of a topic's name, which may hold letters, digits and _ only.

    Examples
    --------
    >>> topic_token("floor-2.north"), topic_token("2nd")
    ('floor_2_north', '_2nd')
    """
    token = re.sub(r"[^A-Za-z0-9_]", "_", agent)
    return f"_{token}" if token[:1].isdigit() else token


class ReplayOutput:
    """The output bag; use as a context manager.

    Parameters
    ----------
    path : directory of the bag
    agents : ids of all agents, in order
    """

    def __init__(self, path: Path, agents: Sequence[str]) -> None:
        self._bag = BagWriter(path)
        self._topics: dict[str, str] = {}
        for agent in agents:
            token = topic_token(agent)
            while f"/{token}/topometric_map" in self._topics.values():
                token += "_"  # Another agent's id has the same letters.
            self._topics[agent] = f"/{token}/topometric_map"
        self._classes = message_classes()

    def __enter__(self) -> ReplayOutput:
        self._bag.__enter__()
        for topic in self._topics.values():
            self._bag.add_topic(topic, MAP_TYPE, latched=True)
        self._bag.add_topic(GLOBAL_MAP, MAP_TYPE, latched=True)
        self._bag.add_topic(GLOBAL_CLOUD, CLOUD_TYPE, latched=True)
        self._bag.add_topic(ALIGNMENTS, ALIGNMENTS_TYPE, latched=True)
        self._bag.add_topic("/tf", TRANSFORM_TYPE)
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bag.__exit__(kind, error, trace)

    def write_map(self, m: TopometricMap, time: int) -> None:
        """Write a new version of an agent's map."""
        self._bag.write(self._topics[m.agent], time, map_to_message(m, self._classes))

    def write_result(self, merger: MergerSession, time: int) -> None:
        """Write what the merger found: global map and cloud, alignments, /tf of aligned agents."""
        result = merger.result
        if result is None:
            return
        classes = self._classes
        global_map, observed_by = result.global_map.map, result.global_map.agents
        observers = tuple(agent.id for agent in result.agents)
        message = map_to_message(global_map, classes, observed_by, observers)
        self._bag.write(GLOBAL_MAP, time, message)
        cloud = map_cloud(global_map, classes, time, observed_by)
        self._bag.write(GLOBAL_CLOUD, time, cloud)
        found = alignments_to_message(result, classes, time, merger.maps, merger.stale)
        self._bag.write(ALIGNMENTS, time, found)
        frames = published_frames(
            {agent: m.frame_id for agent, m in merger.maps.items()}, result.global_frame
        )
        tf = transforms_message(classes, time, result.global_frame, merger.transforms(), frames)
        self._bag.write("/tf", time, tf)
