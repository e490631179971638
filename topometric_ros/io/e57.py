"""E57 files of surveyors' scanners (ASTM E2807), read by pye57: all scans, each in its pose.

A scan holds Cartesian or spherical coordinates in the scanner's frame; points that the scanner
marked as invalid are left out.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.io.pointcloud2 import CloudError, missing_reader, require_memory

_MOST_POINTS_A_BYTE = 8
"""A scan that claims more points than this for each byte of its file is damaged or hostile."""

_SIZE = 24
"""Bytes of a point's coordinates, which pye57 keeps as read and in the scan's pose."""

_DAMAGED = (ValueError, KeyError, TypeError, RuntimeError, OverflowError, MemoryError)
"""What else pye57 raises for fields that are missing or of another kind."""


def read_e57_points(path: Path) -> NDArray[np.float64]:
    """Return the points of all scans of an E57 file: (N, 3) float64, in the file's own frame.

    Raises
    ------
    CloudError
        The file is damaged, or the package that reads it is not installed.
    """
    try:
        import pye57
        from pye57.libe57 import E57Exception
    except ImportError as error:
        raise missing_reader(path, "E57", "pye57") from error
    try:
        with pye57.E57(str(path)) as file:
            scans = [_scan(path, file, index) for index in range(file.scan_count)]
    except (E57Exception, *_DAMAGED) as error:
        line = (str(error).splitlines() or [type(error).__name__])[0]
        raise CloudError(f"{path}: not a complete E57 file: {line}") from error
    if not scans:
        raise CloudError(f"{path}: expected an E57 file with one scan at least, got none")
    return np.concatenate(scans)


def _scan(path: Path, file: Any, index: int) -> NDArray[np.float64]:
    """Return the valid points (n, 3) of a scan, in the file's frame."""
    count, size = file.get_header(index).point_count, path.stat().st_size
    if not 0 <= count <= _MOST_POINTS_A_BYTE * size:
        raise CloudError(
            f"{path}: not a complete E57 file: scan {index} claims {count} points, "
            f"the file has {size} bytes"
        )
    require_memory(path, count, 2 * _SIZE)
    fields = file.read_scan(index, ignore_missing_fields=True)
    return np.column_stack([fields[f"cartesian{axis}"] for axis in "XYZ"])
