"""What a topometric map may hold, and the checks of it that every map passes when it is made.

A map that comes from a file or over the air is checked by the same lines as one that was extracted:
what `check_map` lets through can be used without further questions.
"""

from __future__ import annotations

import re
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError

if TYPE_CHECKING:
    from topometric_ros.topometric_map import Room, Storey, TopometricMap

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

_CONTROL = re.compile(r"[\x00-\x1f\x7f-\x9f]")
"""What would break lines of a log and steer terminals."""


class MapError(TopometricError):
    """A topometric map whose parts contradict each other."""


def check_map(m: TopometricMap) -> None:
    """Raise MapError where the parts of a map contradict each other."""
    if m.schema != SCHEMA:
        raise MapError(f"unknown schema {m.schema!r}; this version reads {SCHEMA!r}")
    for name in ("agent", "session", "frame_id"):
        if _CONTROL.search(value := getattr(m, name)):
            raise MapError(f"{name}: expected a name without control characters, got {value!r}")
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
