"""PCD files: ASCII, binary and LZF-compressed, with every size held against the file's first.

Open3D reads them too, but ends the whole process on fields of several numbers and answers a damaged
file with an empty cloud.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.errors import one_line
from topometric_ros.io.pointcloud2 import CloudError, require_memory
from topometric_ros.io.text import table_of_text

_LONGEST_HEADER = 1 << 16
_TYPES = {
    f"{letter}{size}": f"{kind}{size}"
    for letter, kind, sizes in (
        ("F", "f", (4, 8)),
        ("I", "i", (1, 2, 4, 8)),
        ("U", "u", (1, 2, 4, 8)),
    )
    for size in sizes
}
_BEST_RATIO = 100
"""LZF makes at most 264 bytes of three."""


@dataclass(frozen=True)
class _Header:
    """`fields` are (name, numpy type, numbers a point) in order; the data begins at `body`."""

    fields: tuple[tuple[str, str, int], ...]
    count: int
    encoding: str
    body: int

    @property
    def step(self) -> int:
        """Bytes of a point."""
        return sum(np.dtype(kind).itemsize * repeat for _, kind, repeat in self.fields)

    def position(self, name: str) -> int:
        """Return the index of the first field of that name."""
        return [field[0] for field in self.fields].index(name)


def read_pcd_points(path: Path) -> NDArray[np.float64]:
    """Return the points of a PCD file: (N, 3) float64, not yet checked to be finite.

    Raises
    ------
    CloudError
        The file is no PCD, has no x, y and z, or ends early.
    """
    with path.open("rb") as file:
        start = file.read(_LONGEST_HEADER)
    header = _parse_header(path, start)
    if header.count == 0:
        return np.empty((0, 3))
    if header.encoding == "ascii":
        return _read_ascii(path, header)
    if header.encoding == "binary":
        return _read_binary(path, header)
    if header.encoding == "binary_compressed":
        return _read_compressed(path, header)
    raise CloudError(
        f"{path}: PCD data: expected ascii, binary or binary_compressed, "
        f"got {header.encoding[:40]!r}"
    )


def _parse_header(path: Path, start: bytes) -> _Header:
    entries, encoding, body = _entries(path, start)
    names = entries.get("FIELDS", [])
    if not {"x", "y", "z"} <= set(names):
        raise CloudError(f"{path}: expected PCD fields x, y and z, got {' '.join(names)}")
    try:
        if "POINTS" in entries:
            count = int(entries["POINTS"][0])
        else:
            count = int(entries["WIDTH"][0]) * int(entries["HEIGHT"][0])
        sizes, letters = entries["SIZE"], entries["TYPE"]
        repeats = [int(word) for word in entries.get("COUNT", ["1"] * len(names))]
        kinds = [_TYPES[letter + size] for letter, size in zip(letters, sizes, strict=True)]
        fields = tuple(zip(names, kinds, repeats, strict=True))
    except (KeyError, IndexError, ValueError) as error:
        raise CloudError(f"{path}: not a PCD header: {one_line(error)}") from error
    if count < 0 or min(repeats) < 1 or max(repeats) > _LONGEST_HEADER:
        raise CloudError(f"{path}: not a PCD header: {count} points, COUNT {repeats}")
    return _Header(fields, count, encoding, body)


def _entries(path: Path, start: bytes) -> tuple[dict[str, list[str]], str, int]:
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


def _read_ascii(path: Path, header: _Header) -> NDArray[np.float64]:
    starts = np.cumsum([0, *(repeat for _, _, repeat in header.fields)])
    columns = [int(starts[header.position(axis)]) for axis in "xyz"]
    with path.open("rb") as file:
        file.seek(header.body)
        return table_of_text(path, file, columns, header.count, "PCD file", "points")


def _read_binary(path: Path, header: _Header) -> NDArray[np.float64]:
    _check_size(path, header, header.body + header.count * header.step)
    require_memory(path, header.count, header.step)
    dtype = np.dtype([(f"p{i}", f"<{k}", (n,)) for i, (_, k, n) in enumerate(header.fields)])
    table = np.fromfile(path, dtype, header.count, offset=header.body)
    return np.column_stack([table[f"p{header.position(axis)}"][:, 0] for axis in "xyz"]).astype(
        np.float64
    )


def _read_compressed(path: Path, header: _Header) -> NDArray[np.float64]:
    """Read LZF-compressed data, which holds all numbers of the first field, then the second's."""
    with path.open("rb") as file:
        file.seek(header.body)
        sizes = file.read(8)
        packed, size = struct.unpack("<II", sizes) if len(sizes) == 8 else (0, 0)
        _check_size(path, header, header.body + 8 + packed)
        expected = header.count * header.step
        if size != expected or size > _BEST_RATIO * packed:
            raise CloudError(
                f"{path}: expected {expected} bytes of compressed PCD data for {header.count} "
                f"points, got {size} in {packed}"
            )
        require_memory(path, header.count, header.step)
        raw = np.zeros(size, np.uint8)
        written = _decompressed(np.frombuffer(file.read(packed), np.uint8), raw)
    if written != size:
        raise CloudError(f"{path}: the compressed PCD data is damaged")
    points = np.empty((header.count, 3))
    ends = np.cumsum([np.dtype(k).itemsize * n * header.count for _, k, n in header.fields])
    for axis, name in enumerate("xyz"):
        index = header.position(name)
        _, kind, repeat = header.fields[index]
        length = np.dtype(kind).itemsize * repeat * header.count
        numbers = raw[ends[index] - length : ends[index]].view(f"<{kind}")
        points[:, axis] = numbers.reshape(header.count, repeat)[:, 0]
    return points


def _check_size(path: Path, header: _Header, expected: int) -> None:
    """Refuse a file that is shorter than its header says."""
    size = path.stat().st_size
    if size < expected:
        raise CloudError(
            f"{path}: the PCD file ends early: expected {expected} bytes for {header.count} "
            f"points, got {size}"
        )


@njit(cache=True, nogil=True)
def _decompressed(packed, raw):  # type: ignore[no-untyped-def]
    """Undo LZF into `raw`; return the bytes written, -1 where the data leads out of bounds.

    A byte below 32 announces one more literal bytes than it says; any other a copy of what was
    written before: its length in the upper three bits, its distance in the lower five and a byte.
    """
    i = 0
    end = 0
    while i < len(packed):
        control = np.int64(packed[i])
        i += 1
        if control < 32:
            length = control + 1
            if i + length > len(packed) or end + length > len(raw):
                return -1
            for k in range(length):
                raw[end + k] = packed[i + k]
            i += length
        else:
            length = control >> 5
            if length == 7:
                if i >= len(packed):
                    return -1
                length += np.int64(packed[i])
                i += 1
            if i >= len(packed):
                return -1
            length += 2
            source = end - ((control & 31) << 8) - np.int64(packed[i]) - 1
            i += 1
            if source < 0 or end + length > len(raw):
                return -1
            for k in range(length):
                raw[end + k] = raw[source + k]
        end += length
    return end
