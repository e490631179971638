"""From a word on the command line to a topometric map: clouds, bags and map files alike."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from topometric_ros.extraction.errors import ExtractionError
from topometric_ros.extraction.quality import Quality
from topometric_ros.io.bags import is_bag
from topometric_ros.io.clouds import read_cloud, up_rotation
from topometric_ros.io.map_files import load_map, map_file_of
from topometric_ros.io.trajectories import AgentTrajectory, trajectory_of
from topometric_ros.runtime.agent_input import AgentInput
from topometric_ros.runtime.bag_input import BagInput
from topometric_ros.runtime.bag_sources import (
    BagSource,
    Source,
    SourceError,
    one_bag_source,
    parse_source,
    readable,
    require_distinct,
)
from topometric_ros.runtime.config import ToolConfig
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.runtime.extractor_session import ExtractorSession
from topometric_ros.topometric_map import TopometricMap

MAP_SUFFIX = ".tmap"


@dataclass(frozen=True)
class InputOptions:
    """How inputs are to be read: the axis that points up, the mode, the map's frame, the seed.

    `scale` is the length in m of the unit that cloud files are in; bags and maps are in metres.
    """

    up: str = "z"
    mode: str = "auto"
    map_frame: str = ""
    seed: int = 0
    scale: float = 1.0


@dataclass(frozen=True)
class LoadedMap:
    """One source's map; where it was extracted, `timings` holds CPU seconds by stage.

    `trajectory` says where the agent was, in the frame of the source's points, where that is known;
    `quality` is the report of the extraction.
    """

    map: TopometricMap
    source: str
    timings: dict[str, float] = field(default_factory=dict)
    trajectory: AgentTrajectory | None = None
    quality: Quality | None = None


def _silent(_: str) -> None:
    """Report no progress."""


def load_sources(
    texts: Sequence[str],
    config: ToolConfig,
    options: InputOptions | None = None,
    progress: Callable[[str], None] = _silent,
) -> list[LoadedMap]:
    """Return the map of every source, in their order.

    Parameters
    ----------
    texts : clouds, `BAG:topic`, .tmap files or output folders that hold one, each with `ID=` before
        it where the agent's name is not to be the map's, the topic's namespace or the file's stem
    config : of the extraction and of the descriptors, see `runtime.config.load_config`
    options : how to read them
    progress : called with a word on what is being done

    Raises
    ------
    TopometricError
        A source cannot be read, or two of them have one name.
    """
    options = options or InputOptions()
    return [load_source(source, config, options, progress) for source in named_sources(texts)]


def named_sources(texts: Sequence[str]) -> list[Source]:
    """Return every source with its agent's id, all distinct; raises as :func:`load_sources`."""
    sources = [_named(_opened(parse_source(text))) for text in texts]
    require_distinct(sources)
    return sources


def load_source(
    source: Source,
    config: ToolConfig,
    options: InputOptions,
    progress: Callable[[str], None],
) -> LoadedMap:
    """Return the map of one source; raises TopometricError as :func:`load_sources`."""
    is_map = source.path.suffix.lower() == MAP_SUFFIX
    if options.scale != 1.0 and (is_map or is_bag(source.path)):
        raise SourceError(f"{source.text}: --scale is for cloud files; bags and maps are in metres")
    if is_map:
        m = load_map(source.path)
        agent = source.agent or m.agent
        way = _trajectory_beside(source.path, m.agent, agent)
        return LoadedMap(dataclasses.replace(m, agent=agent), source.text, trajectory=way)
    if is_bag(source.path):
        return load_bag_source(one_bag_source(source), config, options, progress)
    if source.topic is not None:
        missing = "a cloud file has no topics" if source.path.exists() else "no such file"
        raise SourceError(f"{source.text}: {missing}")
    progress(f"reading {source.path}")
    cloud = read_cloud(source.path, options.up, options.scale)
    agent = source.agent or readable(source.path.stem)
    way = _trajectory_beside(source.path, source.path.stem, agent)
    progress(f"extracting {agent} ({len(cloud.points):,} points)")
    try:
        result = extract_map(
            cloud.points,
            config.extraction,
            config.merge.matching,
            T_up_input=cloud.T_up_input,
            warnings=cloud.warnings,
            agent=agent,
            session=session_id(options.seed, agent, 0),
            sequence=1,
            way=None if way is None else way.positions @ cloud.T_up_input[:3, :3].T,
        )
    except ExtractionError as error:
        raise SourceError(f"{source.text}: {error}") from error
    return LoadedMap(result.map, source.text, result.timings, way, result.quality)


def load_bag_source(
    source: BagSource,
    config: ToolConfig,
    options: InputOptions,
    progress: Callable[[str], None],
) -> LoadedMap:
    """Play one agent's bag to its end and return the map; raises TopometricError."""
    reader = bag_input(source, config, options)
    progress(f"reading {source.text}")
    reader.load_transforms()
    for entry in reader.messages():
        reader.take(entry)
    reader.require_input()
    if reader.map is not None:
        return LoadedMap(dataclasses.replace(reader.map, agent=source.agent), source.text)
    progress(f"extracting {source.agent}")
    try:
        result = reader.agent_input.session.extract()
    except ExtractionError as error:
        raise SourceError(f"{source.text}: {error}") from error
    m = dataclasses.replace(result.map, warnings=(*reader.warnings(), *result.map.warnings))
    way = reader.agent_input.session.trajectory
    return LoadedMap(m, source.text, result.timings, way, result.quality)


def bag_input(source: BagSource, config: ToolConfig, options: InputOptions) -> BagInput:
    """Return a bag's source with a session of its own."""
    count = iter(range(1 << 30))
    session = ExtractorSession(
        source.agent,
        config.extraction,
        config.merge.matching,
        lambda: session_id(options.seed, source.agent, next(count)),
        up_rotation(options.up),
    )
    return BagInput(source, AgentInput(session, options.mode, options.map_frame))


def session_id(seed: int, agent: str, count: int) -> str:
    """Return a session's id that depends on nothing but these: 12 hexadecimal digits."""
    return hashlib.sha256(f"{seed}/{agent}/{count}".encode("utf-8", "replace")).hexdigest()[:12]


def _trajectory_beside(path: Path, name: str, agent: str) -> AgentTrajectory | None:
    """Return the trajectory of `name` that lies beside a file, as that of `agent`."""
    found = trajectory_of(path, name)
    return None if found is None else dataclasses.replace(found, agent=agent)


def _opened(source: Source) -> Source:
    """Return the map file in the place of the output folder that holds it."""
    held = map_file_of(source.path)
    return source if held is None else dataclasses.replace(source, path=held)


def _named(source: Source) -> Source:
    """Return the source with its agent's id: as given, else the map's or topic's, else the stem."""
    if source.agent is not None:
        return source
    if source.path.suffix.lower() == MAP_SUFFIX:
        return dataclasses.replace(source, agent=load_map(source.path).agent or source.path.stem)
    if is_bag(source.path):
        return dataclasses.replace(source, agent=one_bag_source(source).agent)
    return dataclasses.replace(source, agent=readable(source.path.stem))
