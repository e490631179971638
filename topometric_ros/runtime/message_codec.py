"""TopometricMap to and from its message, exactly, whatever library the message classes are of.

The classes come as a namespace with their bare names: rclpy's in the nodes, rosbags' in replay.
`docs/formats.md` tells what lies in the packed fields. A message that cannot be right is refused.
"""

from __future__ import annotations

import array
import dataclasses
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.io.packing import (
    MAXIMUM_ITEMS,
    PackingError,
    pack_array,
    pack_bits,
    pack_coords,
    pack_offsets,
    unpack_array,
    unpack_bits,
    unpack_coords,
    unpack_offsets,
)
from topometric_ros.runtime.graph_codec import (
    building_message,
    number_field,
    passage_from,
    passage_message,
    point_from,
    point_message,
    room_from,
    room_message,
)
from topometric_ros.topometric_map import (
    Descriptors,
    MapError,
    Storey,
    StoreyLayers,
    TopometricMap,
)

_SECOND = 1_000_000_000
_LONGEST_NAME = 200
_MASKS = ("wall", "furniture", "free", "bare")


class CodecError(TopometricError):
    """A message that cannot be right: wrong sizes, unknown schema, numbers that are not finite."""


@dataclass(frozen=True)
class ReceivedMap:
    """A map from a message; `observed_by` and `observers` are empty but in a global map."""

    map: TopometricMap
    observed_by: NDArray[np.uint32] | None
    observers: tuple[str, ...]


def map_to_message(
    m: TopometricMap,
    classes: Any,
    observed_by: NDArray[np.uint32] | None = None,
    observers: tuple[str, ...] = (),
) -> Any:
    """Return a map as topometric_msgs/TopometricMap of the given classes.

    Raises
    ------
    CodecError
        The map cannot be put into a message.
    """
    kind = classes.TopometricMap
    try:
        return kind(
            header=header(classes, m.frame_id, m.stamp),
            schema=m.schema,
            agent=m.agent,
            session=m.session,
            sequence=int(m.sequence),
            voxel_size=float(m.voxel_size),
            origin=point_message(classes.Point, m.origin),
            t_level_input=matrix_field(m.T_level_input),
            voxel_count=len(m.voxels),
            voxels=byte_field(kind, pack_coords(m.voxels)),
            offsets=byte_field(kind, pack_offsets(m.offsets)),
            room_of_voxel=byte_field(kind, pack_array(m.room)),
            observers=list(observers),
            observed_by=byte_field(kind, b"" if observed_by is None else pack_array(observed_by)),
            navigable_count=len(m.navigable),
            navigable=byte_field(kind, pack_coords(m.navigable)),
            viewpoints=[point_message(classes.Point32, point) for point in m.viewpoints],
            rooms=[room_message(room, classes) for room in m.rooms],
            passages=[passage_message(passage, classes) for passage in m.passages],
            storeys=[_storey_message(storey, m, classes) for storey in m.storeys],
            building=building_message(m, classes),
            descriptors=[_descriptors_message(entry, classes) for entry in m.descriptors],
            warnings=list(m.warnings),
        )
    except PackingError as error:
        raise CodecError(f"map of {m.agent!r}: {error}") from error


def without_mean_points(m: TopometricMap) -> TopometricMap:
    """Return a map whose message is small: of the surface it says in which voxels it lies."""
    return dataclasses.replace(m, offsets=np.zeros_like(m.offsets))


def map_from_message(message: Any, most: int = MAXIMUM_ITEMS) -> ReceivedMap:
    """Return the map that a topometric_msgs/TopometricMap of any library holds.

    Parameters
    ----------
    message : of the message classes of any library
    most : voxels, and raster cells of all storeys together, that a map may have; what announces
        more is refused before any memory is taken

    Raises
    ------
    CodecError
        The message cannot be right, or holds more than `most`.
    """
    try:
        _check_size(message, most)
        topometric_map = _map(message)
        observed_by = None
        if len(message.observed_by):
            shape = (int(message.voxel_count),)
            observed_by = unpack_array(
                bytes(message.observed_by), np.uint32, shape, "observed_by"
            ).astype(np.uint32)
        return ReceivedMap(topometric_map, observed_by, tuple(map(str, message.observers)))
    except (PackingError, MapError, ValueError, OverflowError) as error:
        raise CodecError(f"map of {str(message.agent)[:_LONGEST_NAME]!r}: {error}") from error


def _check_size(message: Any, most: int) -> None:
    """Refuse a message that names no agent or unpacks to more than a reader wants to hold."""
    agent = str(message.agent)
    if not agent or not agent.isprintable() or len(agent) > _LONGEST_NAME:
        raise PackingError("agent: expected a name of up to 200 characters that can be printed")
    cells = sum(int(s.layers.cells_x) * int(s.layers.cells_y) for s in message.storeys)
    for what, count in (
        ("voxels", int(message.voxel_count)),
        ("navigable", int(message.navigable_count)),
        ("storeys: raster cells", cells),
    ):
        if count > most:
            raise PackingError(f"{what}: {count} items are announced, at most {most} are read")


def header(classes: Any, frame_id: str, stamp: int) -> Any:
    """Return a std_msgs/Header; raises CodecError for a stamp (ns) that a message cannot hold."""
    seconds, nanoseconds = divmod(int(stamp), _SECOND)
    if not 0 <= seconds < 1 << 31:
        raise CodecError(f"stamp: expected 0 to {(1 << 31) - 1} s, got {seconds} s")
    time = classes.Time(sec=seconds, nanosec=nanoseconds)
    return classes.Header(stamp=time, frame_id=frame_id)


def stamp_of(message_header: Any) -> int:
    """Return a header's stamp in ns since the epoch."""
    return int(message_header.stamp.sec) * _SECOND + int(message_header.stamp.nanosec)


def byte_field(kind: type, raw: bytes) -> Any:
    """Return bytes in the form that a `uint8[]` of this message class takes quickly.

    rosbags (dataclasses) wants a numpy array; rclpy an array.array, a numpy array would be checked
    number by number.
    """
    if dataclasses.is_dataclass(kind):
        return np.frombuffer(raw, np.uint8)
    return array.array("B", raw)


def matrix_field(T: NDArray[np.float64] | None, size: int = 16) -> NDArray[np.float64]:
    """Return a matrix as the row-major fixed array of a message, zeros where there is none."""
    return np.zeros(size) if T is None else np.ascontiguousarray(T, np.float64).reshape(size)


def matrix_from(field: Any, side: int = 4, what: str = "transform") -> NDArray[np.float64]:
    """Undo :func:`matrix_field`; raises CodecError for a wrong size or numbers not finite."""
    values = np.array(field, dtype=np.float64).reshape(-1)
    if values.size != side * side or not np.isfinite(values).all():
        raise CodecError(f"{what}: expected {side * side} finite numbers, got {values.tolist()}")
    return values.reshape(side, side)


def _storey_message(storey: Storey, m: TopometricMap, classes: Any) -> Any:
    layers = storey.layers
    kind = classes.StoreyLayers
    return classes.Storey(
        id=int(storey.id),
        floor_z=float(storey.floor_z),
        has_ceiling=storey.ceiling_z is not None,
        ceiling_z=float(storey.ceiling_z or 0.0),
        layers=kind(
            cell=float(layers.cell),
            origin_x=float(layers.origin[0]),
            origin_y=float(layers.origin[1]),
            cells_x=layers.wall.shape[0],
            cells_y=layers.wall.shape[1],
            **{name: byte_field(kind, pack_bits(getattr(layers, name))) for name in _MASKS},
        ),
        rooms=number_field(classes.Storey, "i", m.rooms_of(storey.id)),
        links=number_field(classes.Storey, "I", m.links_of(storey.id)),
    )


def _descriptors_message(entry: Descriptors, classes: Any) -> Any:
    values = np.ascontiguousarray(entry.values, np.float32).reshape(-1)
    kind = classes.Descriptors
    return kind(
        name=entry.name,
        version=int(entry.version),
        dimension=entry.values.shape[1],
        values=values if dataclasses.is_dataclass(kind) else array.array("f", values.tobytes()),
    )


def _map(message: Any) -> TopometricMap:
    count = int(message.voxel_count)
    viewpoints = [(p.x, p.y, p.z) for p in message.viewpoints]
    return TopometricMap(
        schema=message.schema,
        agent=message.agent,
        session=message.session,
        sequence=int(message.sequence),
        frame_id=message.header.frame_id,
        stamp=stamp_of(message.header),
        voxel_size=float(message.voxel_size),
        origin=point_from(message.origin),
        voxels=unpack_coords(bytes(message.voxels), count),
        offsets=unpack_offsets(bytes(message.offsets), count),
        room=_int32(message.room_of_voxel, count),
        navigable=unpack_coords(
            bytes(message.navigable), int(message.navigable_count), "navigable"
        ),
        viewpoints=np.array(viewpoints, np.float32).reshape(-1, 3),
        rooms=tuple(room_from(room) for room in message.rooms),
        passages=tuple(passage_from(passage) for passage in message.passages),
        storeys=tuple(_storey(storey) for storey in message.storeys),
        descriptors=tuple(_descriptors(e, len(message.rooms)) for e in message.descriptors),
        T_level_input=matrix_from(message.t_level_input, what="t_level_input"),
        warnings=tuple(map(str, message.warnings)),
    )


def _int32(field: Any, count: int) -> NDArray[np.int32]:
    return unpack_array(bytes(field), np.int32, (count,), "room_of_voxel").astype(np.int32)


def _storey(message: Any) -> Storey:
    layers = message.layers
    shape = (int(layers.cells_x), int(layers.cells_y))
    masks = {name: unpack_bits(bytes(getattr(layers, name)), shape, name) for name in _MASKS}
    return Storey(
        id=int(message.id),
        floor_z=float(message.floor_z),
        ceiling_z=float(message.ceiling_z) if message.has_ceiling else None,
        layers=StoreyLayers(
            cell=float(layers.cell),
            origin=(float(layers.origin_x), float(layers.origin_y)),
            **masks,
        ),
    )


def _descriptors(message: Any, rooms: int) -> Descriptors:
    values = np.array(message.values, np.float32)
    if values.size != rooms * message.dimension:
        raise CodecError(
            f"descriptor {message.name}: expected {rooms} x {message.dimension} values, "
            f"got {values.size}"
        )
    shaped = values.reshape(rooms, int(message.dimension))
    return Descriptors(str(message.name), int(message.version), shaped)
