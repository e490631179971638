"""Tiny made buildings as voxels with rooms, for the tests of passages, stairs and attributes."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.mapped_rooms import MappedRooms
from topometric_ros.extraction.navigation import NavigationConfig, navigable_volume
from topometric_ros.topometric_map import Storey, StoreyLayers
from topometric_ros.voxels.grid import surface_offsets, voxelise

Solid = tuple[float, float, float, float, float, float]
"""x0, y0, z0, x1, y1, z1 of an axis-aligned box, m."""

_NOTHING = np.zeros((1, 1), bool)


def surfaces(boxes: Sequence[Solid], spacing: float = 0.05) -> NDArray[np.float64]:
    """Return points on all faces of boxes, about `spacing` m apart: (N, 3)."""
    parts = []
    for box in boxes:
        low, high = np.array(box[:3]), np.array(box[3:])
        for axis in range(3):
            first, second = (k for k in range(3) if k != axis)
            lines = [
                np.linspace(low[k], high[k], max(2, round((high[k] - low[k]) / spacing) + 1))
                for k in (first, second)
            ]
            u, v = (part.ravel() for part in np.meshgrid(*lines))
            for side in (low[axis], high[axis]):
                face = np.empty((len(u), 3))
                face[:, first], face[:, second], face[:, axis] = u, v, side
                parts.append(face)
    return np.concatenate(parts)


def mapped(
    points: NDArray[np.float64],
    room_at: Callable[[NDArray[np.float64]], NDArray[np.int32]],
    floors: Sequence[tuple[float, float | None]] = ((0.0, 2.6),),
    storey_of_room: dict[int, int] | None = None,
) -> MappedRooms:
    """Return the voxels of a cloud with their rooms.

    Parameters
    ----------
    points : (P, 3) m
    room_at : the room of each cell centre (N, 3)
    floors : floor and ceiling of each storey, m
    storey_of_room : by room; all on storey 0 where not given
    """
    grid, cell = voxelise(points, 0.1, np.zeros(3))
    room = room_at(grid.centres()).astype(np.int32)
    layers = StoreyLayers(0.1, (0.0, 0.0), _NOTHING, _NOTHING, _NOTHING, _NOTHING)
    storeys = tuple(Storey(i, low, high, layers) for i, (low, high) in enumerate(floors))
    return MappedRooms(
        grid,
        surface_offsets(points, grid, cell),
        room,
        navigable_volume(grid, NavigationConfig(keep="all")),
        storey_of_room or dict.fromkeys(np.unique(room[room >= 0]).tolist(), 0),
        storeys,
    )


def shell(x0: float, y0: float, x1: float, y1: float, low: float, high: float) -> list[Solid]:
    """Return floor, ceiling and four walls of a rectangular hall, without openings."""
    return [
        (x0, y0, low - 0.02, x1, y1, low),
        (x0, y0, high, x1, y1, high + 0.02),
        (x0 - 0.02, y0, low, x0, y1, high),
        (x1, y0, low, x1 + 0.02, y1, high),
        (x0, y0 - 0.02, low, x1, y0, high),
        (x0, y1, low, x1, y1 + 0.02, high),
    ]


def wall_with_door(
    x: float, y0: float, y1: float, door: tuple[float, float], lintel: float, top: float
) -> list[Solid]:
    """Return a wall of 0.15 m across the hall with a door between two y; no lintel at `top`."""
    wall = [(x, y0, 0.0, x + 0.15, door[0], top), (x, door[1], 0.0, x + 0.15, y1, top)]
    return wall + ([(x, door[0], lintel, x + 0.15, door[1], top)] if lintel < top else [])
