"""sensor_msgs/PointCloud2 to points, whatever its layout: shared by bag readers and nodes.

Takes the message's plain fields, so that rclpy's and rosbags' classes serve alike. Nothing is
guessed: a cloud whose sizes contradict each other is refused with what was expected and found.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError

_SIZES = {1: 1, 2: 1, 3: 2, 4: 2, 5: 4, 6: 4, 7: 4, 8: 8}
"""Bytes of each PointField datatype: (U)INT8, (U)INT16, (U)INT32, FLOAT32 and FLOAT64."""
_FLOATS = {7: "f4", 8: "f8"}
_BYTES_OF_A_POINT = 48
"""As read, and as finite points with z up."""


class CloudError(TopometricError):
    """A point cloud that cannot be read or that holds nothing to use."""


def missing_reader(path: Path, kind: str, package: str) -> CloudError:
    """Return the error that says which package reads a kind of file."""
    return CloudError(f'{path}: reading {kind} files needs an extra: pip install "{package}"')


def require_memory(path: Path, count: int, size: int) -> None:
    """Refuse a cloud of `count` points, `size` bytes each in its file, that memory cannot hold.

    Raises
    ------
    CloudError
        Reading them takes more than this machine has; the system would end the process unasked.
    """
    has = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")
    takes = count * (size + _BYTES_OF_A_POINT)
    if takes > has:
        raise CloudError(
            f"{path}: expected a cloud that fits into memory ({has / 1e9:.0f} GB), got {count} "
            f"points, which take {takes / 1e9:.0f} GB; thin them first"
        )


class PointField(Protocol):
    """One field of a point, as sensor_msgs/PointField has it."""

    name: str
    offset: int
    datatype: int
    count: int


def points_from_message(message: Any) -> tuple[NDArray[np.float64], int]:
    """Return :func:`points_from_fields` of a PointCloud2 message of any library."""
    return points_from_fields(
        message.height,
        message.width,
        message.point_step,
        message.row_step,
        message.is_bigendian,
        message.fields,
        message.data,
    )


def points_from_fields(
    height: int,
    width: int,
    point_step: int,
    row_step: int,
    is_bigendian: bool,
    fields: Iterable[PointField],
    data: Any,
) -> tuple[NDArray[np.float64], int]:
    """Return the finite points of a cloud and how many others were dropped.

    Parameters
    ----------
    height, width : rows and points a row; rows may end in padding
    point_step, row_step : bytes of a point and of a row
    is_bigendian : byte order of the data
    fields : the point's fields; x, y and z must be there as float32 or float64
    data : buffer of height * row_step bytes

    Returns
    -------
    points : (N, 3) float64, m, the cloud's frame, finite
    dropped : number of points with a NaN or infinite coordinate

    Raises
    ------
    CloudError
        A size contradicts another one, or x, y or z is missing or of the wrong type.
    """
    layout = list(fields)
    _check_point_step(layout, point_step)
    raw = memoryview(data).cast("B")
    _check_sizes(height, width, point_step, row_step, raw.nbytes)
    points = np.empty((height, width, 3))
    for axis, name in enumerate("xyz"):
        field = _coordinate(layout, name)
        dtype = np.dtype(_FLOATS[field.datatype]).newbyteorder(">" if is_bigendian else "<")
        if height and width:
            points[..., axis] = np.ndarray(
                (height, width), dtype, raw, field.offset, (row_step, point_step)
            )
    flat = points.reshape(-1, 3)
    finite = np.isfinite(flat).all(axis=1)
    dropped = len(flat) - int(np.count_nonzero(finite))
    return (flat[finite] if dropped else flat), dropped


def _check_point_step(layout: list[PointField], point_step: int) -> None:
    """Refuse a point_step that does not hold every field."""
    for field in layout:
        if field.datatype not in _SIZES:
            raise CloudError(
                f"PointCloud2 field {field.name!r}: expected a datatype 1..8, got {field.datatype}"
            )
        end = field.offset + _SIZES[field.datatype] * max(1, field.count)
        if end > point_step:
            raise CloudError(
                f"PointCloud2 point_step: expected at least {end} bytes, where field "
                f"{field.name!r} ends, got {point_step}"
            )


def _check_sizes(height: int, width: int, point_step: int, row_step: int, size: int) -> None:
    """Refuse a row_step or a data size that does not fit the number of points."""
    row = width * point_step
    # Padding exists to align the rows of an organised cloud; in a single row it can only be a
    # wrong point_step.
    if row_step < row or (height == 1 and row_step != row):
        least = "" if height == 1 else "at least "
        raise CloudError(
            f"PointCloud2 row_step: expected {least}{row} bytes ({width} points of point_step "
            f"{point_step}), got {row_step}"
        )
    if size != height * row_step:
        raise CloudError(
            f"PointCloud2 data: expected {height * row_step} bytes ({height} rows of {row_step}), "
            f"got {size}"
        )


def _coordinate(layout: list[PointField], name: str) -> PointField:
    """Return the field of one coordinate."""
    field = next((field for field in layout if field.name == name), None)
    if field is None:
        names = ", ".join(field.name for field in layout) or "none"
        raise CloudError(f"PointCloud2: expected fields x, y and z, got {names}")
    if field.datatype not in _FLOATS or field.count > 1:
        raise CloudError(
            f"PointCloud2 field {name!r}: expected one float32 (7) or float64 (8), "
            f"got {field.count} of datatype {field.datatype}"
        )
    return field
