"""Putting what the stages found together as rooms and storeys of a topometric map."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.extraction.attributes import RoomAttributes, room_attributes
from topometric_ros.extraction.mapped_rooms import MappedRooms
from topometric_ros.extraction.room_kinds import GeometricClassifier, RoomClassifier, RoomView, told
from topometric_ros.topometric_map import NO_ROOM, Passage, Room, triple
from topometric_ros.voxels.grid import bounds


def storeys_of_rooms(room: NDArray[np.int32], storey: NDArray[np.int32]) -> dict[int, int]:
    """Return the storey of each room: that of most of its voxels.

    Parameters
    ----------
    room : (N,) int32, NO_ROOM for voxels in none
    storey : (N,) int32, the storey of each voxel
    """
    known = np.flatnonzero(room != NO_ROOM)
    if len(known) == 0:
        return {}
    held = np.bincount(room[known]) > 0
    of_most = majority((np.cumsum(held) - 1)[room[known]], storey[known])
    return dict(zip(np.flatnonzero(held).tolist(), of_most.tolist(), strict=True))


def assemble_rooms(
    rooms: MappedRooms,
    passages: Sequence[Passage],
    classifier: RoomClassifier | None = None,
) -> tuple[Room, ...]:
    """Describe every room that has voxels with its attributes, ordered by id.

    Rooms that none of the `passages` leads to are isolated. The `classifier` tells their kinds,
    without one their geometry.
    """
    classifier = GeometricClassifier() if classifier is None else classifier
    reached = {room_id for passage in passages for room_id in passage.rooms}
    measured = room_attributes(rooms)
    room = rooms.room
    order = np.argsort(room, kind="stable")
    starts = np.flatnonzero(np.diff(room[order], prepend=NO_ROOM - 1))
    ids = room[order[starts]]
    described = []
    columns = _columns_of(rooms.columns.starts, rooms.columns.order, room).tolist()
    for room_id, rows in zip(ids.tolist(), np.split(order, starts[1:]), strict=True):
        if room_id != NO_ROOM:
            storey, size = rooms.storey_of_room[room_id], rooms.grid.voxel_size
            points = rooms.grid.origin + rooms.grid.coords[rows] * size
            plain = _room(points, size, room_id, storey, room_id not in reached, columns[room_id])
            found = measured[room_id]
            view = _view(room_id, points, size, found, passages)
            kind, sure = told(classifier, view)
            described.append(
                replace(
                    plain,
                    centre=found.centre,
                    floor_area=found.floor_area,
                    volume=found.volume,
                    completeness=found.completeness,
                    frontier=found.frontier,
                    kind=kind,
                    kind_confidence=sure,
                )
            )
    return tuple(described)


def _view(
    room: int,
    points: NDArray[np.float64],
    size: float,
    found: RoomAttributes,
    passages: Sequence[Passage],
) -> RoomView:
    """Return what a classifier is shown of a room; `points` are its voxels' centres."""
    own = [passage for passage in passages if room in passage.rooms]
    return RoomView(
        floor=found.floor,
        cell=size,
        points=points,
        height=found.height,
        neighbours=len({other for passage in own for other in passage.rooms} - {room}),
        stairs=sum(passage.kind == "stairs" for passage in own),
    )


def _room(
    points: NDArray[np.float64],
    size: float,
    room_id: int,
    storey: int,
    isolated: bool,
    columns: int,
) -> Room:
    """Return the room of the voxels of edge `size` round `points` (n, 3), n > 0.

    Its `bounds` hold whole cells; `columns` is how many columns of voxels it has.
    """
    low, high = bounds(points)
    return Room(
        id=room_id,
        storey=storey,
        centroid=triple(points.mean(0)),
        bounds=(triple(low - size / 2), triple(high + size / 2)),
        voxels=len(points),
        area=columns * size**2,
        isolated=isolated,
    )


@njit(cache=True, nogil=True)
def _columns_of(starts, order, room):  # type: ignore[no-untyped-def]
    """How many columns hold voxels of each room: (highest id + 1,)."""
    count = np.zeros(int(room.max()) + 1, np.int64)
    last = np.full(len(count), -1, np.int64)
    for column in range(len(starts) - 1):
        for i in range(starts[column], starts[column + 1]):
            own = room[order[i]]
            if own >= 0 and last[own] != column:
                last[own] = column
                count[own] += 1
    return count


def majority(group: NDArray[np.int64], labels: NDArray[np.int32]) -> NDArray[np.int32]:
    """Return the commonest label of each group, ties by the lowest: (G,) int32.

    Parameters
    ----------
    group : (P,) the group of each label; every group from 0 to G - 1 occurs
    labels : (P,) int32, -1 or more
    """
    found: NDArray[np.int32] = _commonest(group, labels)
    return found


@njit(cache=True, nogil=True)
def _commonest(group, labels):  # type: ignore[no-untyped-def]
    count = int(group.max()) + 1
    starts = np.zeros(count + 1, np.int64)
    for g in group:
        starts[g + 1] += 1
    starts = np.cumsum(starts)
    place = starts[:-1].copy()
    sorted_labels = np.empty(len(labels), np.int32)
    for i in range(len(labels)):
        sorted_labels[place[group[i]]] = labels[i]
        place[group[i]] += 1
    result = np.empty(count, np.int32)
    for g in range(count):
        own = sorted_labels[starts[g] : starts[g + 1]]
        result[g] = own[0]
        i = 1
        while i < len(own) and own[i] == own[0]:
            i += 1
        if i == len(own):  # most groups are of one label
            continue
        own.sort()
        most, run = 0, 0
        for i in range(len(own)):
            run = run + 1 if i and own[i] == own[i - 1] else 1
            if run > most:
                most = run
                result[g] = own[i]
    return result
