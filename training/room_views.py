"""Partial views of rooms to train on: the data recipe of both networks (thesis §4.3.4).

A view is what one to three visibilities see of one room: rays in all directions from places where
an agent can stand, in the room or just outside it, voxelised at 0.1 m as maps are. The complete
room is what six places spread over it see together. Buildings are whatever `topometric simulate`
takes: the generator's, a labelled .ply, a folder of S3DIS. Every room has a frame of its own: the
middle of its floor, the building's axes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.matching.planes import fit_planes
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.labelled import LabelledBuilding
from topometric_ros.simulation.walkable import Walkable
from topometric_ros.simulation.world import World, make_world
from topometric_ros.voxels.grid import voxelise

VIEWS = 6
"""Partial views of a room."""
POINTS = 1024
"""Points that are kept of a view, and of the complete room."""
_VOXEL = 0.1
_RAYS = 6000
_REACH = 8.0
_EYE = (0.4, 1.7)
"""Lowest and highest eye above the floor, m."""
_OUTSIDE = 0.2
"""Share of views with a place outside the room, not farther from it than `_BEFORE_DOOR` m."""
_BEFORE_DOOR = 2.5
_HELD_TOGETHER = 0.5
"""Share of views whose places lie within 1.5 m of each other: a look in, not a walk through."""
_SMALLEST = 250
"""Voxels below which a view shows too little of a room to be a room."""


@dataclass(frozen=True)
class RoomViews:
    """R rooms: float32, m, each in its room's frame; normals are unit vectors to the seen side."""

    views: NDArray[np.float32]
    """(R, VIEWS, POINTS, 3)."""
    normals: NDArray[np.float32]
    """(R, VIEWS, POINTS, 3)."""
    complete: NDArray[np.float32]
    """(R, POINTS, 3)."""
    building: NDArray[np.int32]
    """(R,): index of the building that a room is of."""

    def save(self, path: Path) -> None:
        """Write everything as one .npz, coordinates in single, normals in half precision."""
        halves = self.normals.astype(np.float16)
        np.savez(path, views=self.views, normals=halves, complete=self.complete,
                 building=self.building)  # fmt: skip

    @staticmethod
    def load(path: Path) -> RoomViews:
        """Read what `save` wrote."""
        with np.load(path) as held:
            return RoomViews(
                held["views"],
                held["normals"].astype(np.float32),
                held["complete"],
                held["building"],
            )


def generated_buildings(count: int, first_seed: int) -> list[str]:
    """Return names of generated buildings of all kinds and shapes, seeds from `first_seed` on."""
    kinds, corridors = ("office", "home", "hospital"), ("straight", "L", "ring", "comb")
    return [
        f"{kinds[k % 3]}:seed={first_seed + k},corridor={corridors[k // 3 % 4]},"
        f"ceiling={2.4 + 0.15 * (k % 7):.2f},cut={0.1 * (k % 8):.1f},"
        f"furniture={0.5 + 0.1 * (k % 6):.1f}"
        for k in range(count)
    ]


def room_views(specs: Sequence[str], seed: int) -> RoomViews:
    """Look at every room of every building; the same arguments give the same bytes."""
    views, normals, complete, building = [], [], [], []
    for k, spec in enumerate(specs):
        rng = np.random.default_rng((seed, k))
        loaded = load_building(spec)
        world = make_world(loaded)
        walkable = Walkable(loaded, world)
        for room in loaded.rooms:
            seen = _room(loaded, world, walkable, room.id, rng)
            if seen is None:
                continue
            views.append(seen[0])
            normals.append(seen[1])
            complete.append(seen[2])
            building.append(k)
    return RoomViews(
        np.array(views, np.float32),
        np.array(normals, np.float32),
        np.array(complete, np.float32),
        np.array(building, np.int32),
    )


def _room(
    building: LabelledBuilding,
    world: World,
    walkable: Walkable,
    room: int,
    rng: np.random.Generator,
) -> tuple[NDArray, NDArray, NDArray] | None:
    """Return views, normals and the complete room; None where too little can be seen."""
    inside = walkable.places[walkable.room == room]
    if len(inside) < 10:
        return None
    spread = inside[_spread(inside, 6)]
    whole, _ = _voxels(*_look(building, world, spread, room, rng))
    if len(whole) < 2 * _SMALLEST:
        return None
    low, high = whole.min(axis=0), whole.max(axis=0)
    middle = np.array([*((low + high) / 2)[:2], inside[:, 2].mean()])
    near = walkable.places[
        (walkable.room != room)
        & np.all(np.abs(walkable.places - middle) < (high - low) / 2 + _BEFORE_DOOR, axis=1)
    ]
    views, normals = [], []
    for _ in range(5 * VIEWS):
        points, towards = _look(building, world, _places(inside, near, rng), room, rng)
        cells, sides = _voxels(points, towards)
        if len(cells) >= _SMALLEST:
            rows = _drawn(len(cells), rng)
            views.append(cells[rows] - middle)
            normals.append(_normals(cells, rows, sides[rows]))
        if len(views) == VIEWS:
            return np.array(views), np.array(normals), whole[_drawn(len(whole), rng)] - middle
    return None


def _places(
    inside: NDArray[np.float64], near: NDArray[np.float64], rng: np.random.Generator
) -> NDArray[np.float64]:
    """Draw where one view is seen from: (1 to 3, 3), on the floor."""
    count = int(rng.integers(1, 4))
    if len(near) and rng.random() < _OUTSIDE:
        first = near[rng.integers(len(near))]
        inside = np.concatenate([near, inside])
    else:
        first = inside[rng.integers(len(inside))]
    if rng.random() < _HELD_TOGETHER:
        inside = inside[np.linalg.norm(inside - first, axis=1) < 1.5]
    if len(inside) == 0:
        return first[None]
    return np.concatenate([first[None], inside[rng.integers(len(inside), size=count - 1)]])


def _spread(places: NDArray[np.float64], count: int) -> list[int]:
    """Return rows of places far from each other: each the farthest from those before."""
    rows = [0]
    away = np.linalg.norm(places - places[0], axis=1)
    while len(rows) < count:
        rows.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(places - places[rows[-1]], axis=1))
    return rows


def _look(
    building: LabelledBuilding,
    world: World,
    places: NDArray[np.float64],
    room: int,
    rng: np.random.Generator,
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return where rays from the places meet a room, with noise, and unit vectors back: (n, 3)."""
    directions = rng.standard_normal((_RAYS * len(places), 3))
    # Sensors see less of the poles.
    directions[:, 2] *= rng.uniform(0.5, 1.0)
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    eyes = places + np.array([0.0, 0.0, 1.0]) * rng.uniform(*_EYE, (len(places), 1))
    origins = np.repeat(eyes, _RAYS, axis=0)
    hits = world.cast(origins, directions, _REACH)
    met = np.flatnonzero(np.isfinite(hits[:, 0]))
    own = building.room_of(hits[met], -directions[met]) == room
    rows = met[own]
    return hits[rows] + rng.normal(0.0, 0.01, (len(rows), 3)), -directions[rows]


def _voxels(
    points: NDArray[np.float64], towards: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the mean point of every voxel and its mean direction to the eye: (n, 3)."""
    if len(points) == 0:
        return np.zeros((0, 3)), np.zeros((0, 3))
    grid, row = voxelise(points, _VOXEL, points.min(axis=0))
    count = np.bincount(row, minlength=len(grid))[:, None]
    means = [
        np.stack([np.bincount(row, axis, len(grid)) for axis in values.T], axis=1) / count
        for values in (points, towards)
    ]
    return means[0], means[1]


def _drawn(count: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Draw POINTS rows of `count`, none twice where there are enough."""
    return rng.choice(count, POINTS, replace=count < POINTS)


def _normals(
    cells: NDArray[np.float64], rows: NDArray[np.int64], towards: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Return the normals of some cells, towards the eye that saw them: (POINTS, 3)."""
    normals = fit_planes(cells, 10)[0][rows]
    facing = np.sign(np.einsum("ij,ij->i", normals, towards))
    return normals * np.where(facing == 0, 1.0, facing)[:, None]
