"""Buildings made from a seed: "office:seed=3,rooms=20,corridor=ring".

A main block and up to two wings, turned against it and joined to it by a lobby that is no
rectangle; every storey has the same corridors and its own rooms.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import flatten, parameter, with_values
from topometric_ros.errors import ConfigurationError
from topometric_ros.simulation.building import BuildingConfig, Opening
from topometric_ros.simulation.generator_assembly import Assembly
from topometric_ros.simulation.generator_layouts import Layout, make_layout
from topometric_ros.simulation.generator_rooms import (
    STYLES,
    Design,
    Style,
    design_room,
    divide,
    make_twins,
)
from topometric_ros.simulation.generator_storey import STAIRS_WIDTH, lay_out
from topometric_ros.simulation.generator_variants import make_alike, mirrored, refurnished
from topometric_ros.simulation.generator_wings import wing_frame
from topometric_ros.simulation.labelled import LabelledBuilding
from topometric_ros.yaml_text import load_yaml

_WING_SHARE = 0.3
"""Share of a storey's rooms in each wing."""
_ROWS = {"straight": 2, "L": 4, "ring": 6, "comb": 5}
"""Rows of rooms along the smallest corridor of each shape."""
_NEIGHBOURS_JOINED = 0.12
"""Share of neighbours in a strip with a door between them."""


@dataclass(frozen=True)
class GeneratorConfig:
    """What a building made from a seed is like."""

    kind: str = parameter(
        "office", "Sizes and furniture of which sort of building.", choices=tuple(STYLES)
    )
    seed: int = parameter(0, "Draws everything that is not given here.", minimum=0)
    rooms: int = parameter(
        0,
        "Rooms along the corridors of all storeys, without the small ones cut out of them; "
        "0: on each storey office 12, home 7, hospital 20, more with wings.",
        minimum=0,
        maximum=5000,
    )
    corridor: str = parameter(
        "straight", "Shape of the corridor.", choices=("straight", "L", "ring", "comb")
    )
    storeys: int = parameter(1, "Storeys, joined by stairs.", minimum=1, maximum=20)
    twins: int = parameter(
        0, "Pairs of identical neighbours on each storey, as far as there are.", minimum=0
    )
    wings: int = parameter(0, "Wings turned against the main block.", minimum=0, maximum=2)
    angle: float = parameter(
        30.0, "Angle between a wing and the main block.", unit="deg", minimum=-60.0, maximum=60.0
    )
    cut: float = parameter(
        0.3, "Share of larger rooms with a small room cut out of a corner.", minimum=0, maximum=1
    )
    furniture: float = parameter(0.8, "Share of the furniture kept.", minimum=0.0, maximum=1.0)
    windows: bool = parameter(True, "Holes in outer walls; a lidar does not see glass.")
    alike: float = parameter(
        0.0, "Share of the rooms of each row that are copies of one; all of a row are then "
        "equally wide.", minimum=0.0, maximum=1.0,
    )  # fmt: skip
    stacked: bool = parameter(False, "Every storey has the rooms of the lowest.")
    furnished: int = parameter(
        0, "Other numbers furnish the same rooms anew, every storey its own way.", minimum=0
    )
    mirrored: bool = parameter(False, "The mirror image of the whole building.")
    ceiling: float = parameter(2.7, "Height of the rooms.", unit="m", minimum=2.3, maximum=6.0)


def is_generated(spec: str) -> bool:
    """Return whether a building's name is one of the generator's."""
    return spec.split(":", 1)[0] in STYLES


def parse_generator(spec: str) -> GeneratorConfig:
    """Return the configuration that "kind:name=value,..." says.

    Raises
    ------
    ConfigurationError
        A name is unknown or a value out of range.
    """
    kind, _, rest = spec.partition(":")
    values = {}
    for item in filter(None, rest.split(",")):
        name, equals, value = item.partition("=")
        if not equals:
            raise ConfigurationError(f"{spec}: expected name=value, got {item!r}")
        try:
            values[name.strip()] = load_yaml(value)
        except ConfigurationError as error:
            raise ConfigurationError(f"{spec}: {name}: {error}") from error
    return with_values(GeneratorConfig(), {**values, "kind": kind})


def generate(config: GeneratorConfig) -> LabelledBuilding:
    """Return the building of a configuration; the same one for the same configuration.

    Raises
    ------
    ConfigurationError
        There are fewer rooms than parts of the building to put them in.
    """
    style = STYLES[config.kind]
    counts = _rooms_of_blocks(config, style)
    layouts = _layouts(config, style, [max(column) for column in zip(*counts, strict=True)])
    heights = BuildingConfig(ceiling=config.ceiling)
    assembly = Assembly(_name(config), heights, config.storeys)
    for storey, row in enumerate(counts):
        rng = np.random.default_rng((config.seed, 0 if config.stacked else storey))
        furniture = np.random.default_rng((config.furnished, config.seed, storey))
        corridors = []
        for k, (layout, count) in enumerate(zip(layouts, row, strict=True)):
            stairs = config.storeys > 1 and k == 0
            designs = _designs(layout, count, stairs, config, style, rng)
            joined = _doors_between(designs, rng)
            if config.furnished:
                designs = refurnished(designs, style, config.furniture, furniture)
            block = lay_out(layout, designs, stairs, joined)
            block.kinds = [style.small if kind == "cut out" else kind for kind in block.kinds]
            frame = None
            if k > 0:
                port = layouts[0].ports[k - 1]
                frame = wing_frame(port, style.depth, style.corridor, math.radians(config.angle))
                position = layout.ports[1].position
                block.openings.append(_hole(position, style.corridor))
            else:
                block.openings += [
                    _hole(port.position, style.corridor) for port in layout.ports[: config.wings]
                ]
            stair_strip = layout.strips[0] if stairs else None
            corridors.append(assembly.add_block(block, storey, frame, stair_strip))
            if frame is not None:
                assembly.add_lobby(frame, storey, (corridors[0], corridors[k]))
    building = assembly.finish()
    return mirrored(building) if config.mirrored else building


def _name(config: GeneratorConfig) -> str:
    """Return kind, corridor, seed and then what else is not as usual: office_ring_3_rooms40."""
    usual = flatten(GeneratorConfig(kind=config.kind, corridor=config.corridor, seed=config.seed))
    changed = [f"_{name}{value}" for name, value in flatten(config).items() if value != usual[name]]
    return f"{config.kind}_{config.corridor}_{config.seed}" + "".join(changed)


def _rooms_of_blocks(config: GeneratorConfig, style: Style) -> list[list[int]]:
    """Return for each storey how many rooms the main block and each wing get."""
    needed = max(style.rooms, _ROWS[config.corridor] + config.wings)
    usual = math.ceil(needed / (1 - _WING_SHARE * config.wings))
    total = config.rooms or usual * config.storeys
    counts = []
    for storey in range(config.storeys):
        more = 0 if config.stacked else storey
        rooms = total // config.storeys + (more < total % config.storeys)
        wing = max(2, round(_WING_SHARE * rooms))
        counts.append([rooms - config.wings * wing] + config.wings * [wing])
    return counts


def _layouts(config: GeneratorConfig, style: Style, counts: list[int]) -> list[Layout]:
    """Return the corridors of the main block and of each wing, long enough for their rooms."""
    mean = sum(style.width) / 2
    frontage = max(counts[0], 1) * mean + (STAIRS_WIDTH if config.storeys > 1 else 0.0)
    sizes = (style.depth, style.corridor)
    main = make_layout(config.corridor, frontage, *sizes, config.wings)
    return [main] + [make_layout("straight", n * mean, *sizes, 1) for n in counts[1:]]


def _designs(
    layout: Layout,
    count: int,
    stairs: bool,
    config: GeneratorConfig,
    style: Style,
    rng: np.random.Generator,
) -> list[list[Design]]:
    """Return the rooms of each strip of a block; the first leaves room for the stairs."""
    lengths = _free_lengths(layout, stairs)
    if not _holds(layout, count, stairs):
        raise ConfigurationError(
            f"rooms: corridor {config.corridor}, {config.storeys} storeys and {config.wings} wings "
            f"need at least {_fewest(config, style)}, got {config.rooms}"
        )
    places = 1 + np.zeros(len(lengths), dtype=int)
    for _ in range(count - len(lengths)):
        places[np.argmax(lengths / (places + 0.5))] += 1
    options = (config.furniture, config.cut, config.windows)
    designs = []
    for strip, length, number in zip(layout.strips, lengths, places, strict=True):
        widths = divide(round(float(length), 3), int(number), rng)
        if config.alike > 0.0:
            widths = [float(length) / int(number)] * int(number)
        designs.append([design_room(style, w, strip.facade, options, rng) for w in widths])
    make_twins(designs, config.twins, rng)
    if config.alike > 0.0:
        make_alike(designs, config.alike, rng)
    return designs


def _free_lengths(layout: Layout, stairs: bool) -> NDArray[np.float64]:
    """Return how much of each strip of a block is for rooms, m."""
    lengths = np.array([strip.length for strip in layout.strips])
    lengths[0] -= STAIRS_WIDTH if stairs else 0.0
    return lengths


def _holds(layout: Layout, count: int, stairs: bool) -> bool:
    """Return whether a block has a room for each of its strips, and space for it."""
    lengths = _free_lengths(layout, stairs)
    return count >= len(lengths) and float(lengths.min()) >= 2.0


def _fewest(config: GeneratorConfig, style: Style) -> int:
    """Return the smallest number of rooms that a building of this shape can have."""

    def possible(rooms: int) -> bool:
        counts = _rooms_of_blocks(dataclasses.replace(config, rooms=rooms), style)
        layouts = _layouts(config, style, [max(column) for column in zip(*counts, strict=True)])
        stairs = [config.storeys > 1, *(False for _ in layouts[1:])]
        return all(all(map(_holds, layouts, row, stairs)) for row in counts)

    return next(filter(possible, itertools.count(1)))


def _doors_between(designs: list[list[Design]], rng: np.random.Generator) -> set[tuple[int, int]]:
    """Draw neighbours with a door between them; twins have none, it would tell them apart."""
    joined = set()
    for s, row in enumerate(designs):
        for i, (design, following) in enumerate(itertools.pairwise(row)):
            plain = design.cut is None and following.cut is None
            twins = {id(design), id(following)} & _repeated(row)
            if rng.random() < _NEIGHBOURS_JOINED and plain and not twins:
                joined.add((s, i))
    return joined


def _repeated(row: list[Design]) -> set[int]:
    """Return which designs a strip has twice."""
    identities = [id(design) for design in row]
    return {identity for identity in identities if identities.count(identity) > 1}


def _hole(position: tuple[float, float], width: float) -> Opening:
    """Return the opening at the end of a corridor."""
    return Opening("door", position, round(width - 0.4, 3))
