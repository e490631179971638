"""PCD files, read by Open3D after their header was held against the file's size.

Open3D reads every PCD encoding (LZF compression included), but answers a damaged file with a
warning of its own and an empty cloud; the check here gives one line with the numbers instead.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.io.ply import open3d_points
from topometric_ros.io.pointcloud2 import CloudError

_LONGEST_HEADER = 1 << 16


def read_pcd_points(path: Path) -> NDArray[np.float64]:
    """Return the points of a PCD file: (N, 3) float64, not yet checked to be finite.

    Raises
    ------
    CloudError
        The file is no PCD, has no x, y and z, or ends early.
    """
    with path.open("rb") as file:
        start = file.read(_LONGEST_HEADER)
    entries, encoding, body = _parse_header(path, start)
    try:
        count = int(entries["POINTS"][0])
        sizes = [int(word) for word in entries["SIZE"]]
        repeats = [int(word) for word in entries.get("COUNT", ["1"] * len(sizes))]
        step = sum(size * repeat for size, repeat in zip(sizes, repeats, strict=True))
    except (KeyError, IndexError, ValueError) as error:
        raise CloudError(f"{path}: not a PCD header: {error!r}") from error
    if not {"x", "y", "z"} <= set(entries.get("FIELDS", [])):
        raise CloudError(
            f"{path}: expected PCD fields x, y and z, got {' '.join(entries.get('FIELDS', []))}"
        )
    if count == 0:
        return np.empty((0, 3))
    _check_size(path, encoding, body, count, step)
    points = open3d_points(path)
    if len(points) != count:
        raise CloudError(f"{path}: expected {count} PCD points, got {len(points)}")
    return points


def _parse_header(path: Path, start: bytes) -> tuple[dict[str, list[str]], str, int]:
    """Return the header's entries, the encoding and where the data begins."""
    entries: dict[str, list[str]] = {}
    position = 0
    while (end := start.find(b"\n", position)) >= 0:
        words = start[position:end].decode("ascii", "replace").split()
        position = end + 1
        if words and not words[0].startswith("#"):
            entries[words[0]] = words[1:]
        if "DATA" in entries:
            return entries, " ".join(entries["DATA"]), position
    raise CloudError(f"{path}: expected a PCD header with a line DATA, got {start[:16]!r}")


def _check_size(path: Path, encoding: str, body: int, count: int, step: int) -> None:
    """Refuse a file that is shorter than its header says."""
    size = path.stat().st_size
    if encoding == "binary":
        expected = body + count * step
    elif encoding == "binary_compressed":
        with path.open("rb") as file:
            file.seek(body)
            sizes = file.read(8)
        expected = body + 8 + (struct.unpack("<II", sizes)[0] if len(sizes) == 8 else 0)
    elif encoding == "ascii":
        with path.open("rb") as file:
            file.seek(body)
            lines = sum(1 for line in file if line.strip())
        if lines < count:
            raise CloudError(
                f"{path}: the PCD file ends early: expected {count} points, got {lines}"
            )
        return
    else:
        raise CloudError(
            f"{path}: PCD data: expected ascii, binary or binary_compressed, got {encoding!r}"
        )
    if size < expected:
        raise CloudError(
            f"{path}: the PCD file ends early: expected {expected} bytes for {count} points, "
            f"got {size}"
        )
