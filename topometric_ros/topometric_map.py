"""The data model that every stage speaks: a topometric map T = (V, G) (thesis §4.1.4, eq. 20-21).

A map holds what the merger needs and no more. All positions are in metres in the map's *level
frame*: the agent's own frame, turned so that z is up (`T_level_input`, identity for nearly every
input). Voxels are integer coordinates on a lattice of cell centres `origin + k * voxel_size`.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from topometric_ros.map_checks import (
    CELL_EDGES,
    LARGEST_POSITION,
    NO_ROOM,
    OFFSET_STEPS,
    PASSAGE_KINDS,
    ROOM_KINDS,
    SCHEMA,
    MapError,
    check_map,
)

__all__ = [
    "CELL_EDGES",
    "LARGEST_POSITION",
    "NO_ROOM",
    "OFFSET_STEPS",
    "PASSAGE_KINDS",
    "ROOM_KINDS",
    "SCHEMA",
    "Building",
    "Descriptors",
    "MapError",
    "Passage",
    "Room",
    "Storey",
    "StoreyLayers",
    "TopometricMap",
    "triple",
]


@dataclass(frozen=True)
class StoreyLayers:
    """What one storey looks like from above: bird's-eye rasters for search and verification.

    The four masks are (nx, ny) bool with one shape; cell (i, j) is centred at
    `origin + cell * (i, j)`, metres, level frame. See `extraction/layers.py` for their definition.
    """

    cell: float
    origin: tuple[float, float]
    wall: NDArray[np.bool_]
    furniture: NDArray[np.bool_]
    free: NDArray[np.bool_]
    """Floor that was seen with nothing standing on it at the height of walls: seen-free space."""
    bare: NDArray[np.bool_]
    """The part of `free` with nothing above 0.2 m, where furniture would have been seen."""

    def __post_init__(self) -> None:
        for name in ("wall", "furniture", "free", "bare"):
            mask = getattr(self, name)
            if mask.dtype != np.bool_ or mask.ndim != 2 or mask.shape != self.wall.shape:
                raise MapError(
                    f"storey layer {name}: expected bool {self.wall.shape}, "
                    f"got {mask.dtype} {mask.shape}"
                )

    def cells_at(
        self, positions: NDArray[np.float64]
    ) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
        """Return the cells (n, 2) at positions (n, 2), m, or (0, 0), and which (n,) are inside."""
        cells = np.floor((positions - self.origin) / self.cell + 0.5).astype(np.int64)
        inside = np.all((cells >= 0) & (cells < self.wall.shape), axis=1)
        return np.where(inside[:, None], cells, 0), inside


@dataclass(frozen=True)
class Storey:
    """A level of the building; heights in metres, level frame."""

    id: int
    floor_z: float
    ceiling_z: float | None
    layers: StoreyLayers


@dataclass(frozen=True)
class Room:
    """A cluster of similar visibilities (§4.2.8); a node of the topological graph.

    `id` lasts across versions of a map. `bounds` are those of the whole cells, `voxels` counts the
    voxels with this label, `area` is the horizontal area they cover (m²), walls included,
    `isolated` says that no passage leads to it. The fields after it are 0 or None where a map was
    made without them.
    """

    id: int
    storey: int
    centroid: tuple[float, float, float]
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    voxels: int
    area: float
    isolated: bool
    centre: tuple[float, float, float] | None = None
    """A place in the room where an agent can stand, clear of walls and furniture; None: nowhere."""
    floor_area: float = 0.0
    """m², inside the walls, what stands on the floor included."""
    volume: float | None = None
    """m³ between floor and ceiling; None where no ceiling was seen on its storey."""
    completeness: float = 0.0
    """0 to 1: the part of the floor's rim at which something was seen, a wall or another room."""
    frontier: float = 0.0
    """m: the rest of the rim, open to space that was not seen."""
    kind: str = "unknown"
    """One of `ROOM_KINDS`."""
    kind_confidence: float = 0.0
    """0 to 1."""


@dataclass(frozen=True)
class Building:
    """The root of the hierarchy building, storey, room.

    `storeys` are ids, the lowest first; `bounds` hold all rooms and `floor_area` (m²) is theirs.
    """

    storeys: tuple[int, ...]
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    floor_area: float


@dataclass(frozen=True)
class Passage:
    """Where the navigable parts of two rooms meet (§4.2.9); an edge of the topological graph.

    Metres, level frame. `position` is the middle of the passage, on the floor or on the stairs.
    """

    rooms: tuple[int, int]
    position: tuple[float, float, float]
    width: float
    height: float | None = None
    """Free height: to the lintel, or over stairs; None where nothing was seen above."""
    kind: str = "unknown"
    """One of `PASSAGE_KINDS`."""
    confidence: float = 1.0
    """0 to 1: how sure it is that this is a passage between these rooms."""


@dataclass(frozen=True)
class Descriptors:
    """One named and versioned descriptor of every room: `values[i]` belongs to `rooms[i]`."""

    name: str
    version: int
    values: NDArray[np.float32]
    """(R, D) float32, R rooms in the map's order."""


@dataclass(frozen=True)
class TopometricMap:
    """One agent's partial map, or the global map of a group of agents.

    `voxels` is (N, 3) int32 in strictly increasing Morton order, `room` (N,) int32 the room id of
    each (`NO_ROOM`: none) and `offsets` (N, 3) int8 the mean of the points seen in the voxel, in
    quarters of its edge from the lower corner of the middle (-2..1). `navigable` is (M, 3) int32
    in Morton order, `viewpoints` (K, 3) float32.
    """

    agent: str
    session: str
    """New at every start or reset of the agent's extractor."""
    sequence: int
    frame_id: str
    stamp: int
    """Nanoseconds since the epoch."""
    voxel_size: float
    origin: tuple[float, float, float]
    voxels: NDArray[np.int32]
    offsets: NDArray[np.int8]
    room: NDArray[np.int32]
    navigable: NDArray[np.int32]
    viewpoints: NDArray[np.float32]
    rooms: tuple[Room, ...] = ()
    passages: tuple[Passage, ...] = ()
    storeys: tuple[Storey, ...] = ()
    descriptors: tuple[Descriptors, ...] = ()
    T_level_input: NDArray[np.float64] = field(default_factory=lambda: np.eye(4))
    warnings: tuple[str, ...] = ()
    schema: str = SCHEMA

    def __post_init__(self) -> None:
        check_map(self)

    def centres(self) -> NDArray[np.float64]:
        """Return the voxels' cell centres: (N, 3) float64, m, level frame (eq. 5)."""
        return np.asarray(self.origin) + self.voxels * self.voxel_size

    def surface(self) -> NDArray[np.float64]:
        """Return the mean point seen in each voxel: (N, 3) float64, m, level frame."""
        within = (self.offsets + 0.5) / OFFSET_STEPS
        return np.asarray(self.origin) + (self.voxels + within) * self.voxel_size

    def room_by_id(self, room_id: int) -> Room:
        """Return a room; raises MapError for an id that the map does not hold."""
        for room in self.rooms:
            if room.id == room_id:
                return room
        raise MapError(f"no room {room_id} in the map of {self.agent!r}")

    def building(self) -> Building:
        """Return the root of the hierarchy; its bounds are zeros where there is no room."""
        low, high = np.zeros((2, 3))
        if self.rooms:
            bounds = np.array([room.bounds for room in self.rooms])
            low, high = bounds[:, 0].min(axis=0), bounds[:, 1].max(axis=0)
        return Building(
            storeys=tuple(s.id for s in sorted(self.storeys, key=lambda s: s.floor_z)),
            bounds=(triple(low), triple(high)),
            floor_area=float(sum(room.floor_area for room in self.rooms)),
        )

    def rooms_of(self, storey_id: int) -> tuple[int, ...]:
        """Return the ids of the rooms on a storey."""
        return tuple(room.id for room in self.rooms if room.storey == storey_id)

    def links_of(self, storey_id: int) -> tuple[int, ...]:
        """Return which passages (their indices) lead from a storey to another one."""
        storey = {room.id: room.storey for room in self.rooms}
        ends = [[storey[room] for room in passage.rooms] for passage in self.passages]
        return tuple(i for i, (a, b) in enumerate(ends) if a != b and storey_id in (a, b))

    def descriptor(self, name: str) -> Descriptors | None:
        """Return the descriptors of that name, or None."""
        return next((d for d in self.descriptors if d.name == name), None)


def triple(values: Iterable[float]) -> tuple[float, float, float]:
    """Return three numbers, such as a row of an array, as a tuple of Python's floats."""
    x, y, z = (float(value) for value in values)
    return x, y, z
