"""A wing that goes on from the end of a corridor at an angle, and the lobby between the two."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.simulation.generator_layouts import Port

_SLACK = 0.8
"""Length of the shorter side of a lobby beyond what keeps the rooms beside it apart, m."""


@dataclass(frozen=True)
class WingFrame:
    """Where a wing lies: its corridor's right corner at the lobby is its own origin."""

    angle: float
    """Of the wing's corridor against the building's x, rad."""
    origin: NDArray[np.float64]
    lobby: NDArray[np.float64]
    """(4, 2), m, counter-clockwise: right and left corner at the wing are 1 and 2."""

    def place(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Move points (N, 2 or 3) from the wing's frame to the building's."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        moved = np.array(points, dtype=np.float64)
        moved[..., :2] = moved[..., :2] @ np.array([[c, s], [-s, c]]) + self.origin
        return moved


def wing_frame(port: Port, depth: float, width: float, angle: float) -> WingFrame:
    """Return the frame of a wing that turns to the left by `angle` rad from the way outwards.

    The lobby is a trapezium whose shorter side lies on the inner side of the turn, just long
    enough that rooms of `depth` m on that side do not meet.
    """
    heading = float(np.arctan2(port.outwards[1], port.outwards[0]))
    ahead, halfway, onwards = (
        np.array([np.cos(a), np.sin(a)]) for a in (heading, heading + angle / 2, heading + angle)
    )
    to_left = np.array([-ahead[1], ahead[0]])
    wing_left = np.array([-onwards[1], onwards[0]])
    right, left = (np.array(port.position) + side * width / 2 * to_left for side in (-1, 1))
    shorter = 2 * (depth + 0.3) * np.tan(abs(angle) / 2) + _SLACK
    if angle >= 0:
        origin = left + shorter * halfway - width * wing_left
    else:
        origin = right + shorter * halfway
    lobby = np.array([right, origin, origin + width * wing_left, left])
    return WingFrame(heading + angle, origin, lobby)


def prism(
    polygon: NDArray[np.float64], low: float, high: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return a convex polygon (K, 2) extruded: vertices (2 K, 3), m, and faces (F, 3)."""
    count = len(polygon)
    vertices = np.concatenate([np.column_stack([polygon, np.full(count, z)]) for z in (low, high)])
    a = np.arange(count)
    b = np.roll(a, -1)
    fan = np.column_stack([np.zeros(count - 2, dtype=int), a[1:-1], a[2:]])
    sides = [np.column_stack([a, b, b + count]), np.column_stack([a, b + count, a + count])]
    return vertices, np.concatenate([fan[:, ::-1], fan + count, *sides])


def offset_convex(polygon: NDArray[np.float64], distance: float) -> NDArray[np.float64]:
    """Return a counter-clockwise convex polygon whose edges moved inwards by `distance` m."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    directions = edges / np.hypot(*edges.T)[:, None]
    inwards = np.column_stack([-directions[:, 1], directions[:, 0]])
    corners = []
    for i in range(len(polygon)):
        normals = np.array([inwards[i - 1], inwards[i]])
        corners.append(np.linalg.solve(normals, normals @ polygon[i] + distance))
    return np.array(corners)


def wall_along(start: NDArray[np.float64], end: NDArray[np.float64], wall: float) -> NDArray:
    """Return the ground plan of a wall on the line from start to end: (4, 2), m."""
    ahead = (end - start) / np.hypot(*(end - start)) * wall / 2
    left = np.array([-ahead[1], ahead[0]])
    start, end = start - ahead, end + ahead
    return np.array([start - left, end - left, end + left, start + left])
