"""Pictures of an evaluation: found rooms in colour, the true rooms' outlines over them."""

from __future__ import annotations

import dataclasses

import numpy as np
from numpy.typing import NDArray

from topometric_ros.topometric_map import Room, TopometricMap
from topometric_ros.visualization.figures import draw_map
from topometric_ros.visualization.plan import storey_plan
from topometric_ros.visualization.sheet import INK, Sheet

TRUTH = "#d1003f"
_SMALLEST = 1.0
"""Slivers of true rooms, seen through doors, that cover less (m²) get no outline."""
_SPAN = 0.3
"""A room's lowest voxels may lie this far below its storey's floor, m."""


def rooms_over_truth(m: TopometricMap, true_room: NDArray[np.int32]) -> bytes | None:
    """Draw a map with its topological graph and outline the true rooms (N,) of its voxels.

    None where the map is empty.
    """
    sheet = Sheet()
    placed = draw_map(sheet, m)
    if not placed:
        return None
    truth = _with_true_rooms(m, true_room)
    for plan, pose in placed:
        true = storey_plan(truth, plan.storey)
        for room in np.unique(true.rooms[true.rooms >= 0]).tolist():
            mask = true.rooms == room
            if mask.sum() * true.cell**2 >= _SMALLEST:
                sheet.outline(mask, true.origin, true.cell, pose, TRUTH, 1.8)
    sheet.legend([("walls", INK, "patch"), ("true rooms", TRUTH, "line")])
    return sheet.png(width=8.0)


def _with_true_rooms(m: TopometricMap, true_room: NDArray[np.int32]) -> TopometricMap:
    """Return the map with the true rooms in place of the found ones, each on its storey."""
    z = m.centres()[:, 2]
    storeys = sorted(m.storeys, key=lambda storey: storey.floor_z)
    rooms = []
    for room in np.unique(true_room[true_room >= 0]).tolist():
        height = float(np.quantile(z[true_room == room], 0.02)) + _SPAN
        below = [storey for storey in storeys if storey.floor_z <= height] or storeys[:1]
        nowhere = (0.0, 0.0, 0.0)
        rooms.append(Room(room, below[-1].id, nowhere, (nowhere, nowhere), 0, 0.0, True))
    return dataclasses.replace(
        m, room=true_room.astype(np.int32), rooms=tuple(rooms), passages=(), descriptors=()
    )
