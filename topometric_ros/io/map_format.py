"""The inside of a .tmap file: a header that describes itself and packed sections.

    bytes 0-3    b"TMAP"
    bytes 4-5    version of the file format, uint16 little endian
    bytes 6-9    size of the header in bytes, uint32 little endian
    bytes 10-13  CRC-32 of the header, uint32 little endian
    then         the header: JSON (UTF-8), a zstandard-free text that a person can read
    then         the sections, back to back, in the order of the header's `sections`

The header holds every number of the map that is not in an array (JSON keeps float64 exactly) and
for every section its name, encoding, shape, type and size. Sections that a reader does not know are
skipped, so that fields can be added; a version that it does not know is refused.
"""

from __future__ import annotations

import json
import math
import struct
import zlib
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError, one_line
from topometric_ros.io.packing import (
    MAXIMUM_ITEMS,
    PackingError,
    pack_array,
    pack_bits,
    pack_coords,
    pack_offsets,
    unpack_array,
    unpack_bits,
    unpack_coords,
    unpack_offsets,
)

MAGIC = b"TMAP"
VERSION = 2
"""1 kept mean points in sixteenths of a voxel, 2 keeps them in quarters."""
_PREFIX = struct.Struct("<4sHII")
_LARGEST_HEADER = 1 << 26
_LARGEST_FILE = 1 << 32
_MOST_NUMBERS = 8 * MAXIMUM_ITEMS
"""In all sections together: twice those of the largest map that a message may hold."""
_TYPES = ("int8", "int32", "uint32", "float32", "float64")


class MapFileError(TopometricError):
    """A map file that cannot be read or written."""


@dataclass(frozen=True)
class Section:
    """One array of a map file: `encoding` is coords, offsets, bits or array."""

    name: str
    encoding: str
    array: NDArray[Any]


def read_container(path: Path) -> bytes:
    """Return the bytes of a file.

    Raises
    ------
    MapFileError
        There is none, it cannot be read, is too large, or is no ordinary file: a device or a pipe
        may have no end.
    """
    try:
        if path.exists() and not path.is_file():
            raise MapFileError(f"{path}: expected a file, got a folder, a device or a pipe")
        size = path.stat().st_size
        if size > _LARGEST_FILE:
            raise MapFileError(f"{path}: {size} bytes, at most {_LARGEST_FILE} are read")
        return path.read_bytes()
    except OSError as error:
        reason = error.strerror or error
        raise MapFileError(f"{path}: the file cannot be read: {reason}") from error


def read_sections(path: Path, schema: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the header fields and the arrays of a file of this format that holds no map.

    Raises
    ------
    MapFileError
        The file is missing, damaged, or of another kind or version.
    """
    fields, arrays = decode(read_container(path), str(path))
    if fields.get("schema") != schema:
        raise MapFileError(f"{path}: schema: expected {schema!r}, got {fields.get('schema')!r}")
    return fields, arrays


def encode(fields: Mapping[str, Any], sections: list[Section]) -> bytes:
    """Return the bytes of a map file with these header fields and sections."""
    table, payloads = [], []
    for section in sections:
        payload = _pack(section)
        table.append(
            {
                "name": section.name,
                "encoding": section.encoding,
                "dtype": str(section.array.dtype),
                "shape": list(section.array.shape),
                "bytes": len(payload),
            }
        )
        payloads.append(payload)
    header = json.dumps({**fields, "sections": table}, allow_nan=False).encode()
    prefix = _PREFIX.pack(MAGIC, VERSION, len(header), zlib.crc32(header))
    return b"".join([prefix, header, *payloads])


def decode(data: bytes, source: str) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Undo :func:`encode`; `source` begins every error message.

    Raises
    ------
    MapFileError
        The bytes are no map file, of an unknown version, or damaged.
    """
    if len(data) < _PREFIX.size or data[:4] != MAGIC:
        raise MapFileError(
            f"{source}: expected a .tmap file, got one that starts with {data[:4]!r}"
        )
    _, version, size, checksum = _PREFIX.unpack_from(data)
    if version != VERSION:
        raise MapFileError(
            f"{source}: .tmap version {version} is not known; this program reads version {VERSION}"
        )
    header = data[_PREFIX.size : _PREFIX.size + size]
    if size > _LARGEST_HEADER or len(header) != size:
        raise MapFileError(
            f"{source}: the file ends early: expected a header of {size} bytes, got {len(header)}"
        )
    if zlib.crc32(header) != checksum:
        raise MapFileError(f"{source}: the header is damaged (its checksum does not match)")
    try:
        fields = json.loads(header)
        arrays = _read_sections(fields.pop("sections"), data, _PREFIX.size + size, source)
    except (ValueError, KeyError, TypeError, AttributeError, RecursionError) as error:
        raise MapFileError(f"{source}: the header makes no sense: {one_line(error)}") from error
    return fields, arrays


def _pack(section: Section) -> bytes:
    array = section.array
    if section.encoding == "coords":
        return pack_coords(array)
    if section.encoding == "offsets":
        return pack_offsets(array)
    if section.encoding == "bits":
        return pack_bits(array)
    return pack_array(array)


def _read_sections(
    table: list[Mapping[str, Any]], data: bytes, start: int, source: str
) -> dict[str, NDArray[Any]]:
    arrays = {}
    numbers = sum(math.prod(max(0, int(n)) for n in entry["shape"]) for entry in table)
    if numbers > _MOST_NUMBERS:
        raise MapFileError(f"{source}: {numbers} numbers are announced, at most {_MOST_NUMBERS}")
    for entry in table:
        size = int(entry["bytes"])
        payload = data[start : start + max(0, size)]
        if len(payload) != size:
            raise MapFileError(
                f"{source}: the file ends early: section {entry['name']} has {size} bytes, "
                f"got {len(payload)}"
            )
        start += size
        try:
            arrays[str(entry["name"])] = _unpack(entry, payload)
        except PackingError as error:
            raise MapFileError(f"{source}: {error}") from error
    if start != len(data):
        raise MapFileError(f"{source}: expected {start} bytes, got {len(data)}")
    return arrays


def _unpack(entry: Mapping[str, Any], payload: bytes) -> NDArray[Any]:
    name, encoding = str(entry["name"]), entry["encoding"]
    shape = tuple(int(length) for length in entry["shape"])
    if encoding == "coords":
        return unpack_coords(payload, shape[0], name)
    if encoding == "offsets":
        return unpack_offsets(payload, shape[0], name)
    if encoding == "bits":
        return unpack_bits(payload, shape, name)
    if encoding != "array" or entry["dtype"] not in _TYPES:
        raise PackingError(
            f"{name}: expected a known encoding and type, got {encoding!r} {entry['dtype']!r}"
        )
    return unpack_array(payload, np.dtype(entry["dtype"]), shape, name)
