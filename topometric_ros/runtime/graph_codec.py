"""The topological graph to and from its messages: rooms, passages and the building.

What may be unknown travels as a flag and a number, because a message has no word for None.
"""

from __future__ import annotations

import array
import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from topometric_ros.topometric_map import Passage, Room, TopometricMap

_NOWHERE = (0.0, 0.0, 0.0)


def point_message(kind: Any, values: Any) -> Any:
    """Return x, y, z as a message of the given class."""
    x, y, z = values
    return kind(x=float(x), y=float(y), z=float(z))


def point_from(point: Any) -> tuple[float, float, float]:
    """Undo :func:`point_message`."""
    return float(point.x), float(point.y), float(point.z)


def number_field(kind: type, code: str, values: Sequence[int]) -> Any:
    """Return integers as a message class takes them: `code` is "i" for int32, "I" for uint32.

    rosbags (dataclasses) wants a numpy array, rclpy an array.array.
    """
    if dataclasses.is_dataclass(kind):
        return np.array(values, np.int32 if code == "i" else np.uint32)
    return array.array(code, values)


def room_message(room: Room, classes: Any) -> Any:
    """Return a room as topometric_msgs/Room of the given classes."""
    return classes.Room(
        id=int(room.id),
        storey=int(room.storey),
        centroid=point_message(classes.Point, room.centroid),
        bounds_min=point_message(classes.Point, room.bounds[0]),
        bounds_max=point_message(classes.Point, room.bounds[1]),
        voxels=int(room.voxels),
        area=float(room.area),
        isolated=bool(room.isolated),
        has_centre=room.centre is not None,
        centre=point_message(classes.Point, room.centre or _NOWHERE),
        floor_area=float(room.floor_area),
        has_volume=room.volume is not None,
        volume=float(room.volume or 0.0),
        completeness=float(room.completeness),
        frontier=float(room.frontier),
        kind=room.kind,
        kind_confidence=float(room.kind_confidence),
    )


def room_from(message: Any) -> Room:
    """Undo :func:`room_message`."""
    return Room(
        id=int(message.id),
        storey=int(message.storey),
        centroid=point_from(message.centroid),
        bounds=(point_from(message.bounds_min), point_from(message.bounds_max)),
        voxels=int(message.voxels),
        area=float(message.area),
        isolated=bool(message.isolated),
        centre=point_from(message.centre) if message.has_centre else None,
        floor_area=float(message.floor_area),
        volume=float(message.volume) if message.has_volume else None,
        completeness=float(message.completeness),
        frontier=float(message.frontier),
        kind=str(message.kind),
        kind_confidence=float(message.kind_confidence),
    )


def passage_message(passage: Passage, classes: Any) -> Any:
    """Return a passage as topometric_msgs/Passage of the given classes."""
    return classes.Passage(
        room_a=int(passage.rooms[0]),
        room_b=int(passage.rooms[1]),
        position=point_message(classes.Point, passage.position),
        width=float(passage.width),
        has_height=passage.height is not None,
        height=float(passage.height or 0.0),
        kind=passage.kind,
        confidence=float(passage.confidence),
    )


def passage_from(message: Any) -> Passage:
    """Undo :func:`passage_message`."""
    return Passage(
        rooms=(int(message.room_a), int(message.room_b)),
        position=point_from(message.position),
        width=float(message.width),
        height=float(message.height) if message.has_height else None,
        kind=str(message.kind),
        confidence=float(message.confidence),
    )


def building_message(m: TopometricMap, classes: Any) -> Any:
    """Return the root of a map's hierarchy as topometric_msgs/Building of the given classes."""
    building = m.building()
    return classes.Building(
        storeys=number_field(classes.Building, "i", building.storeys),
        bounds_min=point_message(classes.Point, building.bounds[0]),
        bounds_max=point_message(classes.Point, building.bounds[1]),
        floor_area=building.floor_area,
    )
