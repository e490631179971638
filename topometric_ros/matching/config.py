"""Parameters of room matching: descriptors, context, growing and the choice of hypotheses."""

from __future__ import annotations

from dataclasses import dataclass, field

from topometric_ros.configuration import needs_extras, parameter
from topometric_ros.errors import ConfigurationError

DESCRIPTORS = ("engineered", "spectral", "shape", "topological", "learned")
"""Names of the descriptors that there are; see :mod:`topometric_ros.matching.descriptors`."""


@dataclass(frozen=True)
class DescriptorConfig:
    """What describes a room's geometry (thesis §4.3.1-4.3.3)."""

    names: tuple[str, ...] = parameter(
        ("shape",),
        "Descriptors of a room to compute and to compare; learned takes the extra `learned`.",
        choices=DESCRIPTORS,
        count=(1, None),
        rule=needs_extras({"learned": ("onnxruntime", "learned")}),
    )
    box: str = parameter(
        "oriented",
        "Bounding box of the engineered sizes: the smallest upright one, which turns with the "
        "room, or the axis-aligned one of the draft.",
        choices=("oriented", "axis_aligned"),
    )
    roughness_neighbours: int = parameter(
        12, "Nearest neighbours that a plane is fitted through for the roughness.", minimum=4
    )
    matrix: str = parameter(
        "laplacian",
        "Matrix of the room's neighbourhood graph whose eigenvalues are taken.",
        choices=("laplacian", "adjacency"),
    )
    neighbourhood: str = parameter(
        "moore",
        "Neighbours of a voxel in the neighbourhood graph: von_neumann (6) or moore (26).",
        choices=("von_neumann", "moore"),
    )
    eigenvalues: int = parameter(
        32,
        "Number of non-zero eigenvalues of the neighbourhood graph that are kept.",
        minimum=1,
        maximum=64,
    )
    spectral_cell: float = parameter(
        0.3,
        "Edge of the cells of the neighbourhood graph, at least a voxel.",
        unit="m",
        minimum=0.02,
    )
    spectral_nodes: int = parameter(
        5000, "Cells are doubled until a room has no more of them than this.", minimum=100
    )


@dataclass(frozen=True)
class ContextConfig:
    """How the neighbourhood enters a room's descriptor (§4.3.5).

    By default it does not: partial maps see different neighbours of the same room, and on the
    development pairs the assignment was right for 27 % of its matches without, 23 % with one step
    of eq. 48. Growing uses the neighbourhood anyway.
    """

    kind: str = parameter(
        "none",
        "none; convolution: neighbours' descriptors added (eq. 48); merged: the descriptor of the "
        "merged geometry of the room and its neighbours appended.",
        choices=("none", "convolution", "merged"),
    )
    weight: float = parameter(0.25, "Weight w of a neighbour in eq. 48.", minimum=0.0, maximum=10.0)
    steps: int = parameter(1, "Number of steps t of eq. 48.", minimum=0, maximum=10)


@dataclass(frozen=True)
class GrowingConfig:
    """How hypotheses grow from a first match (§4.3.6)."""

    cost_max: float = parameter(
        1.3,
        "c_max: matches at a larger distance in feature space do not join a hypothesis.",
        minimum=0.0,
    )
    error_increase_max: float = parameter(
        0.5,
        "Δe_max: largest increase of the mean centroid error that a new match may bring.",
        unit="m",
        minimum=0.0,
    )
    seeds_per_room: int = parameter(
        3,
        "Besides the assignment, each room's nearest rooms in feature space that seed a "
        "hypothesis; 0: the assignment only.",
        minimum=0,
        maximum=50,
    )
    passages: bool = parameter(
        True,
        "Register the passages between matched rooms and the heights of their floors as well as "
        "the rooms' centroids.",
    )


@dataclass(frozen=True)
class ChoiceConfig:
    """Which hypotheses are proposed (§4.3.6, last paragraph)."""

    rule: str = parameter(
        "many",
        "thesis: the one that clustering leaves; many: the best distinct ones, for the geometric "
        "check to decide.",
        choices=("thesis", "many"),
    )
    candidates: int = parameter(
        12, "Largest number of transforms proposed under the rule many.", minimum=1, maximum=200
    )
    distance: float = parameter(
        1.0, "Mean displacement below which two hypotheses are the same.", unit="m", minimum=0.0
    )


@dataclass(frozen=True)
class MatchingConfig:
    """All of room matching."""

    descriptors: DescriptorConfig = field(default_factory=DescriptorConfig)
    context: ContextConfig = field(default_factory=ContextConfig)
    growing: GrowingConfig = field(default_factory=GrowingConfig)
    choice: ChoiceConfig = field(default_factory=ChoiceConfig)
    distance: str = parameter(
        "learned",
        "Distance of two rooms in feature space. standardised: each number by its deviation over "
        "both maps (eq. 50); learned: of the descriptor shape by how much one room differs from "
        "agent to agent, the others standardised.",
        choices=("learned", "standardised"),
    )
    alone: float = parameter(
        0.5,
        "Assignment leaves rooms without a partner rather than match two that are farther apart in "
        "feature space.",
        minimum=0.0,
    )
    smallest_room: float = parameter(
        1.0, "Rooms that cover less floor are not matched.", unit="m²", minimum=0.0
    )


def matching_preset(name: str) -> MatchingConfig:
    """Return the parameters of room matching under a preset, `default` or `thesis`.

    Raises
    ------
    ConfigurationError
        Unknown preset.
    """
    if name == "default":
        return MatchingConfig()
    if name == "thesis":
        return MatchingConfig(
            descriptors=DescriptorConfig(
                names=("spectral",), box="axis_aligned", neighbourhood="von_neumann"
            ),
            context=ContextConfig(kind="convolution", weight=0.5, steps=1),
            growing=GrowingConfig(
                cost_max=1e6, error_increase_max=2.5, seeds_per_room=0, passages=False
            ),
            choice=ChoiceConfig(rule="thesis"),
            distance="standardised",
            alone=1e6,
            smallest_room=0.0,
        )
    raise ConfigurationError(f"unknown preset {name!r}; known: default, thesis")
