"""What people and other programs look at: map.json (a summary) and rooms.ply (docs/formats.md)."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.quality import Quality
from topometric_ros.io.map_format import MapFileError
from topometric_ros.io.ply import write_ply
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.palette import room_colours


def map_summary(m: TopometricMap, quality: Quality | None = None) -> dict[str, Any]:
    """Return the content of map.json; positions are in the level frame.

    `quality` is the report of the extraction, where the map was just extracted.
    """
    return {
        "schema": m.schema,
        "agent": m.agent,
        "frame_id": m.frame_id,
        "voxel_size": float(m.voxel_size),
        "warnings": list(m.warnings),
        "T_level_input": [floats(row) for row in m.T_level_input],
        **graph_fields(m),
        "storeys": [
            {
                "id": int(s.id),
                "floor_z": float(s.floor_z),
                "ceiling_z": optional(s.ceiling_z),
                "rooms": list(m.rooms_of(s.id)),
                "links": list(m.links_of(s.id)),
            }
            for s in m.storeys
        ],
        "building": building_fields(m),
        **({} if quality is None else {"quality": quality.content()}),
    }


def write_rooms_ply(
    path: Path, m: TopometricMap, observed_by: NDArray[np.uint32] | None = None
) -> None:
    """Write one vertex a voxel: its cell centre in the input's frame, its room and a colour.

    With `observed_by` (N,) the property `agent` is added: the bit mask of who saw the voxel.
    """
    centres = m.centres()
    if not np.array_equal(m.T_level_input, np.eye(4)):
        T_input_level = np.linalg.inv(m.T_level_input)
        centres = centres @ T_input_level[:3, :3].T + T_input_level[:3, 3]
    dtype = [(axis, "<f8") for axis in "xyz"] + [("room", "<i4")]
    dtype += [(channel, "u1") for channel in ("red", "green", "blue")]
    dtype += [("agent", "<i4")] if observed_by is not None else []
    vertices = np.empty(len(centres), dtype)
    for axis, name in enumerate("xyz"):
        vertices[name] = centres[:, axis]
    vertices["room"] = m.room
    colours = room_colours(m.room)
    for channel, name in enumerate(("red", "green", "blue")):
        vertices[name] = colours[:, channel]
    if observed_by is not None:
        vertices["agent"] = observed_by.view(np.int32)
    write_ply(path, vertices)


def write_json(path: Path, content: Any) -> None:
    """Write JSON in one step, refusing numbers that JSON has no word for."""
    write_atomically(path, (json.dumps(content, indent=1, allow_nan=False) + "\n").encode())


def write_atomically(path: Path, data: bytes, durable: bool = False) -> None:
    """Write a file in one step, so that nobody ever reads half of it.

    With `durable` the bytes are on the disk before the older file goes: also where the power fails.
    Two processes that write one file do not mix: the last one's stays.
    """
    if path.exists() and not path.is_file():
        # Renaming would put a file in the place of a device or a pipe.
        raise MapFileError(f"{path}: cannot be written: a folder, a device or a pipe has that name")
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    try:
        with partial.open("wb") as file:
            file.write(data)
            if durable:
                file.flush()
                os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        with contextlib.suppress(OSError):
            partial.unlink()  # On a full disk it would take what others need.
        raise MapFileError(f"{path}: cannot be written: {error.strerror or error}") from error


def floats(values: Any) -> list[float]:
    """Return numbers of any kind as Python floats, which JSON keeps exactly."""
    return [float(value) for value in values]


def matrix_rows(matrix: NDArray[np.float64] | None) -> list[list[float]] | None:
    """Return a matrix as rows of Python floats, and None as it is."""
    return None if matrix is None else [floats(row) for row in matrix]


def optional(value: float | None) -> float | None:
    """Return a number as a Python float, and None as it is."""
    return None if value is None else float(value)


def graph_fields(m: TopometricMap) -> dict[str, Any]:
    """Return rooms and passages as map.json and the header of a .tmap hold them."""
    return {
        "rooms": [
            {
                "id": int(room.id),
                "storey": int(room.storey),
                "centroid": floats(room.centroid),
                "bounds": [floats(corner) for corner in room.bounds],
                "voxels": int(room.voxels),
                "area": float(room.area),
                "isolated": bool(room.isolated),
                "centre": None if room.centre is None else floats(room.centre),
                "floor_area": float(room.floor_area),
                "volume": optional(room.volume),
                "completeness": float(room.completeness),
                "frontier": float(room.frontier),
                "kind": room.kind,
                "kind_confidence": float(room.kind_confidence),
            }
            for room in m.rooms
        ],
        "passages": [
            {
                "rooms": [int(room_id) for room_id in passage.rooms],
                "position": floats(passage.position),
                "width": float(passage.width),
                "height": optional(passage.height),
                "kind": passage.kind,
                "confidence": float(passage.confidence),
            }
            for passage in m.passages
        ],
    }


def building_fields(m: TopometricMap) -> dict[str, Any]:
    """Return the root of the hierarchy building, storey, room as map.json holds it."""
    building = m.building()
    return {
        "storeys": list(building.storeys),
        "bounds": [floats(corner) for corner in building.bounds],
        "floor_area": building.floor_area,
    }


def rounded_timings(timings: dict[str, float]) -> dict[str, float]:
    """Return CPU seconds by stage to a tenth of a millisecond."""
    return {stage: round(float(seconds), 4) for stage, seconds in timings.items()}
