"""Map files (.tmap): everything that a topometric map holds, exactly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import one_line
from topometric_ros.io.map_format import MapFileError, Section, decode, encode, read_container
from topometric_ros.io.packing import PackingError
from topometric_ros.io.summaries import (
    building_fields,
    floats,
    graph_fields,
    optional,
    write_atomically,
)
from topometric_ros.topometric_map import (
    Descriptors,
    MapError,
    Passage,
    Room,
    Storey,
    StoreyLayers,
    TopometricMap,
    triple,
)

_MASKS = ("wall", "furniture", "free", "bare")


def save_map(
    path: Path | str,
    topometric_map: TopometricMap,
    observed_by: NDArray[np.uint32] | None = None,
    observers: tuple[str, ...] = (),
) -> None:
    """Write a map to a .tmap file, in one step: an older file stays until the new one is whole.

    Parameters
    ----------
    path : file to write
    topometric_map : the map
    observed_by : (N,) uint32, for a global map: bit i says that `observers[i]` saw the voxel

    Raises
    ------
    MapFileError
        The map cannot be packed or the file not be written.
    """
    path = Path(path)
    try:
        data = encode_map(topometric_map, observed_by, observers)
    except (PackingError, ValueError) as error:
        raise MapFileError(f"{path}: the map cannot be written: {error}") from error
    write_atomically(path, data)


def load_map(path: Path | str) -> TopometricMap:
    """Read a .tmap file.

    Raises
    ------
    MapFileError
        The file is missing, damaged or of an unknown version.
    """
    return load_global_map(path)[0]


def load_global_map(
    path: Path | str,
) -> tuple[TopometricMap, NDArray[np.uint32] | None, tuple[str, ...]]:
    """Read a .tmap file with who observed each voxel: the map, masks (or None) and agent ids."""
    path = Path(path)
    return decode_map(read_container(path), str(path))


def map_file_of(folder: Path) -> Path | None:
    """Return the map file that an output folder holds, the global one first, or None."""
    files = (folder / name for name in ("global.tmap", "map.tmap"))
    return next((file for file in files if file.is_file()), None)


def encode_map(
    m: TopometricMap,
    observed_by: NDArray[np.uint32] | None = None,
    observers: tuple[str, ...] = (),
) -> bytes:
    """Return the bytes of a .tmap file: the same for the same map."""
    fields = {
        "schema": m.schema,
        "agent": m.agent,
        "session": m.session,
        "sequence": int(m.sequence),
        "frame_id": m.frame_id,
        "stamp": int(m.stamp),
        "voxel_size": float(m.voxel_size),
        "origin": floats(m.origin),
        "T_level_input": [floats(row) for row in m.T_level_input],
        "warnings": list(m.warnings),
        "observers": list(observers),
        **graph_fields(m),
        "storeys": [
            {**_storey_fields(s), "rooms": list(m.rooms_of(s.id)), "links": list(m.links_of(s.id))}
            for s in m.storeys
        ],
        "building": building_fields(m),
        "descriptors": [{"name": d.name, "version": int(d.version)} for d in m.descriptors],
    }
    sections = [
        Section("voxels", "coords", m.voxels),
        Section("offsets", "offsets", m.offsets),
        Section("room", "array", m.room),
        Section("navigable", "coords", m.navigable),
        Section("viewpoints", "array", m.viewpoints),
    ]
    for i, storey in enumerate(m.storeys):
        sections += [
            Section(f"storeys[{i}].{name}", "bits", getattr(storey.layers, name)) for name in _MASKS
        ]
    for i, entry in enumerate(m.descriptors):
        sections.append(Section(f"descriptors[{i}]", "array", entry.values))
    if observed_by is not None:
        sections.append(Section("observed_by", "array", observed_by.astype(np.uint32)))
    return encode(fields, sections)


def decode_map(
    data: bytes, source: str
) -> tuple[TopometricMap, NDArray[np.uint32] | None, tuple[str, ...]]:
    """Undo :func:`encode_map`; `source` begins every error message.

    Raises
    ------
    MapFileError
        The bytes are damaged, of an unknown version, or hold a map that contradicts itself.
    """
    fields, arrays = decode(data, source)
    try:
        topometric_map = _map_from(fields, arrays)
        observed_by = arrays.get("observed_by")
        observers = tuple(str(name) for name in fields.get("observers", ()))
    except MapError as error:
        raise MapFileError(f"{source}: {error}") from error
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, OverflowError) as error:
        raise MapFileError(f"{source}: the header makes no sense: {one_line(error)}") from error
    if observed_by is not None and observed_by.shape != topometric_map.room.shape:
        raise MapFileError(
            f"{source}: observed_by: expected {topometric_map.room.shape}, got {observed_by.shape}"
        )
    return topometric_map, observed_by, observers


def _storey_fields(storey: Storey) -> dict[str, Any]:
    return {
        "id": int(storey.id),
        "floor_z": float(storey.floor_z),
        "ceiling_z": optional(storey.ceiling_z),
        "cell": float(storey.layers.cell),
        "origin": floats(storey.layers.origin),
    }


def _map_from(fields: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> TopometricMap:
    return TopometricMap(
        schema=fields["schema"],
        agent=str(fields["agent"]),
        session=str(fields["session"]),
        sequence=int(fields["sequence"]),
        frame_id=str(fields["frame_id"]),
        stamp=int(fields["stamp"]),
        voxel_size=float(fields["voxel_size"]),
        origin=triple(fields["origin"]),
        voxels=arrays["voxels"],
        offsets=arrays["offsets"],
        room=arrays["room"],
        navigable=arrays["navigable"],
        viewpoints=arrays["viewpoints"],
        rooms=tuple(_room(entry) for entry in fields["rooms"]),
        passages=tuple(_passage(entry) for entry in fields["passages"]),
        storeys=tuple(_storey(i, entry, arrays) for i, entry in enumerate(fields["storeys"])),
        descriptors=tuple(
            Descriptors(str(entry["name"]), int(entry["version"]), arrays[f"descriptors[{i}]"])
            for i, entry in enumerate(fields["descriptors"])
        ),
        T_level_input=np.array(fields["T_level_input"], np.float64),
        warnings=tuple(str(warning) for warning in fields["warnings"]),
    )


def _room(entry: Mapping[str, Any]) -> Room:
    low, high = entry["bounds"]
    return Room(
        id=int(entry["id"]),
        storey=int(entry["storey"]),
        centroid=triple(entry["centroid"]),
        bounds=(triple(low), triple(high)),
        voxels=int(entry["voxels"]),
        area=float(entry["area"]),
        isolated=bool(entry["isolated"]),
        **_attributes(entry),
    )


def _attributes(entry: Mapping[str, Any]) -> dict[str, Any]:
    """Return the attributes of a room; files from before rooms had them have none."""
    if "kind" not in entry:
        return {}
    return {
        "centre": None if entry["centre"] is None else triple(entry["centre"]),
        "floor_area": float(entry["floor_area"]),
        "volume": optional(entry["volume"]),
        "completeness": float(entry["completeness"]),
        "frontier": float(entry["frontier"]),
        "kind": str(entry["kind"]),
        "kind_confidence": float(entry["kind_confidence"]),
    }


def _passage(entry: Mapping[str, Any]) -> Passage:
    a, b = entry["rooms"]
    passage = Passage((int(a), int(b)), triple(entry["position"]), float(entry["width"]))
    if "kind" not in entry:  # Files from before passages had kinds.
        return passage
    return replace(
        passage,
        height=optional(entry["height"]),
        kind=str(entry["kind"]),
        confidence=float(entry["confidence"]),
    )


def _storey(index: int, entry: Mapping[str, Any], arrays: Mapping[str, NDArray[Any]]) -> Storey:
    x, y = entry["origin"]
    masks = {name: arrays[f"storeys[{index}].{name}"] for name in _MASKS}
    ceiling = entry["ceiling_z"]
    return Storey(
        id=int(entry["id"]),
        floor_z=float(entry["floor_z"]),
        ceiling_z=None if ceiling is None else float(ceiling),
        layers=StoreyLayers(cell=float(entry["cell"]), origin=(float(x), float(y)), **masks),
    )
