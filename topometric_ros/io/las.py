"""LAS and LAZ files, read by laspy after their header was held against the file's size."""

from __future__ import annotations

import logging
import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import one_line
from topometric_ros.io.pointcloud2 import CloudError, missing_reader, require_memory

_PACKAGE = "laspy[lazrs]"
_SHORTEST_HEADER = 227
_RECORD_HEADER = 54
_SHORTEST_POINT = 20
"""Bytes of a point, and so of a chunk of a LAZ file, which begins with a whole point."""
_COMPRESSED = 0x80

# laspy logs the errors that it raises too; they are told once, as errors.
logging.getLogger("laspy").setLevel(logging.CRITICAL)


def read_las_points(path: Path) -> NDArray[np.float64]:
    """Return the points of a LAS or LAZ file: (N, 3) float64, scaled.

    Raises
    ------
    CloudError
        The file is damaged, or the package that reads it is not installed.
    """
    try:
        import laspy
    except ImportError as error:
        raise missing_reader(path, "LAS", _PACKAGE) from error
    _check_header(path)
    failures: tuple[type[BaseException], ...] = (
        laspy.errors.LaspyException, ValueError, EOFError, struct.error,
    )  # fmt: skip
    try:
        import lazrs

        failures += (lazrs.LazrsError,)
    except ImportError:
        if path.suffix.lower() == ".laz":
            raise missing_reader(path, "LAZ", _PACKAGE) from None
    try:
        with laspy.open(path) as file:
            header = file.header
            expected = header.point_count
            size = expected * header.point_format.size
            if not header.are_points_compressed and size > path.stat().st_size:
                raise CloudError(
                    f"{path}: the LAS file ends early: expected {size} bytes for {expected} "
                    f"points, got {path.stat().st_size}"
                )
            require_memory(path, expected, header.point_format.size)
            las = file.read()
    except BaseException as error:
        # The panics of lazrs are no Exception.
        if not isinstance(error, failures) and type(error).__name__ != "PanicException":
            raise
        raise CloudError(f"{path}: not a complete LAS file: {one_line(error)}") from error
    if len(las.points) != expected:
        raise CloudError(
            f"{path}: the LAS file ends early: expected {expected} points, got {len(las.points)}"
        )
    return np.stack([np.asarray(las.x), np.asarray(las.y), np.asarray(las.z)], axis=1)


def _check_header(path: Path) -> None:
    """Refuse a header whose numbers cannot be: laspy would loop over them for ever."""
    size = path.stat().st_size
    with path.open("rb") as file:
        header = file.read(_SHORTEST_HEADER)
    if len(header) < _SHORTEST_HEADER or header[:4] != b"LASF":
        raise CloudError(f"{path}: not a complete LAS file: {size} bytes, signature {header[:4]!r}")
    data, records, kind, length = struct.unpack_from("<IIBH", header, 96)
    if data > size or records * _RECORD_HEADER > data or length < _SHORTEST_POINT:
        raise CloudError(
            f"{path}: not a complete LAS file: {records} records before byte {data} of {size}, "
            f"points of {length} bytes"
        )
    if kind & _COMPRESSED:
        _check_chunks(path, data, size)


def _check_chunks(path: Path, data: int, size: int) -> None:
    """Refuse a table of chunks that cannot be: for a huge one lazrs ends the whole process.

    The points begin with the place of the table, -1 where the file's last eight bytes hold it; the
    table begins with its version and the number of chunks.
    """
    with path.open("rb") as file:

        def number(place: int, kind: str) -> int:
            file.seek(place)
            raw = file.read(struct.calcsize(kind))
            return int(struct.unpack(kind, raw)[0]) if len(raw) == struct.calcsize(kind) else -1

        table = number(data, "<q")
        if table == -1:
            table = number(size - 8, "<q")
        chunks = number(table + 4, "<I") if data <= table < size else -1
    if not 0 <= chunks <= size // _SHORTEST_POINT:
        raise CloudError(
            f"{path}: not a complete LAZ file: expected a table of its chunks before byte {size}, "
            f"got {'none' if chunks < 0 else f'one of {chunks} chunks'}"
        )
