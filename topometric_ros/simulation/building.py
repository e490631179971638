"""Small buildings made of rectangles: rooms in, walls with doors and windows out.

A building is a list of rectangular areas; areas of the same room have no wall between them, so an
L-shaped corridor is two areas. Every other edge of an area becomes a wall, shared edges once.
Frame: metres, z up, floor at z = 0.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.errors import TopometricError


class BuildingError(TopometricError):
    """A building whose parts do not fit together."""


@dataclass(frozen=True)
class BuildingConfig:
    """Heights and thicknesses that every room of a building shares."""

    ceiling: float = parameter(2.7, "Height of the ceilings.", unit="m", minimum=2.0, maximum=10.0)
    wall: float = parameter(0.16, "Thickness of the walls.", unit="m", minimum=0.05, maximum=1.0)
    slab: float = parameter(0.2, "Thickness of floor and ceiling.", unit="m", minimum=0.05)
    door_height: float = parameter(2.1, "Height of the doors.", unit="m", minimum=1.8)
    sill: float = parameter(0.9, "Height of the window sills.", unit="m", minimum=0.0)
    window_height: float = parameter(2.1, "Upper edge of the windows.", unit="m", minimum=0.5)


@dataclass(frozen=True)
class Area:
    """A rectangle of floor that belongs to a room: x0, y0, x1, y1 on the walls' middle lines."""

    room: int
    bounds: tuple[float, float, float, float]

    @property
    def centre(self) -> tuple[float, float]:
        """Middle of the rectangle, m."""
        x0, y0, x1, y1 = self.bounds
        return (x0 + x1) / 2, (y0 + y1) / 2


@dataclass(frozen=True)
class Opening:
    """A hole in a wall, centred at `position` (m) on the wall's middle line, `width` m wide.

    `kind` is "door" or "window"; windows are glass, which a lidar does not see.
    """

    kind: str
    position: tuple[float, float]
    width: float


@dataclass(frozen=True)
class Box:
    """An axis-aligned solid between two corners, m."""

    lower: tuple[float, float, float]
    upper: tuple[float, float, float]


@dataclass(frozen=True)
class Building:
    """One storey: its areas, openings and everything solid in it."""

    names: tuple[str, ...]
    """Name of each room, by room id."""
    areas: tuple[Area, ...]
    openings: tuple[Opening, ...]
    structure: tuple[Box, ...]
    furniture: tuple[Box, ...]

    def mesh(self) -> tuple[NDArray[np.float32], NDArray[np.uint32]]:
        """Return all solids as triangles: vertices (V, 3) float32, m, and (F, 3) uint32."""
        vertices, triangles = box_mesh(self.structure + self.furniture)
        return vertices.astype(np.float32), triangles.astype(np.uint32)

    def room_at(self, x: float, y: float) -> int:
        """Return the id of the room that a place (m) lies in, -1 outside."""
        for area in self.areas:
            x0, y0, x1, y1 = area.bounds
            if x0 <= x < x1 and y0 <= y < y1:
                return area.room
        return -1


_BOX_TRIANGLES = np.array(
    [
        *((0, 2, 1), (1, 2, 3), (4, 5, 6), (5, 7, 6)),
        *((0, 1, 4), (1, 5, 4), (2, 6, 3), (3, 6, 7)),
        *((0, 4, 2), (2, 4, 6), (1, 3, 5), (3, 7, 5)),
    ],
    dtype=np.int64,
)
"""The twelve triangles of a box whose corner k has its x, y and z in bits 0, 1 and 2 of k."""


def box_mesh(boxes: Sequence[Box]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return boxes as triangles: vertices (8 N, 3), m, and faces (12 N, 3), box by box."""
    corners = np.array([(box.lower, box.upper) for box in boxes]).reshape(-1, 2, 3)
    pick = np.array([(k & 1, k >> 1 & 1, k >> 2 & 1) for k in range(8)])
    vertices = corners[:, pick, np.arange(3)]
    triangles = 8 * np.arange(len(boxes))[:, None, None] + _BOX_TRIANGLES
    return vertices.reshape(-1, 3), triangles.reshape(-1, 3)


def make_building(
    names: tuple[str, ...],
    areas: tuple[Area, ...],
    openings: tuple[Opening, ...],
    furniture: tuple[Box, ...],
    config: BuildingConfig,
    *,
    without_floor: Collection[int] = (),
    without_ceiling: Collection[int] = (),
) -> Building:
    """Put walls round the areas, holes into the walls and slabs below and above.

    `without_floor` and `without_ceiling` are rooms that stairs lead up into and out of.

    Raises
    ------
    BuildingError
        An opening does not lie on a wall.
    """
    structure = _slabs(areas, config, without_floor, without_ceiling)
    placed: set[Opening] = set()
    for (axis, line), runs in _wall_runs(areas).items():
        for run in runs:
            on_run = [o for o in openings if _lies_on(o, axis, line, run)]
            placed.update(on_run)
            structure += _wall(axis, line, run, on_run, config)
    for opening in openings:
        if opening not in placed:
            raise BuildingError(f"{opening.kind} at {opening.position} m lies on no wall")
    return Building(names, areas, openings, tuple(structure), furniture)


def table(x: float, y: float, length: float, width: float) -> tuple[Box, ...]:
    """Return a table of 0.74 m height centred at (x, y) m: a top and two side panels."""
    x0, x1, y0, y1 = x - length / 2, x + length / 2, y - width / 2, y + width / 2
    return (
        Box((x0, y0, 0.70), (x1, y1, 0.74)),
        Box((x0, y0, 0.0), (x0 + 0.04, y1, 0.70)),
        Box((x1 - 0.04, y0, 0.0), (x1, y1, 0.70)),
    )


def cabinet(x: float, y: float, length: float, width: float, height: float) -> tuple[Box, ...]:
    """Return a closed box that stands on the floor, centred at (x, y), all in m."""
    lower = (x - length / 2, y - width / 2, 0.0)
    return (Box(lower, (x + length / 2, y + width / 2, height)),)


def _slabs(
    areas: tuple[Area, ...],
    config: BuildingConfig,
    without_floor: Collection[int],
    without_ceiling: Collection[int],
) -> list[Box]:
    """Floor and ceiling of each area, reaching under the walls' outer faces."""
    half = config.wall / 2
    boxes = []
    for area in areas:
        x0, y0, x1, y1 = area.bounds
        slabs = ((-config.slab, 0.0), (config.ceiling, config.ceiling + config.slab))
        for (low, high), left_out in zip(slabs, (without_floor, without_ceiling), strict=True):
            if area.room in left_out:
                continue
            boxes.append(Box((x0 - half, y0 - half, low), (x1 + half, y1 + half, high)))
    return boxes


def _wall_runs(
    areas: tuple[Area, ...],
) -> dict[tuple[int, float], list[tuple[float, float]]]:
    """Return {(axis of the wall's normal, coordinate): disjoint runs along it}.

    A stretch of an edge is left out where areas of one room lie on both its sides.
    """
    ends: dict[tuple[int, float], set[float]] = defaultdict(set)
    for area in areas:
        for axis in (0, 1):
            along = 1 - axis
            for side in (axis, axis + 2):
                ends[axis, area.bounds[side]] |= {area.bounds[along], area.bounds[along + 2]}
    runs = {}
    for (axis, line), marks in sorted(ends.items()):
        stretches = list(zip(sorted(marks), sorted(marks)[1:], strict=False))
        walled = [s for s in stretches if _needs_wall(areas, axis, line, sum(s) / 2)]
        runs[axis, line] = _joined(walled)
    return runs


def _needs_wall(areas: tuple[Area, ...], axis: int, line: float, middle: float) -> bool:
    """True where different rooms, or a room and the outside, meet at a point of a line."""
    rooms = []
    for side in (axis + 2, axis):
        touching = [
            area.room
            for area in areas
            if area.bounds[side] == line and area.bounds[1 - axis] < middle < area.bounds[3 - axis]
        ]
        rooms.append(touching[0] if touching else None)
    return rooms[0] != rooms[1]


def _joined(stretches: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Join stretches that touch."""
    joined: list[tuple[float, float]] = []
    for start, end in stretches:
        if joined and joined[-1][1] == start:
            joined[-1] = (joined[-1][0], end)
        else:
            joined.append((start, end))
    return joined


def _lies_on(opening: Opening, axis: int, line: float, run: tuple[float, float]) -> bool:
    """True where an opening is a hole in this stretch of wall."""
    along = opening.position[1 - axis]
    return (
        opening.position[axis] == line
        and run[0] <= along - opening.width / 2
        and along + opening.width / 2 <= run[1]
    )


def _wall(
    axis: int,
    line: float,
    run: tuple[float, float],
    openings: list[Opening],
    config: BuildingConfig,
) -> list[Box]:
    """Return the boxes of one wall: full height between its openings, lintels and sills at them."""
    half = config.wall / 2

    def box(start: float, end: float, low: float, high: float) -> Box:
        lower, upper = [0.0, 0.0, low], [0.0, 0.0, high]
        lower[axis], upper[axis] = line - half, line + half
        lower[1 - axis], upper[1 - axis] = start, end
        return Box((lower[0], lower[1], low), (upper[0], upper[1], high))

    boxes = []
    start = run[0] - half
    for opening in sorted(openings, key=lambda o: o.position[1 - axis]):
        left = opening.position[1 - axis] - opening.width / 2
        right = left + opening.width
        boxes.append(box(start, left, 0.0, config.ceiling))
        if opening.kind == "window":
            boxes.append(box(left, right, 0.0, config.sill))
            boxes.append(box(left, right, config.window_height, config.ceiling))
        else:
            boxes.append(box(left, right, config.door_height, config.ceiling))
        start = right
    boxes.append(box(start, run[1] + half, 0.0, config.ceiling))
    return boxes
