"""Corridors of a storey and the strips of rooms along them: straight, L, ring and comb."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

Rectangle = tuple[float, float, float, float]
"""x0, y0, x1, y1 on the walls' middle lines, m."""


@dataclass(frozen=True)
class Strip:
    """A row of rooms along one side of a corridor.

    A place in it is (u, v): u m from `start` along the corridor, v m away from it.
    """

    start: tuple[float, float]
    along: tuple[int, int]
    away: tuple[int, int]
    length: float
    depth: float
    facade: bool
    """True where the rooms' far side is an outer wall."""

    def at(self, u: float, v: float) -> tuple[float, float]:
        """Return the place (u, v) in the storey's frame, rounded so that equal lines are equal."""
        x = self.start[0] + u * self.along[0] + v * self.away[0]
        y = self.start[1] + u * self.along[1] + v * self.away[1]
        return round(x, 3) + 0.0, round(y, 3) + 0.0

    def rectangle(self, u0: float, v0: float, u1: float, v1: float) -> Rectangle:
        """Return the rectangle between two places."""
        (xa, ya), (xb, yb) = self.at(u0, v0), self.at(u1, v1)
        return min(xa, xb), min(ya, yb), max(xa, xb), max(ya, yb)


@dataclass(frozen=True)
class Port:
    """An end of a corridor where a wing may go on: its middle and the direction outwards."""

    position: tuple[float, float]
    outwards: tuple[int, int]


@dataclass(frozen=True)
class Layout:
    """One storey's corridor (all one room), its strips and its open ends."""

    corridor: tuple[Rectangle, ...]
    strips: tuple[Strip, ...]
    ports: tuple[Port, ...]


def make_layout(shape: str, frontage: float, depth: float, width: float, wings: int) -> Layout:
    """Return a corridor of a shape with about `frontage` m of rooms along it.

    Parameters
    ----------
    shape : straight, L, ring or comb
    frontage : sum of the rooms' widths, m
    depth, width : of the rooms and of the corridor, m
    wings : how many ports are needed, 0 to 2
    """
    if shape == "L":
        return _bent(frontage, depth, width)
    if shape == "ring":
        return _ring(frontage, depth, width, wings)
    if shape == "comb":
        return _comb(frontage, depth, width)
    return _straight(frontage, depth, width)


def _snap(value: float) -> float:
    """Round to decimetres."""
    return round(value, 1)


def _straight(frontage: float, depth: float, width: float) -> Layout:
    length = _snap(frontage / 2)
    strips = (
        Strip((0.0, 0.0), (1, 0), (0, -1), length, depth, True),
        Strip((0.0, width), (1, 0), (0, 1), length, depth, True),
    )
    ports = (Port((length, width / 2), (1, 0)), Port((0.0, width / 2), (-1, 0)))
    return Layout(((0.0, 0.0, length, width),), strips, _rounded_ports(ports))


def _bent(frontage: float, depth: float, width: float) -> Layout:
    """The second leg goes north from the east end of the first."""
    legs = (frontage + depth) / 2
    across = _snap(max(0.55 * legs, width + depth + 3.5))
    up = _snap(max(legs - across, depth))
    west, north = across - width, width + up
    inner = _snap(west - depth)
    strips = (
        Strip((0.0, 0.0), (1, 0), (0, -1), across, depth, True),
        Strip((across, 0.0), (0, 1), (1, 0), north, depth, True),
        Strip((west, width), (0, 1), (-1, 0), up, depth, True),
        Strip((0.0, width), (1, 0), (0, 1), inner, depth, True),
    )
    corridor = ((0.0, 0.0, west, width), (west, 0.0, across, width), (west, width, across, north))
    ports = (Port((0.0, width / 2), (-1, 0)), Port((across - width / 2, north), (0, 1)))
    return Layout(_rounded(corridor), strips, _rounded_ports(ports))


def _ring(frontage: float, depth: float, width: float, wings: int) -> Layout:
    """Two rows of rooms back to back, a corridor round them and rooms round the corridor.

    A wing goes on from a stub of corridor that leads through the eastern or western strip.
    """
    high = _snap(2 * width + 2 * depth)
    wide = _snap(max((frontage - 2 * high + 4 * width) / 4, 2 * width + 4.0))
    top, right, core = high - width, wide - width, wide - 2 * width
    strips = [
        Strip((0.0, 0.0), (1, 0), (0, -1), wide, depth, True),
        Strip((0.0, high), (1, 0), (0, 1), wide, depth, True),
        Strip((width, width), (1, 0), (0, 1), core, depth, False),
        Strip((width, top), (1, 0), (0, -1), core, depth, False),
    ]
    corridor: list[Rectangle] = [(0.0, 0.0, wide, width), (0.0, top, wide, high)]
    corridor += [(0.0, width, width, top), (right, width, wide, top)]
    ports = []
    for side, (line, away) in enumerate(((wide, 1), (0.0, -1))):
        if side >= wings:
            strips.append(Strip((line, 0.0), (0, 1), (away, 0), high, depth, True))
            continue
        low, end = _snap((high - width) / 2), line + away * depth
        for start in (0.0, low + width):
            length = low if start == 0.0 else high - low - width
            strips.append(Strip((line, start), (0, 1), (away, 0), _snap(length), depth, True))
        corridor.append((min(line, end), low, max(line, end), low + width))
        ports.append(Port((end, low + width / 2), (away, 0)))
    return Layout(_rounded(corridor), tuple(strips), _rounded_ports(ports))


def _comb(frontage: float, depth: float, width: float) -> Layout:
    """Teeth go north from a spine; the rooms between two teeth stand back to back."""
    pitch = width + 2 * depth
    teeth = max(2, round(np.sqrt(frontage / (3 * pitch))))
    while teeth > 2 and (frontage - teeth * pitch) / (2 * teeth) < 2 * depth:
        teeth -= 1
    length = _snap(max((frontage - teeth * pitch) / (2 * teeth), 4.0))
    wide = teeth * pitch
    strips = [Strip((0.0, 0.0), (1, 0), (0, -1), _snap(wide), depth, True)]
    corridor: list[Rectangle] = [(0.0, 0.0, wide, width)]
    for tooth in range(teeth):
        x = tooth * pitch + depth
        corridor.append((x, width, x + width, width + length))
        left, right = tooth == 0, tooth == teeth - 1
        strips.append(Strip((round(x, 3), width), (0, 1), (-1, 0), length, depth, left))
        start = (round(x + width, 3), width)
        strips.append(Strip(start, (0, 1), (1, 0), length, depth, right))
    ports = (Port((round(wide, 3), width / 2), (1, 0)), Port((0.0, width / 2), (-1, 0)))
    return Layout(_rounded(corridor), tuple(strips), _rounded_ports(ports))


def _rounded(rectangles: list[Rectangle] | tuple[Rectangle, ...]) -> tuple[Rectangle, ...]:
    """Round to millimetres, so that equal lines are equal."""
    return tuple(
        (round(x0, 3) + 0.0, round(y0, 3) + 0.0, round(x1, 3) + 0.0, round(y1, 3) + 0.0)
        for x0, y0, x1, y1 in rectangles
    )


def _rounded_ports(ports: Sequence[Port]) -> tuple[Port, ...]:
    """Round to millimetres, so that a port lies on the wall at its corridor's end."""
    places = [
        (round(port.position[0], 3) + 0.0, round(port.position[1], 3) + 0.0) for port in ports
    ]
    return tuple(Port(place, port.outwards) for place, port in zip(places, ports, strict=True))
