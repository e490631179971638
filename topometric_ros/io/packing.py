"""Packing arrays for files and messages: Morton deltas, digits and bits under zstandard.

Every packed array is one zstandard frame that states its content size and carries a checksum. An
array comes back only for the size that its reader expects: the declared sizes are compared, and
held against a limit, before any memory is taken, so a damaged or hostile input costs nothing.
"""

from __future__ import annotations

import numpy as np
import zstandard
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.topometric_map import OFFSET_STEPS
from topometric_ros.voxels.morton import morton_decode, morton_encode

MAXIMUM_ITEMS = 1 << 26
"""The most voxels or raster cells that an array may have: 67 million."""

_LEVEL = 15
_VARINT_BYTES = 9
"""A Morton code has 63 bits, seven to a byte."""
_OFFSET_DIGITS = np.array([1, OFFSET_STEPS, OFFSET_STEPS**2], np.uint8)
_MAXIMUM_WINDOW = 1 << 27


class PackingError(TopometricError):
    """Packed bytes that are damaged or do not hold what was announced."""


def pack_coords(coords: NDArray[np.int32]) -> bytes:
    """Pack voxel coordinates as differences of their Morton codes, each a varint (LEB128).

    Parameters
    ----------
    coords : (N, 3) int32, in strictly increasing Morton order

    Raises
    ------
    PackingError
        The coordinates are not in that order.
    """
    codes = morton_encode(coords)
    if len(codes) > 1 and not (codes[1:] > codes[:-1]).all():
        raise PackingError("voxels must be distinct and in Morton order to be packed")
    deltas = np.diff(codes, prepend=np.uint64(0))
    return _compress(varint_encode(deltas).tobytes())


def unpack_coords(data: bytes, count: int, what: str = "voxels") -> NDArray[np.int32]:
    """Undo :func:`pack_coords` for `count` voxels: (count, 3) int32.

    Raises
    ------
    PackingError
        The bytes are damaged, or hold another number of voxels or voxels out of order.
    """
    _check_count(count, what)
    raw = _decompress(data, count, _VARINT_BYTES * count, what)
    deltas = _varint_decode(np.frombuffer(raw, np.uint8), count, what)
    if count == 0:
        return np.empty((0, 3), np.int32)
    codes = np.cumsum(deltas, dtype=np.uint64)
    if (codes >> np.uint64(63)).any() or not (codes[1:] > codes[:-1]).all():
        raise PackingError(f"{what}: the packed coordinates are not in increasing Morton order")
    return morton_decode(codes)


def pack_offsets(offsets: NDArray[np.int8]) -> bytes:
    """Pack surface offsets (N, 3) int8, -2..1, as a byte a voxel: digits to the base 4, x first."""
    half = OFFSET_STEPS // 2
    if offsets.size and not -half <= offsets.min() <= offsets.max() < half:
        raise PackingError(f"offsets: expected -2..1, got {offsets.min()}..{offsets.max()}")
    return _compress(((offsets + half).astype(np.uint8) @ _OFFSET_DIGITS).tobytes())


def unpack_offsets(data: bytes, count: int, what: str = "offsets") -> NDArray[np.int8]:
    """Undo :func:`pack_offsets`: (count, 3) int8; raises PackingError as the others do."""
    _check_count(count, what)
    packed = np.frombuffer(_decompress(data, count, count, what), np.uint8)
    if packed.max(initial=0) >= OFFSET_STEPS**3:
        raise PackingError(f"{what}: expected bytes under {OFFSET_STEPS**3}, got {packed.max()}")
    digits = packed[:, None] // _OFFSET_DIGITS % OFFSET_STEPS
    return digits.astype(np.int8) - np.int8(OFFSET_STEPS // 2)


def pack_bits(mask: NDArray[np.bool_]) -> bytes:
    """Pack a mask of any shape, eight cells to a byte in row-major order, the first one highest."""
    return _compress(np.packbits(mask.reshape(-1)).tobytes())


def unpack_bits(data: bytes, shape: tuple[int, ...], what: str = "mask") -> NDArray[np.bool_]:
    """Undo :func:`pack_bits`: bool of that shape; raises PackingError as the others do."""
    count = _items(shape, what)
    size = (count + 7) // 8
    packed = np.frombuffer(_decompress(data, size, size, what), np.uint8)
    return np.unpackbits(packed, count=count).astype(bool).reshape(shape)


def pack_array(array: NDArray[np.generic]) -> bytes:
    """Pack an array of numbers: little endian, one plane for every byte of an item.

    The first plane holds the lowest byte of every item, and so on: labels and floats that are close
    to one another differ in few planes, which compresses better than their bytes in turn.
    """
    little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
    planes = little.reshape(-1).view(np.uint8).reshape(-1, little.itemsize).T
    return _compress(planes.tobytes())


def unpack_array(
    data: bytes, dtype: np.dtype | type, shape: tuple[int, ...], what: str = "array"
) -> NDArray[np.generic]:
    """Undo :func:`pack_array`: native `dtype` of that shape; raises PackingError."""
    dtype = np.dtype(dtype)
    count = _items(shape, what)
    size = count * dtype.itemsize
    planes = np.frombuffer(_decompress(data, size, size, what), np.uint8)
    little = np.ascontiguousarray(planes.reshape(dtype.itemsize, count).T)
    return little.view(dtype.newbyteorder("<")).reshape(shape).astype(dtype)


def _check_count(count: int, what: str) -> None:
    if not 0 <= count <= MAXIMUM_ITEMS:
        raise PackingError(f"{what}: {count} items are announced, at most {MAXIMUM_ITEMS} are read")


def _items(shape: tuple[int, ...], what: str) -> int:
    count = 1
    for length in shape:
        _check_count(length, what)
        count *= length
    _check_count(count, what)
    return count


def _compress(raw: bytes) -> bytes:
    return zstandard.ZstdCompressor(
        level=_LEVEL, write_checksum=True, write_content_size=True
    ).compress(raw)


def _decompress(data: bytes, least: int, most: int, what: str) -> bytes:
    """Return the content of one zstandard frame whose stated size lies in least..most bytes."""
    data = bytes(data)
    try:
        frame = zstandard.get_frame_parameters(data)
        size = frame.content_size
        if size == zstandard.CONTENTSIZE_UNKNOWN or not least <= size <= most:
            raise PackingError(f"{what}: expected {least}..{most} bytes of content, got {size}")
        if frame.window_size > max(_MAXIMUM_WINDOW, size):
            raise PackingError(f"{what}: a window of {frame.window_size} bytes is not accepted")
        # Also refuses bytes after the frame's end.
        raw = zstandard.ZstdDecompressor().decompress(data, allow_extra_data=False)
    except (zstandard.ZstdError, ValueError) as error:
        raise PackingError(f"{what}: the packed data is damaged ({error})") from error
    if len(raw) != size:
        raise PackingError(f"{what}: expected {size} bytes of content, got {len(raw)}")
    return raw


def varint_encode(values: NDArray[np.uint64]) -> NDArray[np.uint8]:
    """Return unsigned LEB128: seven bits a byte, lowest first, the top bit set on all but the last.

    Examples
    --------
    >>> varint_encode(np.array([1, 300], np.uint64)).tolist()
    [1, 172, 2]
    """
    sizes = np.ones(len(values), np.int64)
    for position in range(1, _VARINT_BYTES):
        sizes += values >= np.uint64(1 << (7 * position))
    ends = np.cumsum(sizes)
    encoded = np.empty(int(ends[-1]) if len(ends) else 0, np.uint8)
    for position in range(int(sizes.max(initial=0))):
        long_enough = sizes > position
        septet = (values[long_enough] >> np.uint64(7 * position)) & np.uint64(0x7F)
        more = (sizes[long_enough] > position + 1).astype(np.uint8) << 7
        encoded[ends[long_enough] - sizes[long_enough] + position] = septet.astype(np.uint8) | more
    return encoded


def _varint_decode(encoded: NDArray[np.uint8], count: int, what: str) -> NDArray[np.uint64]:
    """Undo :func:`varint_encode` for `count` values."""
    ends = np.flatnonzero(encoded < 0x80) + 1
    if len(ends) != count or (ends[-1] if count else 0) != len(encoded):
        raise PackingError(f"{what}: expected {count} packed values, got {len(ends)}")
    sizes = np.diff(ends, prepend=0)
    longest = int(sizes.max(initial=0))
    if longest > _VARINT_BYTES:
        raise PackingError(f"{what}: a packed value takes {longest} bytes, at most {_VARINT_BYTES}")
    values = np.zeros(count, np.uint64)
    for position in range(longest):
        long_enough = sizes > position
        at = ends[long_enough] - sizes[long_enough] + position
        septet = (encoded[at] & np.uint8(0x7F)).astype(np.uint64)
        values[long_enough] |= septet << np.uint64(7 * position)
    return values
