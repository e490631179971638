"""What the nodes themselves can be told; the stages' own parameters stand beside these.

Free of rclpy, so that the reference and the YAML files are made where ROS is not installed.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from topometric_ros.configuration import parameter
from topometric_ros.errors import ConfigurationError
from topometric_ros.extraction.config import PRESETS
from topometric_ros.matching.config import DescriptorConfig
from topometric_ros.nodes.agent_names import parse_agents
from topometric_ros.runtime.bag_sources import SourceError, require_name


def _name_or_nothing(agent: str) -> None:
    """Refuse a name that no file or topic could carry."""
    try:
        require_name(agent or "agent")
    except SourceError as error:
        raise ConfigurationError(str(error)) from error


@dataclass(frozen=True)
class DescribingConfig:
    """The part of the matching's parameters that describes rooms: set it alike in every node."""

    descriptors: DescriptorConfig = field(default_factory=DescriptorConfig)


@dataclass(frozen=True)
class ExtractorNodeConfig:
    """The extractor's input, identity and pace."""

    agent: str = parameter(
        "", "Short id of the agent; empty: the node's namespace.", rule=_name_or_nothing
    )
    preset: str = parameter(
        "default", "Defaults of all parameters of the extraction.", choices=PRESETS
    )
    mode: str = parameter(
        "auto",
        "Whether clouds are whole maps or single scans to be placed by /tf; auto: a cloud whose "
        "frame has a parent on /tf is a scan.",
        choices=("auto", "map", "scan"),
    )
    cloud_qos: str = parameter(
        "auto",
        "Reliability and durability of the cloud subscription; auto: the strongest that all "
        "publishers present offer.",
        choices=("auto", "reliable", "best_effort"),
    )
    map_frame: str = parameter(
        "",
        "Frame of the map that scans are placed in; empty: the one named map, or /tf's root.",
    )
    global_frame: str = parameter(
        "global",
        "Frame that the merger puts above the agents' map frames; transforms below it are ignored, "
        "so that no agent's map moves into it.",
    )
    max_rate: float = parameter(
        0.5, "Extractions a second at most.", unit="Hz", minimum=0.001, maximum=100.0
    )
    min_change: float = parameter(
        0.002,
        "A map is extracted again only when this share of its voxels came or went since the last.",
        minimum=0.0,
        maximum=1.0,
    )
    mean_points: bool = parameter(
        True,
        "Publish to a quarter of a voxel where in it the surface lies; without, for thin links, a "
        "message is 0.7 to 2 % of its cloud, not 2 to 4 %, and transforms are off by 1 to 6 cm.",
    )
    scan_queue: int = parameter(
        200,
        "Scans that may wait, for a running extraction or for /tf; then the oldest are dropped.",
        minimum=1,
        maximum=100_000,
    )
    tf_timeout: float = parameter(
        5.0,
        "How long a scan waits for its transform; then it is skipped and the missing frame named.",
        unit="s",
        minimum=0.1,
        maximum=100_000.0,
    )
    sensor_frame: str = parameter(
        "",
        "Frame of the sensor, from which scans clear what they look through; empty: the clouds' "
        "own frame, and clouds in the map's frame clear nothing.",
    )
    tf_history: float = parameter(
        120.0, "How far back transforms are kept.", unit="s", minimum=1.0, maximum=100_000.0
    )
    scans_file: str = parameter(
        "",
        "File that keeps what single scans came to across a restart of this node alone; written "
        "at the start, ever more rarely, down to once a minute, and at the end; one for each "
        "extractor. Empty: nothing is kept.",
    )
    matching: DescribingConfig = field(default_factory=DescribingConfig)


@dataclass(frozen=True)
class MergerNodeConfig:
    """The merger's agents, frames and pace."""

    agents: tuple[str, ...] = parameter(
        (),
        "Namespaces of the agents, in order; the first that has a map anchors the global frame. "
        "`id=namespace` where the two differ, `id=file.tmap` for a map of another day. Empty: the "
        "agents that are found.",
        rule=parse_agents,
    )
    discover: bool = parameter(
        False,
        "Listen as well to agents that are not listed: to every topic of a TopometricMap that is "
        "called `topometric_map`. They follow the listed ones in the order of their first maps.",
    )
    stale_after: float = parameter(
        15.0,
        "An agent whose extractor has been gone for so long is marked stale; its map is kept.",
        unit="s",
        minimum=1.0,
        maximum=1e6,
    )
    forget_after: float = parameter(
        0.0,
        "An agent whose extractor has been gone for so long leaves the global map; 0: never.",
        unit="s",
        minimum=0.0,
        maximum=1e7,
    )
    adopt: bool = parameter(
        True,
        "Take over, after a check against the maps, the alignments that another merger has "
        "latched on `alignments`: one that joins late need not find them all again.",
    )
    max_voxels: int = parameter(
        8_388_608,
        "Maps with more voxels, or raster cells in all their storeys, are refused unopened.",
        minimum=1000,
        maximum=67_108_864,
    )
    max_threads: int = parameter(
        2,
        "Pairs of maps that are aligned at the same time, each by a thread; 1 to spare the CPU.",
        minimum=1,
        maximum=64,
    )
    preset: str = parameter(
        "default", "Defaults of all parameters of the merging.", choices=PRESETS
    )
    max_rate: float = parameter(
        0.5,
        "How often alignments are published at most, and the global map beside them.",
        unit="Hz",
        minimum=0.001,
        maximum=100.0,
    )
    tf_rate: float = parameter(
        10.0, "Rate at which /tf is stamped anew.", unit="Hz", minimum=0.1, maximum=1000.0
    )
    grid_storey: int = parameter(
        -1,
        "Storey that `global_grid` shows, by its id; -1: the one of which most floor was seen.",
        minimum=-1,
        maximum=1000,
    )
    by_hand_sigma: float = parameter(
        0.1,
        "Standard deviation along each axis that is told of an alignment that was set by hand "
        "without a covariance; the merger itself then takes it as it is.",
        unit="m",
        minimum=0.001,
        maximum=100.0,
    )
    by_hand_turn_sigma: float = parameter(
        1.0,
        "Standard deviation of its turns about each axis.",
        unit="deg",
        minimum=0.01,
        maximum=180.0,
    )
    state_file: str = parameter(
        "",
        "File that keeps maps, alignments and what was set by hand across a restart; written when "
        "alignments are published, read at the start, one for each merger. Empty: nothing is kept.",
    )


@dataclass(frozen=True)
class PlayerNodeConfig:
    """What the player plays."""

    bag: str = parameter(
        "", "Bag to play: clouds, transforms and maps. Empty: a fleet is simulated."
    )
    building: str = parameter(
        "office:rooms=6", "Building of the simulated fleet, as `topometric simulate` takes it."
    )
    agents: int = parameter(
        2,
        "Agents of the simulated fleet; they are called robot1, robot2 and so on.",
        minimum=1,
        maximum=26,
    )
    overlap: float = parameter(
        0.5,
        "Share of the smaller map that two agents of it have in common, as near as it can be had.",
        minimum=0.0,
        maximum=1.0,
    )
    seed: int = parameter(0, "Seed of the simulated fleet.", minimum=0)
    clouds: str = parameter(
        "scans",
        "What the simulated agents publish: single scans with /tf, or growing maps.",
        choices=("scans", "maps"),
    )
    rate: float = parameter(
        1.0, "Recorded seconds that are played in a second.", minimum=0.01, maximum=1000.0
    )
    patience: float = parameter(
        60.0,
        "How long to wait until somebody listens to every cloud.",
        unit="s",
        minimum=0.0,
        maximum=1e6,
    )
