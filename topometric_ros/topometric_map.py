"""The data model that every stage speaks: a topometric map T = (V, G) (thesis §4.1.4, eq. 20-21).

A map holds what the merger needs and no more. All positions are in metres in the map's *level
frame*: the agent's own frame, turned so that z is up (`T_level_input`, identity for nearly every
input). Voxels are integer coordinates on a lattice of cell centres `origin + k * voxel_size`.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError

SCHEMA = "topometric-map/1"
NO_ROOM = -1
OFFSET_STEPS = 16
"""A voxel's surface offset is kept in sixteenths of the voxel edge."""


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
    voxels with this label, `area` is the horizontal area they cover (m²), `isolated` says that no
    passage leads to it.
    """

    id: int
    storey: int
    centroid: tuple[float, float, float]
    bounds: tuple[tuple[float, float, float], tuple[float, float, float]]
    voxels: int
    area: float
    isolated: bool


@dataclass(frozen=True)
class Passage:
    """Where the navigable parts of two rooms meet (§4.2.9); an edge of the topological graph."""

    rooms: tuple[int, int]
    position: tuple[float, float, float]
    width: float


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
    sixteenths of its edge from the lower corner of the middle (-8..7). `navigable` is (M, 3) int32
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

    def descriptor(self, name: str) -> Descriptors | None:
        """Return the descriptors of that name, or None."""
        return next((d for d in self.descriptors if d.name == name), None)


def _check_map(m: TopometricMap) -> None:
    """Raise MapError where the parts of a map contradict each other."""
    if m.schema != SCHEMA:
        raise MapError(f"unknown schema {m.schema!r}; this version reads {SCHEMA!r}")
    if not (np.isfinite(m.voxel_size) and m.voxel_size > 0):
        raise MapError(f"voxel_size: expected a positive length in m, got {m.voxel_size}")
    if not np.isfinite(m.origin).all():
        raise MapError(f"origin: expected finite metres, got {m.origin}")
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
    if not np.isfinite(m.viewpoints).all():
        raise MapError("viewpoints must be finite")
    # Whoever uses a map inverts this, so one that is no rigid motion would fail far from here.
    R = m.T_level_input[:3, :3]
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    rigid = np.isfinite(m.T_level_input).all() and off < 1e-6 and np.linalg.det(R) > 0
    if not (rigid and np.array_equal(m.T_level_input[3], (0, 0, 0, 1))):
        raise MapError(f"T_level_input: expected a rigid motion, got {m.T_level_input.tolist()}")
    if n and (m.offsets.min() < -OFFSET_STEPS // 2 or m.offsets.max() >= OFFSET_STEPS // 2):
        raise MapError(f"offsets: expected -8..7, got {m.offsets.min()}..{m.offsets.max()}")
    _check_storeys(m.storeys)
    _check_graph(m)


def _check_storeys(storeys: tuple[Storey, ...]) -> None:
    """Raise MapError where storeys share an id or lie nowhere."""
    ids = [storey.id for storey in storeys]
    if len(set(ids)) != len(ids):
        raise MapError(f"storey ids must be unique, got {ids}")
    for storey in storeys:
        layers = storey.layers
        ceiling = 0.0 if storey.ceiling_z is None else storey.ceiling_z
        numbers = (storey.floor_z, ceiling, layers.cell, *layers.origin)
        if not np.isfinite(numbers).all() or not layers.cell > 0:
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
        if not np.isfinite((*room.centroid, *np.ravel(room.bounds), room.area)).all():
            raise MapError(f"room {room.id}: centroid, bounds and area must be finite")
    for passage in m.passages:
        if not set(passage.rooms) <= set(ids) or passage.rooms[0] == passage.rooms[1]:
            raise MapError(f"passage between rooms {passage.rooms}; known: {ids}")
        if not np.isfinite((*passage.position, passage.width)).all():
            raise MapError(f"passage {passage.rooms}: position and width must be finite")
    for entry in m.descriptors:
        if entry.values.dtype != np.float32 or entry.values.shape[:1] != (len(ids),):
            raise MapError(
                f"descriptor {entry.name}: expected float32 ({len(ids)}, D), "
                f"got {entry.values.dtype} {entry.values.shape}"
            )
        if not np.isfinite(entry.values).all():
            raise MapError(f"descriptor {entry.name}: values must be finite")
