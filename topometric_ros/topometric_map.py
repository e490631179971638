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

from topometric_ros.errors import TopometricError

SCHEMA = "topometric-map/1"
NO_ROOM = -1
PASSAGE_KINDS = ("unknown", "door", "opening", "stairs", "ramp")
ROOM_KINDS = ("unknown", "room", "corridor", "hall", "stairwell")
OFFSET_STEPS = 4
"""A voxel's surface offset is kept in quarters of the voxel edge: finer ones cost most of a message
and move no merge by more than some millimetres (docs/benchmarks.md)."""
LARGEST_POSITION = 1e9
"""m: no coordinate of a map is larger, so that sums and products of them stay finite."""
CELL_EDGES = (1e-3, 100.0)
"""m: the smallest and the largest edge of a voxel or of a raster's cell."""


class MapError(TopometricError):
    """A topometric map whose parts contradict each other."""


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
        _check_map(self)

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


def _check_map(m: TopometricMap) -> None:
    """Raise MapError where the parts of a map contradict each other."""
    if m.schema != SCHEMA:
        raise MapError(f"unknown schema {m.schema!r}; this version reads {SCHEMA!r}")
    if not CELL_EDGES[0] <= m.voxel_size <= CELL_EDGES[1]:
        raise MapError(
            f"voxel_size: expected {CELL_EDGES[0]:g} to {CELL_EDGES[1]:g} m, got {m.voxel_size}"
        )
    if not _believable(m.origin):
        raise MapError(f"origin: expected metres up to {LARGEST_POSITION:g}, got {m.origin}")
    n = len(m.voxels)
    for name, dtype, shape in (
        ("voxels", np.int32, (n, 3)),
        ("offsets", np.int8, (n, 3)),
        ("room", np.int32, (n,)),
        ("navigable", np.int32, (len(m.navigable), 3)),
        ("viewpoints", np.float32, (len(m.viewpoints), 3)),
        ("T_level_input", np.float64, (4, 4)),
    ):
        array = getattr(m, name)
        if array.dtype != dtype or array.shape != shape:
            raise MapError(
                f"{name}: expected {np.dtype(dtype)} {shape}, got {array.dtype} {array.shape}"
            )
    if not _believable(m.viewpoints):
        raise MapError(f"viewpoints must be finite and at most {LARGEST_POSITION:g} m")
    # Whoever uses a map inverts this, so one that is no rigid motion would fail far from here.
    if not (_believable(m.T_level_input) and _is_rigid(m.T_level_input)):
        raise MapError(f"T_level_input: expected a rigid motion, got {m.T_level_input.tolist()}")
    if n and (m.offsets.min() < -OFFSET_STEPS // 2 or m.offsets.max() >= OFFSET_STEPS // 2):
        raise MapError(f"offsets: expected -2..1, got {m.offsets.min()}..{m.offsets.max()}")
    _check_storeys(m.storeys)
    _check_graph(m)


def _believable(values: object) -> bool:
    """Whether all numbers are finite and none is larger than a position may be."""
    # Also false for what is not a number.
    return bool((np.abs(np.asarray(values, np.float64)) <= LARGEST_POSITION).all())


def _is_rigid(T: NDArray[np.float64]) -> bool:
    R = T[:3, :3]
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    return off < 1e-6 and np.linalg.det(R) > 0 and np.array_equal(T[3], (0, 0, 0, 1))


def _check_storeys(storeys: tuple[Storey, ...]) -> None:
    """Raise MapError where storeys share an id or lie nowhere."""
    ids = [storey.id for storey in storeys]
    if len(set(ids)) != len(ids):
        raise MapError(f"storey ids must be unique, got {ids}")
    for storey in storeys:
        layers = storey.layers
        ceiling = 0.0 if storey.ceiling_z is None else storey.ceiling_z
        numbers = (storey.floor_z, ceiling, layers.cell, *layers.origin)
        edge = CELL_EDGES[0] <= layers.cell <= CELL_EDGES[1]
        if not (_believable(numbers) and edge):
            raise MapError(
                f"storey {storey.id}: expected finite heights and a raster, got {numbers}"
            )


def _check_graph(m: TopometricMap) -> None:
    """Raise MapError where rooms, passages, storeys and descriptors do not fit together."""
    ids = [room.id for room in m.rooms]
    storeys = {storey.id for storey in m.storeys}
    if len(set(ids)) != len(ids) or any(i < 0 for i in ids):
        raise MapError(f"room ids must be unique and not negative, got {ids}")
    used = set(np.unique(m.room).tolist()) - {NO_ROOM}
    if not used <= set(ids):
        raise MapError(f"voxels name rooms {sorted(used - set(ids))} that the map does not list")
    for room in m.rooms:
        if room.storey not in storeys:
            raise MapError(f"room {room.id} lies on storey {room.storey}; known: {sorted(storeys)}")
        _check_room(room)
    for passage in m.passages:
        if not set(passage.rooms) <= set(ids) or passage.rooms[0] == passage.rooms[1]:
            raise MapError(f"passage between rooms {passage.rooms}; known: {ids}")
        height = 0.0 if passage.height is None else passage.height
        if not _believable((*passage.position, passage.width, height)):
            raise MapError(f"passage {passage.rooms}: position, width and height must be finite")
        if passage.kind not in PASSAGE_KINDS or not 0.0 <= passage.confidence <= 1.0:
            raise MapError(
                f"passage {passage.rooms}: expected a kind of {', '.join(PASSAGE_KINDS)} and a "
                f"confidence of 0 to 1, got {passage.kind!r} and {passage.confidence}"
            )
    for entry in m.descriptors:
        if entry.values.dtype != np.float32 or entry.values.shape[:1] != (len(ids),):
            raise MapError(
                f"descriptor {entry.name}: expected float32 ({len(ids)}, D), "
                f"got {entry.values.dtype} {entry.values.shape}"
            )
        if not np.isfinite(entry.values).all():
            raise MapError(f"descriptor {entry.name}: values must be finite")


def _check_room(room: Room) -> None:
    """Raise MapError where a room's numbers cannot be."""
    numbers = (*room.centroid, *np.ravel(room.bounds), room.area)
    if not _believable(numbers):
        raise MapError(f"room {room.id}: centroid, bounds and area must be finite")
    measured = (room.floor_area, room.volume or 0.0, room.frontier, *(room.centre or ()))
    if not np.isfinite(measured).all() or not _believable(room.centre or ()):
        raise MapError(f"room {room.id}: expected finite attributes, got {measured}")
    if not 0.0 <= room.completeness <= 1.0 or not 0.0 <= room.kind_confidence <= 1.0:
        raise MapError(
            f"room {room.id}: completeness and kind_confidence: expected 0 to 1, "
            f"got {room.completeness} and {room.kind_confidence}"
        )
    if room.kind not in ROOM_KINDS:
        raise MapError(
            f"room {room.id}: expected a kind of {', '.join(ROOM_KINDS)}, got {room.kind!r}"
        )
