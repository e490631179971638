"""PLY files: a reader for point clouds and a writer of vertex tables.

Plain PLYs (vertices first, no lists among them) are read with numpy: it checks sizes before it
reads, takes a tenth of a second where importing Open3D takes one, and reads the "inf" of an ASCII
file, at which Open3D 0.20 stops and returns uninitialised memory. Other PLYs go through Open3D.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.io.pointcloud2 import CloudError, require_memory
from topometric_ros.io.text import table_of_text

_TYPES = {
    "char": "i1",
    "int8": "i1",
    "uchar": "u1",
    "uint8": "u1",
    "short": "i2",
    "int16": "i2",
    "ushort": "u2",
    "uint16": "u2",
    "int": "i4",
    "int32": "i4",
    "uint": "u4",
    "uint32": "u4",
    "float": "f4",
    "float32": "f4",
    "double": "f8",
    "float64": "f8",
}
_NAMES = {
    "i1": "char",
    "u1": "uchar",
    "i2": "short",
    "u2": "ushort",
    "i4": "int",
    "u4": "uint",
    "f4": "float",
    "f8": "double",
}
_FORMATS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_LONGEST_HEADER = 1 << 16


@dataclass(frozen=True)
class PlyHeader:
    """What a PLY header says of its vertices.

    `properties` are (name, numpy type) in the file's order; `plain` says that the vertices come
    first and have no list, so that their place in the file is known without reading it.
    """

    encoding: str
    vertices: int
    properties: tuple[tuple[str, str], ...]
    plain: bool
    size: int


def read_ply_points(path: Path) -> NDArray[np.float64]:
    """Return the vertices of a PLY file: (N, 3) float64, not yet checked to be finite.

    Raises
    ------
    CloudError
        The file is no PLY, has no x, y and z, or ends early.
    """
    with path.open("rb") as file:
        start = file.read(_LONGEST_HEADER)
    header = _parse_header(path, start)
    names = [name for name, _ in header.properties]
    if not {"x", "y", "z"} <= set(names):
        found = ", ".join(names) or "none"
        raise CloudError(f"{path}: expected vertex properties x, y and z, got {found}")
    if not header.plain:
        return _read_with_open3d(path, header)
    if header.encoding == "ascii":
        return _read_ascii(path, header, [names.index(axis) for axis in "xyz"])
    return _read_binary(path, header)


def write_ply(path: Path, vertices: NDArray[np.void]) -> None:
    """Write a structured array as the vertices of a binary little-endian PLY, at once or not."""
    names = vertices.dtype.names or ()
    kinds = [vertices.dtype[name].str[1:] for name in names]
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(vertices)}"]
    lines += [f"property {_NAMES[kind]} {name}" for name, kind in zip(names, kinds, strict=True)]
    packed = vertices.astype([(n, f"<{k}") for n, k in zip(names, kinds, strict=True)])
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial")
    with partial.open("wb") as file:
        file.write(("\n".join([*lines, "end_header"]) + "\n").encode())
        file.write(packed.tobytes())
    partial.replace(path)


def _parse_header(path: Path, start: bytes) -> PlyHeader:
    if start[:3] != b"ply":
        raise CloudError(f"{path}: expected a PLY file, got one that starts with {start[:8]!r}")
    end = start.find(b"end_header")
    line_end = start.find(b"\n", end)
    if end < 0 or line_end < 0:
        raise CloudError(
            f"{path}: the PLY file ends early: expected a line end_header, "
            f"got {len(start)} bytes without"
        )
    encoding, elements = "", []  # type: ignore[var-annotated]
    try:
        for line in start[:end].decode("ascii", "replace").splitlines():
            words = line.split()
            if words[:1] == ["format"]:
                encoding = words[1]
            elif words[:1] == ["element"]:
                elements.append((words[1], int(words[2]), []))
            elif words[:1] == ["property"]:
                kind = "list" if words[1] == "list" else _TYPES[words[1]]
                elements[-1][2].append((words[-1], kind))
    except (IndexError, KeyError, ValueError) as error:
        raise CloudError(f"{path}: not a PLY header: {line!r}") from error
    vertex = next((element for element in elements if element[0] == "vertex"), None)
    if encoding not in _FORMATS or vertex is None or vertex[1] < 0:
        raise CloudError(f"{path}: not a PLY header: format {encoding!r}, {len(elements)} elements")
    plain = elements[0] is vertex and all(kind != "list" for _, kind in vertex[2])
    return PlyHeader(encoding, vertex[1], tuple(vertex[2]), plain, line_end + 1)


def _read_binary(path: Path, header: PlyHeader) -> NDArray[np.float64]:
    order = _FORMATS[header.encoding]
    dtype = np.dtype([(f"p{i}", order + kind) for i, (_, kind) in enumerate(header.properties)])
    expected = header.size + header.vertices * dtype.itemsize
    size = path.stat().st_size
    if size < expected:
        raise CloudError(
            f"{path}: the PLY file ends early: expected {expected} bytes for {header.vertices} "
            f"vertices, got {size}"
        )
    require_memory(path, header.vertices, dtype.itemsize)
    table = np.fromfile(path, dtype, header.vertices, offset=header.size)
    names = [name for name, _ in header.properties]
    points = np.empty((len(table), 3))
    for axis, name in enumerate("xyz"):
        points[:, axis] = table[f"p{names.index(name)}"]
    return points


def _read_ascii(path: Path, header: PlyHeader, columns: list[int]) -> NDArray[np.float64]:
    with path.open("rb") as file:
        file.seek(header.size)
        return table_of_text(path, file, columns, header.vertices, "PLY file", "vertices")


def _read_with_open3d(path: Path, header: PlyHeader) -> NDArray[np.float64]:
    size = path.stat().st_size - header.size
    if size < header.vertices * len(header.properties):
        raise CloudError(
            f"{path}: the PLY file ends early: expected {header.vertices} vertices of "
            f"{len(header.properties)} properties, got {size} bytes"
        )
    points = open3d_points(path)
    if len(points) != header.vertices:
        raise CloudError(
            f"{path}: the PLY file ends early: expected {header.vertices} vertices, "
            f"got {len(points)}"
        )
    return points


def open3d_points(path: Path) -> NDArray[np.float64]:
    """Return the points that Open3D reads from a file: (N, 3) float64; none where it cannot.

    Raises
    ------
    CloudError
        Open3D is not installed or a system library that it needs is missing.
    """
    try:
        import open3d  # Takes a second of processor time, so only where it is needed.
    except (ImportError, OSError) as error:
        raise CloudError(f"{path}: reading this file needs Open3D: {error}") from error
    quiet = open3d.utility.VerbosityContextManager(open3d.utility.VerbosityLevel.Error)
    with quiet:
        cloud = open3d.io.read_point_cloud(path)
    return np.asarray(cloud.points, dtype=np.float64).reshape(-1, 3)
