"""Parameters of merging: every stage's configuration in one, and the two presets."""

from __future__ import annotations

from dataclasses import dataclass, field

from topometric_ros.configuration import parameter
from topometric_ros.errors import ConfigurationError
from topometric_ros.fusion.consensus import ConsensusConfig
from topometric_ros.fusion.fuse import FuseConfig
from topometric_ros.fusion.gates import VerificationConfig
from topometric_ros.fusion.groups import GroupsConfig
from topometric_ros.fusion.priors import parse_priors
from topometric_ros.fusion.registration import RegistrationConfig
from topometric_ros.matching.config import MatchingConfig, matching_preset
from topometric_ros.matching.search import SearchConfig

SOURCES = ("rooms", "search")
"""Where candidate poses may come from."""


@dataclass(frozen=True)
class MergeConfig:
    """From topometric maps to one global map."""

    sources: tuple[str, ...] = parameter(
        SOURCES,
        "Where candidate poses come from: rooms (matched rooms), search (storey rasters).",
        choices=SOURCES,
        count=(1, None),
    )
    check: str = parameter(
        "rivals",
        "rivals: accept a pose that passes every gate and that no other pose comes near to; gates: "
        "accept the best hypothesis of matched rooms where it passes the gates once registered; "
        "none: believe it, as the draft does.",
        choices=("rivals", "gates", "none"),
    )
    refined_rooms: int = parameter(
        6, "Candidates from matched rooms that are refined and judged.", minimum=1, maximum=100
    )
    refinement: str = parameter(
        "surface",
        "Fine registration: surface, of all that both maps share; consensus, of each matched room, "
        "and the mean of those that agree (thesis §4.4).",
        choices=("surface", "consensus"),
    )
    largest_correction: float = parameter(
        0.5,
        "Registration that moves a verified pose farther than this has slid off; it is rejected.",
        unit="m",
        minimum=0.0,
    )
    largest_stretch: float = parameter(
        0.03,
        "Share by which one map may be larger than the other, as the surfaces that both hold tell.",
        minimum=0.001,
        maximum=1.0,
    )
    room_part: float = parameter(
        0.05,
        "Where a map splits a room of the other, every piece is matched that shares this much of "
        "the smaller of the two rooms; 1: one room to one.",
        minimum=0.0,
        maximum=1.0,
    )
    priors: tuple[str, ...] = parameter(
        (),
        "What is known beforehand of how agents lie to each other, a line of YAML each, as "
        "'{between: [a, b], position: [12, 3, 0], yaw: 90, sigma: 1.5, yaw_sigma: 15}' "
        "(m, degrees).",
        rule=parse_priors,
    )
    global_frame: str = parameter("global", "Name of the global map's frame.")
    matching: MatchingConfig = field(default_factory=MatchingConfig)
    search: SearchConfig = field(default_factory=SearchConfig)
    verification: VerificationConfig = field(default_factory=VerificationConfig)
    registration: RegistrationConfig = field(default_factory=RegistrationConfig)
    consensus: ConsensusConfig = field(default_factory=ConsensusConfig)
    groups: GroupsConfig = field(default_factory=GroupsConfig)
    fuse: FuseConfig = field(default_factory=FuseConfig)


def merge_preset(name: str) -> MergeConfig:
    """Return the parameters of merging under a preset, `default` or `thesis`.

    The draft believes its best hypothesis whatever it is. The preset `thesis` takes the draft's
    steps, but a transform that the geometry contradicts is refused; `check="none"` is the draft.

    Raises
    ------
    ConfigurationError
        Unknown preset.
    """
    if name == "default":
        return MergeConfig()
    if name == "thesis":
        return MergeConfig(
            sources=("rooms",),
            check="gates",
            room_part=1.0,
            refinement="consensus",
            consensus=ConsensusConfig(joint=False),
            matching=matching_preset("thesis"),
            # It has no rivals to compare with, so the walls alone must fix the position.
            verification=VerificationConfig(smallest_eigenvalue=2.5, slide_cost=2.0),
        )
    raise ConfigurationError(f"unknown preset {name!r}; known: default, thesis")
