"""A small floor of six rooms and agents that map parts of it, without the extraction pipeline."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from test.helpers import box_room, moved, yaw_transform
from topometric_ros.extraction.layers import LayersConfig, storey_layers
from topometric_ros.topometric_map import NO_ROOM, Passage, Room, Storey, TopometricMap
from topometric_ros.voxels.grid import (
    in_morton_order,
    lattice_coordinates,
    surface_offsets,
    thin,
    voxelise,
)

HEIGHT = 2.6


@dataclass(frozen=True)
class PlanRoom:
    """A room of the plan: corner and size in metres, doors as `box_room` takes them."""

    corner: tuple[float, float]
    size: tuple[float, float]
    doors: tuple[tuple[str, float], ...]
    furniture: tuple[tuple[float, float, float, float, float], ...] = ()
    """Boxes: x and y from the room's corner, their width, depth and height, m."""


PLAN = {
    0: PlanRoom((0, 0), (14, 2), (("y+", 2), ("y+", 6.5), ("y+", 11), ("y-", 3), ("y-", 10))),
    1: PlanRoom((0, 2.2), (4, 4), (("y-", 2),), ((0.3, 2.5, 0.6, 1.4, 1.8),)),
    2: PlanRoom((4.2, 2.2), (4.6, 5), (("y-", 2.3),), ((3.0, 3.2, 1.2, 0.8, 0.8),)),
    3: PlanRoom((9, 2.2), (5, 3.2), (("y-", 2),), ((3.9, 0.4, 0.7, 2.0, 1.2),)),
    4: PlanRoom((0, -5.2), (6, 5), (("y+", 3),), ((0.4, 0.4, 2.0, 0.9, 0.8),)),
    5: PlanRoom((6.4, -4.2), (7.6, 4), (("y+", 3.6),), ((6.2, 0.3, 0.8, 1.6, 2.0),)),
}
PASSAGES = {(0, 1): (2, 2.1), (0, 2): (6.5, 2.1), (0, 3): (11, 2.1), (0, 4): (3, -0.1),
            (0, 5): (10, -0.1)}  # fmt: skip


def room_points(number: int) -> NDArray[np.float64]:
    """Return the points of one room of the plan: (n, 3), m, building frame."""
    room = PLAN[number]
    parts = [box_room((*room.corner, 0.0), (*room.size, HEIGHT), room.doors)]
    for x, y, width, depth, height in room.furniture:
        corner = (room.corner[0] + x, room.corner[1] + y, 0.0)
        parts.append(box_room(corner, (width, depth, height)))
    return np.concatenate(parts)


def agent_map(
    agent: str,
    rooms: Sequence[int],
    T_building_agent: NDArray[np.float64],
    *,
    voxel_size: float = 0.1,
    noise: float = 0.0,
    seed: int = 0,
    T_level_input: NDArray[np.float64] | None = None,
    bare: bool = False,
) -> TopometricMap:
    """Return the map of an agent that saw some rooms, its room ids those of the plan.

    Its level frame is the building's moved by the inverse of `T_building_agent`. With `bare` there
    are no rooms, passages or storeys.
    """
    T = np.linalg.inv(T_building_agent)
    parts = [room_points(number) for number in rooms]
    labels = np.concatenate([np.full(len(p), n) for p, n in zip(parts, rooms, strict=True)])
    points = np.concatenate(parts)
    points = moved(points + np.random.default_rng(seed).normal(0, noise, points.shape), T)
    origin = np.array([0.0, 0.0, T[2, 3]])
    grid, cell_of_point = voxelise(points, voxel_size, origin)
    room = np.full(len(grid), NO_ROOM, dtype=np.int32)
    room[cell_of_point[::-1]] = labels[::-1]
    floor = parts_on_floor(rooms)
    navigable = in_morton_order(lattice_coordinates(moved(floor, T), voxel_size, origin))
    doors = {pair: p for pair, p in PASSAGES.items() if set(pair) <= set(rooms)}
    layers = storey_layers(thin(points, 0.05), [T[2, 3]], LayersConfig())[0]
    middles = [_middle(number) for number in rooms]
    return TopometricMap(
        agent=agent,
        session="s",
        sequence=1,
        frame_id=f"{agent}/map",
        stamp=7,
        voxel_size=voxel_size,
        origin=(0.0, 0.0, float(T[2, 3])),
        voxels=grid.coords,
        offsets=surface_offsets(points, grid, cell_of_point),
        room=np.full(len(grid), NO_ROOM, dtype=np.int32) if bare else room,
        navigable=navigable,
        viewpoints=moved(np.array(middles), T).astype(np.float32),
        rooms=() if bare else tuple(_room(n, room == n, grid, doors) for n in rooms),
        passages=()
        if bare
        else tuple(
            Passage(pair, tuple(moved(np.array([[*p, 0.0]]), T)[0].tolist()), 0.9)
            for pair, p in doors.items()
        ),
        storeys=() if bare else (Storey(0, float(T[2, 3]), float(T[2, 3]) + HEIGHT, layers),),
        T_level_input=np.eye(4) if T_level_input is None else T_level_input,
    )


def parts_on_floor(rooms: Sequence[int]) -> NDArray[np.float64]:
    """Return points 0.3 m inside the walls on the rooms' floors: (n, 3), m, building frame."""
    parts = []
    for number in rooms:
        (x, y), (dx, dy) = PLAN[number].corner, PLAN[number].size
        grid = np.meshgrid(
            np.arange(x + 0.3, x + dx - 0.3, 0.1), np.arange(y + 0.3, y + dy - 0.3, 0.1)
        )
        flat = np.stack(grid, -1).reshape(-1, 2)
        parts.append(np.column_stack([flat, np.zeros(len(flat))]))
    return np.concatenate(parts)


def _middle(number: int) -> tuple[float, float, float]:
    (x, y), (dx, dy) = PLAN[number].corner, PLAN[number].size
    return x + dx / 2, y + dy / 2, 1.6


def _room(number: int, mask: NDArray[np.bool_], grid, doors) -> Room:  # type: ignore[no-untyped-def]
    centres, half = grid.centres()[mask], grid.voxel_size / 2
    return Room(
        id=number,
        storey=0,
        centroid=tuple(centres.mean(axis=0).tolist()),
        bounds=(
            tuple((centres.min(axis=0) - half).tolist()),
            tuple((centres.max(axis=0) + half).tolist()),
        ),
        voxels=int(mask.sum()),
        area=PLAN[number].size[0] * PLAN[number].size[1],
        isolated=not any(number in pair for pair in doors),
    )


A_ROOMS, B_ROOMS, C_ROOMS = (0, 1, 2, 4), (0, 2, 3, 4), (0, 3, 4, 5)
T_BUILDING_A = yaw_transform(0.4, (1.0, 2.0, 0.0))
T_BUILDING_B = yaw_transform(-2.1, (9.0, -3.0, 0.35))
T_BUILDING_C = yaw_transform(1.3, (-4.0, 6.0, -0.2))
T_A_B = np.linalg.inv(T_BUILDING_A) @ T_BUILDING_B


def error_of(
    T: NDArray[np.float64], truth: NDArray[np.float64], points: NDArray[np.float64]
) -> tuple[float, float]:
    """Return the mean displacement of points (m) and the angle (degrees) between two transforms."""
    apart = np.linalg.norm(moved(points, T) - moved(points, truth), axis=1).mean()
    cosine = (np.trace(T[:3, :3].T @ truth[:3, :3]) - 1) / 2
    return float(apart), float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
