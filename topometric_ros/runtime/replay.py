"""Replay: the extractors' and the merger's code over recorded bags, in time order, without ROS.

Everything depends on the bags and the configuration alone: stamps come from the messages, session
ids from the seed, so that two replays write the same bytes.
"""

from __future__ import annotations

import dataclasses
import heapq
import logging
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from topometric_ros.alignment import MergeResult
from topometric_ros.errors import TopometricError
from topometric_ros.extraction.quality import Quality
from topometric_ros.io.bags import BagError, BagMessage, is_bag
from topometric_ros.io.trajectories import AgentTrajectory
from topometric_ros.runtime.bag_input import BagInput
from topometric_ros.runtime.bag_sources import (
    BagSource,
    bag_sources,
    parse_source,
    require_distinct,
)
from topometric_ros.runtime.config import ToolConfig
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.replay_output import ReplayOutput
from topometric_ros.runtime.sources import InputOptions, bag_input
from topometric_ros.stopwatch import Stopwatch
from topometric_ros.topometric_map import TopometricMap

logger = logging.getLogger(__name__)

_SECOND = 1_000_000_000


@dataclass(frozen=True)
class Replayed:
    """What a replay came to: the final result, the agents' final maps and CPU seconds by stage.

    `trajectories` are those of the agents whose bags hold scans, each in its own map's frame;
    `qualities` are the reports of the agents whose maps were extracted here.
    """

    result: MergeResult
    maps: tuple[TopometricMap, ...]
    timings: dict[str, float]
    trajectories: tuple[AgentTrajectory, ...] = ()
    qualities: Mapping[str, Quality] = field(default_factory=dict)


def find_agents(texts: Sequence[str]) -> list[BagSource]:
    """Return the agents that the words of the command line name, in order.

    Raises
    ------
    TopometricError
        A bag cannot be read or holds nothing to use, or two agents have one name.
    """
    found: list[BagSource] = []
    for text in texts:
        source = parse_source(text)
        if source.path.exists() and not is_bag(source.path):
            raise BagError(f"{source.path}: not a bag: expected a directory, .mcap or .db3 file")
        found += bag_sources(source)
    require_distinct(found)
    return found


def replay(
    sources: Sequence[BagSource],
    folder: Path,
    config: ToolConfig,
    options: InputOptions,
    *,
    every: float = 0.0,
    progress: Callable[[str], None],
) -> Replayed:
    """Play bags into one extractor an agent and a merger, and write `folder/bag`.

    Parameters
    ----------
    sources : the agents, see :func:`find_agents`; the first is the anchor
    folder : existing directory
    every : s of recorded time between extractions of an agent; 0: at the end only
    progress : told in words what is being done

    Raises
    ------
    TopometricError
        An agent's input holds nothing to use or no map can be made of it.
    """
    run = _Replay(sources, config, options, progress)
    with ReplayOutput(folder / "bag", [source.agent for source in sources]) as output:
        return run.play(output, round(every * _SECOND))


class _Replay:
    """The state of a replay in progress."""

    def __init__(
        self,
        sources: Sequence[BagSource],
        config: ToolConfig,
        options: InputOptions,
        progress: Callable[[str], None],
    ) -> None:
        self._inputs = [bag_input(source, config, options) for source in sources]
        self._merger = MergerSession(config.merge, [source.agent for source in sources])
        self._progress = progress
        self._watch = Stopwatch()
        self._qualities: dict[str, Quality] = {}
        self._due: dict[str, int] = {}
        self._now = 0

    def play(self, output: ReplayOutput, every: int) -> Replayed:
        for reader in self._inputs:
            self._progress(f"reading transforms of {reader.source.agent}")
            reader.load_transforms()
        for entry, reader in self._in_time_order():
            self._now = entry.time
            reader.take(entry)
            agent = reader.source.agent
            if every and self._now >= self._due.setdefault(agent, self._now + every):
                self._due[agent] = self._now + every
                self._update(reader, output)
        for reader in self._inputs:
            reader.require_input()
            self._add(self._final_map(reader), reader, output)
        result = self._merge(output)
        maps = tuple(self._merger.maps[agent.id] for agent in result.agents)
        ways = [reader.agent_input.session.trajectory for reader in self._inputs]
        known = tuple(way for way in ways if way)
        return Replayed(result, maps, self._watch.seconds, known, self._qualities)

    def _in_time_order(self) -> Iterator[tuple[BagMessage, BagInput]]:
        """Yield the messages of all sources; at one time the earlier source comes first."""

        def tagged(index: int, reader: BagInput) -> Iterator[tuple[int, int, BagMessage]]:
            for entry in reader.messages():
                yield entry.time, index, entry

        streams = [tagged(index, reader) for index, reader in enumerate(self._inputs)]
        for _, index, entry in heapq.merge(*streams, key=lambda item: item[:2]):
            yield entry, self._inputs[index]

    def _update(self, reader: BagInput, output: ReplayOutput) -> None:
        """Extract and merge in between; what cannot be done yet is left to the end."""
        if reader.map is None and not reader.agent_input.session.has_input:
            return
        try:
            self._add(self._final_map(reader), reader, output)
            self._merge(output)
        except TopometricError as error:
            logger.info("%s: not yet: %s", reader.source.agent, error)

    def _final_map(self, reader: BagInput) -> TopometricMap:
        """Return the newest map of an agent: recorded, or extracted from what was received."""
        agent = reader.source.agent
        if reader.map is not None:
            return dataclasses.replace(reader.map, agent=agent)
        self._progress(f"extracting {agent}")
        result = reader.agent_input.session.extract()
        self._watch.add(result.timings)
        self._qualities[agent] = result.quality
        warnings = (*reader.warnings(), *result.map.warnings)
        return dataclasses.replace(result.map, warnings=warnings)

    def _add(self, m: TopometricMap, reader: BagInput, output: ReplayOutput) -> None:
        if self._merger.add_map(m, reader.source.text):
            output.write_map(m, self._now)

    def _merge(self, output: ReplayOutput) -> MergeResult:
        result = self._merger.merge(self._progress)
        self._watch.add(result.timings)
        output.write_result(self._merger, self._now)
        return result
