"""A topometric map in the formats of other programs (docs/formats.md, "Exports").

Clouds hold the mean point seen in each voxel in the map's input frame, with its room, its storey
and, for a global map, the bit mask of the agents that saw it.
"""

from __future__ import annotations

import datetime
import io
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.io.occupancy import occupancy_grid, write_occupancy
from topometric_ros.io.ply import write_ply
from topometric_ros.io.route_graph import route_graph
from topometric_ros.io.summaries import graph_fields, write_atomically
from topometric_ros.topometric_map import NO_ROOM, TopometricMap
from topometric_ros.voxels.palette import room_colours

_FLOAT32_REACH = 1e4
"""Coordinates beyond this lose more than a millimetre in single precision, m."""


class ExportError(TopometricError):
    """A format that is unknown or cannot be written here."""


def export_map(
    folder: Path,
    m: TopometricMap,
    formats: Sequence[str],
    observed_by: NDArray[np.uint32] | None = None,
) -> list[Path]:
    """Write a map in the named formats; return the files in the order written.

    Parameters
    ----------
    folder : existing folder
    m : map, partial or global
    formats : of FORMATS
    observed_by : (N,) uint32, for a global map: bit i says that agent i saw the voxel

    Raises
    ------
    ExportError
        A format is unknown, or its library is not installed.
    """
    unknown = [name for name in formats if name not in FORMATS]
    if unknown:
        raise ExportError(f"format: expected one of {', '.join(FORMATS)}, got {unknown[0]!r}")
    return [path for name in formats for path in FORMATS[name](folder, m, observed_by)]


def cloud_table(
    m: TopometricMap, observed_by: NDArray[np.uint32] | None = None
) -> NDArray[np.void]:
    """Return a map's surface as a table of vertices, in the input's frame.

    Returns
    -------
    (N,) structured: x, y, z float64 (m), room and storey int32 (-1: none), red, green, blue uint8
    and, where `observed_by` is given, agent uint32
    """
    T = np.linalg.inv(m.T_level_input)
    points = m.surface() @ T[:3, :3].T + T[:3, 3]
    colours = room_colours(m.room)
    columns: list[tuple[str, str, NDArray[np.generic]]] = [
        *((axis, "<f8", points[:, k]) for k, axis in enumerate("xyz")),
        ("room", "<i4", m.room),
        ("storey", "<i4", _storey_of_voxel(m)),
        *((name, "u1", colours[:, k]) for k, name in enumerate(("red", "green", "blue"))),
    ]
    if observed_by is not None:
        columns.append(("agent", "<u4", observed_by))
    table = np.empty(len(points), [(name, kind) for name, kind, _ in columns])
    for name, _, values in columns:
        table[name] = values
    return table


def _storey_of_voxel(m: TopometricMap) -> NDArray[np.int32]:
    """Return the storey of each voxel's room: (N,) int32, -1 where it has none."""
    ids = np.array([room.id for room in m.rooms], dtype=np.int64)
    storeys = np.array([room.storey for room in m.rooms], dtype=np.int32)
    result = np.full(len(m.room), -1, dtype=np.int32)
    order = np.argsort(ids)
    known = m.room != NO_ROOM
    if known.any():
        result[known] = storeys[order][np.searchsorted(ids[order], m.room[known])]
    return result


def _write_ply(
    folder: Path, m: TopometricMap, observed_by: NDArray[np.uint32] | None
) -> list[Path]:
    path = folder / "cloud.ply"
    write_ply(path, cloud_table(m, observed_by))
    return [path]


def _write_pcd(
    folder: Path, m: TopometricMap, observed_by: NDArray[np.uint32] | None
) -> list[Path]:
    """Write a binary PCD as PCL reads it: x y z, packed rgb, the room as label, storey, agent."""
    table = cloud_table(m, observed_by)
    largest = max(float(np.abs(table[axis]).max(initial=0.0)) for axis in "xyz")
    kind = "<f4" if largest < _FLOAT32_REACH else "<f8"
    packed = (
        (table["red"].astype(np.uint32) << 16)
        | (table["green"].astype(np.uint32) << 8)
        | table["blue"].astype(np.uint32)
    )
    columns = [(axis, kind, table[axis]) for axis in "xyz"]
    # PCL's label is unsigned: -1, no room, becomes 2^32 - 1.
    columns += [("rgb", "<u4", packed), ("label", "<u4", table["room"].view(np.uint32))]
    columns += [("storey", "<i4", table["storey"])]
    columns += [("agent", "<u4", table["agent"])] if observed_by is not None else []
    rows = np.empty(len(table), [(name, dtype) for name, dtype, _ in columns])
    for name, _, values in columns:
        rows[name] = values
    letters = {"f": "F", "u": "U", "i": "I"}
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(name for name, _, _ in columns),
        "SIZE " + " ".join(dtype[2] for _, dtype, _ in columns),
        "TYPE " + " ".join(letters[dtype[1]] for _, dtype, _ in columns),
        "COUNT " + " ".join("1" for _ in columns),
        f"WIDTH {len(rows)}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {len(rows)}",
        "DATA binary",
    ]
    path = folder / "cloud.pcd"
    write_atomically(path, ("\n".join(header) + "\n").encode() + rows.tobytes())
    return [path]


def _write_laz(
    folder: Path, m: TopometricMap, observed_by: NDArray[np.uint32] | None
) -> list[Path]:
    """Write a LAZ file (LAS 1.4, point format 7) with room, storey and agent as extra numbers."""
    try:
        import laspy
        import lazrs  # noqa: F401
    except ImportError as error:
        raise ExportError('writing LAZ needs an extra: pip install "laspy[lazrs]"') from error
    table = cloud_table(m, observed_by)
    header = laspy.LasHeader(version="1.4", point_format=7)
    # The day of the map, not of the export: the same map gives the same bytes.
    header.creation_date = datetime.datetime.fromtimestamp(m.stamp / 1e9, datetime.UTC).date()
    header.scales = np.full(3, 1e-4)
    points = np.column_stack([table[axis] for axis in "xyz"])
    header.offsets = np.floor(points.min(axis=0)) if len(points) else np.zeros(3)
    extra = ["room", "storey"] + (["agent"] if observed_by is not None else [])
    for name in extra:
        header.add_extra_dim(laspy.ExtraBytesParams(name, type=table[name].dtype))
    las = laspy.LasData(header)
    las.x, las.y, las.z = points.T
    for name in ("red", "green", "blue"):
        las[name] = table[name].astype(np.uint16) * 257
    for name in extra:
        las[name] = table[name]
    buffer = io.BytesIO()
    las.write(buffer, do_compress=True, laz_backend=laspy.LazBackend.Lazrs)
    path = folder / "cloud.laz"
    write_atomically(path, buffer.getvalue())
    return [path]


def _write_grids(
    folder: Path, m: TopometricMap, observed_by: NDArray[np.uint32] | None
) -> list[Path]:
    return [
        path
        for storey in m.storeys
        for path in write_occupancy(folder, f"storey_{storey.id}", occupancy_grid(m, storey))
    ]


def _write_routes(
    folder: Path, m: TopometricMap, observed_by: NDArray[np.uint32] | None
) -> list[Path]:
    paths = []
    for storey in m.storeys:
        paths.append(folder / f"storey_{storey.id}.geojson")
        text = json.dumps(route_graph(m, storey), indent=1, allow_nan=False)
        write_atomically(paths[-1], (text + "\n").encode())
    return paths


def _write_graphml(
    folder: Path, m: TopometricMap, observed_by: NDArray[np.uint32] | None
) -> list[Path]:
    """Write rooms as nodes and passages as edges, with every attribute that map.json has."""
    import networkx

    fields = graph_fields(m)
    graph = networkx.MultiGraph(name=m.agent, frame_id=m.frame_id)
    for room in fields["rooms"]:
        graph.add_node(room["id"], **_flat(room, leave_out=("id",)))
    for key, passage in enumerate(fields["passages"]):
        a, b = passage["rooms"]
        graph.add_edge(a, b, key=key, **_flat(passage, leave_out=("rooms",)))
    buffer = io.BytesIO()
    networkx.write_graphml_xml(graph, buffer)
    path = folder / "graph.graphml"
    write_atomically(path, buffer.getvalue() + b"\n")
    return [path]


def _flat(fields: dict[str, object], leave_out: tuple[str, ...]) -> dict[str, object]:
    """Return fields without lists, which GraphML does not know: name_x, name_y and so on."""
    flat: dict[str, object] = {}
    for name, value in fields.items():
        if name in leave_out or value is None:
            continue
        if isinstance(value, list):
            parts = np.ravel(np.asarray(value, dtype=float)).tolist()
            axes = [f"{axis}{side}" for side in ("_min", "_max") for axis in "xyz"]
            names = axes if len(parts) == 6 else list("xyz")
            flat |= {f"{name}_{part}": number for part, number in zip(names, parts, strict=True)}
        else:
            flat[name] = value
    return flat


_Writer = Callable[[Path, TopometricMap, NDArray[np.uint32] | None], list[Path]]
FORMATS: dict[str, _Writer] = {
    "ply": _write_ply,
    "pcd": _write_pcd,
    "laz": _write_laz,
    "pgm": _write_grids,
    "geojson": _write_routes,
    "graphml": _write_graphml,
}
"""What a map can be exported to, by the name that the command line knows."""
