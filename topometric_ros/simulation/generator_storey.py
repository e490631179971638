"""One block of one storey: designs laid out along corridors become areas, openings and links."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from topometric_ros.simulation.building import Area, Box, Opening
from topometric_ros.simulation.generator_layouts import Layout, Rectangle, Strip
from topometric_ros.simulation.generator_rooms import Design, Piece
from topometric_ros.simulation.labelled import join_rings
from topometric_ros.simulation.outlines import inset, trace_outlines

STAIRS_WIDTH = 2.8
_STEPS = 8
"""Steps of each of the two flights between two storeys."""
_LANDING = 1.2
_TREAD_THICKNESS = 0.2


@dataclass
class Block:
    """What becomes walls, openings and rooms; filled in room by room, ids from 0."""

    kinds: list[str] = field(default_factory=list)
    areas: list[Area] = field(default_factory=list)
    openings: list[Opening] = field(default_factory=list)
    links: list[tuple[int, int, str, tuple[float, float], float]] = field(default_factory=list)
    """First room, second room, kind, position, width."""
    pieces: list[Piece] = field(default_factory=list)

    def add_room(self, kind: str, *rectangles: Rectangle) -> int:
        """Add a room and return its id."""
        self.kinds.append(kind)
        self.areas += [Area(len(self.kinds) - 1, rectangle) for rectangle in rectangles]
        return len(self.kinds) - 1

    def join(
        self, rooms: tuple[int, int], kind: str, position: tuple[float, float], width: float
    ) -> None:
        """Put a hole into the wall between two rooms."""
        self.openings.append(Opening("door", position, width))
        self.links.append((*rooms, kind, position, width))


def lay_out(
    layout: Layout, designs: list[list[Design]], stairs: bool, joined: set[tuple[int, int]]
) -> Block:
    """Return the block of a layout: the corridor is room 0, the stairs, if any, room 1.

    Parameters
    ----------
    designs : of each strip, in its order; the stairs take the beginning of the first strip
    joined : (strip, place) of rooms with a door to the next one of their strip
    """
    block = Block()
    corridor = block.add_room("corridor", *layout.corridor)
    for s, (strip, row) in enumerate(zip(layout.strips, designs, strict=True)):
        u = 0.0
        if stairs and s == 0:
            well = block.add_room("stairs", strip.rectangle(0.0, 0.0, STAIRS_WIDTH, strip.depth))
            block.join((corridor, well), "door", strip.at(STAIRS_WIDTH / 2, 0.0), 1.1)
            u = STAIRS_WIDTH
        before = -1
        for i, design in enumerate(row):
            room = _add_room(block, strip, u, design, corridor)
            if (s, i - 1) in joined:
                block.join((before, room), "door", strip.at(u, 0.75), 0.8)
            before, u = room, u + design.width
    return block


def room_polygon(rectangles: list[Rectangle], wall: float) -> NDArray[np.float64]:
    """Return the inner faces of the walls round a room of several rectangles: (K, 2), m."""
    lines = [np.unique([r[axis + side] for r in rectangles for side in (0, 2)]) for axis in (0, 1)]
    middles = [(line[1:] + line[:-1]) / 2 for line in lines]
    x, y = np.meshgrid(*middles, indexing="ij")
    cells = np.zeros(x.shape, dtype=bool)
    for x0, y0, x1, y1 in rectangles:
        cells |= (x0 < x) & (x < x1) & (y0 < y) & (y < y1)
    rings = []
    for ring in trace_outlines(cells):
        corners = [line[ring[:, axis].astype(int)] for axis, line in enumerate(lines)]
        rings.append(inset(np.column_stack(corners), wall / 2))
    return join_rings(rings)


def flights(strip: Strip, height: float, wall: float) -> list[Box]:
    """Return the two flights, and the landing between them, that lead up `height` m."""
    run = (strip.depth - wall / 2 - 2 * _LANDING) / _STEPS
    middle, rise = STAIRS_WIDTH / 2, height / (2 * _STEPS)
    turn = _LANDING + _STEPS * run
    boxes = [_slab(strip, (0.0, turn, STAIRS_WIDTH, strip.depth), height / 2)]
    for k in range(_STEPS):
        up, down = _LANDING + k * run, turn - k * run
        top = (k + 1) * rise
        boxes.append(_slab(strip, (wall / 2, up, middle - 0.05, up + run), top))
        right = (middle + 0.05, down - run, STAIRS_WIDTH - wall / 2, down)
        boxes.append(_slab(strip, right, height / 2 + top))
    return boxes


def landing(strip: Strip) -> Box:
    """Return the floor between the door and the stairs, where there is no other."""
    return _slab(strip, (0.0, 0.0, STAIRS_WIDTH, _LANDING), 0.0)


def half_landing(strip: Strip) -> tuple[float, float]:
    """Return the middle of the landing between two flights."""
    return strip.at(STAIRS_WIDTH / 2, strip.depth - _LANDING / 2)


def _add_room(block: Block, strip: Strip, u: float, design: Design, corridor: int) -> int:
    """Add a room of a strip that begins at u, with what it has."""
    end, depth = u + design.width, strip.depth
    if design.cut is None:
        room = block.add_room(design.kind, strip.rectangle(u, 0.0, end, depth))
    else:
        left, right, deep = design.cut
        rest = (u + right, end) if left == 0.0 else (u, u + left)
        room = block.add_room(
            design.kind,
            strip.rectangle(rest[0], 0.0, rest[1], deep),
            strip.rectangle(u, deep, end, depth),
        )
        small = block.add_room("cut out", strip.rectangle(u + left, 0.0, u + right, deep))
        block.join((room, small), "door", strip.at(u + (left + right) / 2, deep), 0.8)
    block.join((corridor, room), design.link, strip.at(u + design.door, 0.0), design.door_width)
    for middle, width in design.windows:
        block.openings.append(Opening("window", strip.at(u + middle, depth), width))
    for piece in design.pieces:
        block.pieces.append(tuple(_placed(strip, u, box) for box in piece))
    return room


def _placed(strip: Strip, u: float, box: Box) -> Box:
    """Return a box of a design in the storey's frame."""
    x0, y0, x1, y1 = strip.rectangle(u + box.lower[0], box.lower[1], u + box.upper[0], box.upper[1])
    return Box((x0, y0, box.lower[2]), (x1, y1, box.upper[2]))


def _slab(strip: Strip, place: Rectangle, top: float) -> Box:
    x0, y0, x1, y1 = strip.rectangle(*place)
    return Box((x0, y0, top - _TREAD_THICKNESS), (x1, y1, top))
