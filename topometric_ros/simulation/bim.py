"""BIM models: triangles by element (.npz) and the rooms and links of the model (.json).

The archive holds `V` (n, 3) m, z up, `F` (m, 3), `face_element` (m,), `element_type` (e,); the
JSON file of the same name holds `storeys` [name, height], `rooms` and `links`.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import one_line
from topometric_ros.io.clouds import DAMAGED_NUMPY
from topometric_ros.simulation.building import BuildingError
from topometric_ros.simulation.labelled import (
    STRUCTURE,
    LabelledBuilding,
    TrueLink,
    TrueRoom,
    join_rings,
)
from topometric_ros.simulation.room_kinds import kind_of_name

_LEFT_OUT = ("IfcSpace", "IfcDoor")
"""The air of a room, and the leaves of doors: without them every door stands open."""
_MOVABLE = ("IfcFurnishingElement", "IfcFurniture", "IfcSystemFurnitureElement")
"""Washbasins and radiators (IfcFlowTerminal, IfcSpaceHeater) are fixed, proxies are anything."""

_FARTHEST = 1e5
"""m from the origin: a room's outline is walked along in steps."""


def load_bim(path: Path) -> LabelledBuilding:
    """Return the building of a .npz archive and the .json file beside it.

    Raises
    ------
    BuildingError
        A file is missing or lacks a field.
    """
    try:
        with np.load(path, allow_pickle=False) as archive:
            vertices = archive["V"].astype(np.float64)
            faces = archive["F"].astype(np.int32)
            element = archive["face_element"]
            types = archive["element_type"]
        truth = json.loads(path.with_suffix(".json").read_text(encoding="utf-8"))
        rooms = _rooms(truth)
        links = _links(truth["links"], rooms)
        kept = ~np.isin(types, _LEFT_OUT)[element]
        movable = np.isin(types, _MOVABLE)
        tags = np.where(movable, np.cumsum(movable), STRUCTURE)[element[kept]]
        return LabelledBuilding(
            path.stem, vertices, faces[kept], rooms, links, face_tag=tags.astype(np.int32)
        )
    except KeyError as error:
        raise BuildingError(f"{path}: the model has no {error}") from error
    except (OSError, TypeError, IndexError, AttributeError, *DAMAGED_NUMPY) as error:
        raise BuildingError(f"{path}: cannot be read: {one_line(error)}") from error


def _rooms(truth: dict[str, Any]) -> tuple[TrueRoom, ...]:
    heights = dict(truth["storeys"])
    used = {room["storey"] for room in truth["rooms"]}
    storeys = sorted(used, key=lambda name: heights[name])
    rooms = []
    for i, room in enumerate(truth["rooms"]):
        rings = []
        for part in room["polygon"]:
            rings += [np.array(ring, dtype=np.float64) for ring in (part["ext"], *part["holes"])]
        if not all((np.abs(ring) <= _FARTHEST).all() for ring in rings):
            raise ValueError(f"room {i}: expected a polygon in metres, up to {_FARTHEST:g}")
        rings = [ring[:-1] if np.array_equal(ring[0], ring[-1]) else ring for ring in rings]
        name = " ".join(word for word in (room["name"], room["long"]) if word)
        kind = kind_of_name(room["long"] or room["name"])
        storey = storeys.index(room["storey"])
        rooms.append(TrueRoom(i, name, kind, storey, join_rings(rings), room["z0"], room["z1"]))
    return tuple(rooms)


def _links(links: list[dict[str, Any]], rooms: tuple[TrueRoom, ...]) -> tuple[TrueLink, ...]:
    """Links between two rooms; those to the outside are left out."""
    found = []
    for link in links:
        if link["a"] is None or link["b"] is None or link["a"] == link["b"]:
            continue
        pair = rooms[link["a"]], rooms[link["b"]]
        if link["kind"] == "virtual":
            place, width = _shared_edge(pair[0], pair[1]), float(link["length"])
        else:
            place, width = np.array(link["center"], dtype=np.float64), link.get("width", 1.0)
        floor = min(room.z_low for room in pair)
        if link["kind"] == "stair":
            floor = (link["z0"] + link["z1"]) / 2
        elif len(place) == 3:
            floor = place[2]
        position = np.array([place[0], place[1], floor])
        found.append(TrueLink((pair[0].id, pair[1].id), link["kind"], position, float(width)))
    return tuple(found)


def _shared_edge(a: TrueRoom, b: TrueRoom, spacing: float = 0.05) -> NDArray[np.float64]:
    """Return the point of one room's outline that lies in the middle of what both share: (2,)."""
    from scipy.spatial import cKDTree

    along = [_points_along(room.polygon, spacing) for room in (a, b)]
    distance, _ = cKDTree(along[1]).query(along[0])
    shared = along[0][distance <= max(float(distance.min()) + spacing, 2 * spacing)]
    middle = shared.mean(axis=0)
    nearest: NDArray[np.float64] = shared[np.argmin(((shared - middle) ** 2).sum(axis=1))]
    return nearest


def _points_along(polygon: NDArray[np.float64], spacing: float) -> NDArray[np.float64]:
    """Return points at about equal distances along a polygon: (N, 2), m."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    counts = np.maximum(1, np.ceil(np.hypot(*edges.T) / spacing)).astype(int)
    return np.concatenate(
        [
            start + edge * (np.arange(count) / count)[:, None]
            for start, edge, count in zip(polygon, edges, counts, strict=True)
        ]
    )
