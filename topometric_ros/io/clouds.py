"""Point clouds from files: one function for every format, with the same checks for each."""

from __future__ import annotations

import logging
import math
import zipfile
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from tokenize import TokenError
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import one_line
from topometric_ros.io.e57 import read_e57_points
from topometric_ros.io.las import read_las_points
from topometric_ros.io.pcd import read_pcd_points
from topometric_ros.io.ply import read_ply_points
from topometric_ros.io.pointcloud2 import CloudError, require_memory
from topometric_ros.io.text import read_text_points

__all__ = ["CLOUD_SUFFIXES", "Cloud", "CloudError", "finite_cloud", "read_cloud", "up_rotation"]

logger = logging.getLogger(__name__)

_MOST_COLUMNS = 100
"""An array with more is one whose points are its columns."""

DAMAGED_NUMPY = (
    ValueError, EOFError, OverflowError, SyntaxError, NotImplementedError, RuntimeError,
    TokenError, zipfile.BadZipFile, zlib.error,
)  # fmt: skip
"""What numpy and zipfile raise for files that are cut short, changed or encrypted."""

_UP_ROTATIONS = {
    "x": ((0.0, 0.0, -1.0), (0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
    "y": ((1.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0)),
    "z": ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)),
    "-x": ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)),
    "-y": ((1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (0.0, -1.0, 0.0)),
    "-z": ((1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.0, 0.0, -1.0)),
}
UP_AXES = tuple(_UP_ROTATIONS)


@dataclass(frozen=True)
class Cloud:
    """Finite points with z up, and what became of the others.

    `points` (N, 3) float64, m, turned by `T_up_input` (4, 4) from the file's own frame; `dropped`
    counts the points with a NaN or infinite coordinate; `warnings` are sentences for a person.
    """

    points: NDArray[np.float64]
    dropped: int
    warnings: tuple[str, ...]
    T_up_input: NDArray[np.float64]


def up_rotation(up: str) -> NDArray[np.float64]:
    """Return `T_up_input` (4, 4): the rotation that turns the axis `up` of the input to z.

    Raises
    ------
    CloudError
        `up` is none of x, y, z, -x, -y and -z.
    """
    if up not in _UP_ROTATIONS:
        raise CloudError(f"up: expected one of {', '.join(UP_AXES)}, got {up!r}")
    T_up_input = np.eye(4)
    T_up_input[:3, :3] = _UP_ROTATIONS[up]
    return T_up_input


def read_cloud(path: Path | str, up: str = "z", scale: float = 1.0) -> Cloud:
    """Read a point cloud: .ply, .pcd, .npy, .npz, .las, .laz, .e57 or text (.xyz, .txt, .csv, ...).

    Parameters
    ----------
    path : file to read
    up : axis of the file that points up
    scale : length of the file's unit, m

    Raises
    ------
    CloudError
        The file is missing, damaged, of an unknown kind, or holds no finite point; or the scale
        is no positive number.
    """
    path = Path(path)
    T_up_input = up_rotation(up)
    if not (math.isfinite(scale) and scale > 0.0):
        raise CloudError(f"scale: expected a positive number of metres, got {scale:g}")
    reader = _READERS.get(path.suffix.lower())
    if not path.exists():
        raise CloudError(f"{path}: no such file")
    if reader is None or path.is_dir():
        raise CloudError(
            f"{path}: expected a cloud file ({' '.join(CLOUD_SUFFIXES)}), "
            f"got {'a directory' if path.is_dir() else repr(path.suffix)}"
        )
    if not path.is_file():
        raise CloudError(f"{path}: expected a file on disk")
    try:
        with np.errstate(invalid="ignore", over="ignore"):  # Signalling NaN is dropped as any.
            points = reader(path)
    except OSError as error:
        raise CloudError(f"{path}: cannot be read: {error}") from error
    return finite_cloud(points if scale == 1.0 else points * scale, str(path), T_up_input)


def finite_cloud(
    points: NDArray[np.float64], source: str, T_up_input: NDArray[np.float64], dropped: int = 0
) -> Cloud:
    """Drop and count the points that are not finite, and turn the others so that z is up.

    `dropped` points were left out before. Raises CloudError where no finite point is left.
    """
    if len(points) + dropped == 0:
        raise CloudError(f"{source}: the cloud is empty (0 points)")
    finite = np.isfinite(points).all(axis=1)
    dropped += len(points) - int(np.count_nonzero(finite))
    total = int(np.count_nonzero(finite)) + dropped
    if dropped == total:
        raise CloudError(f"{source}: none of the cloud's {total} points is finite")
    kept = points[finite] if not finite.all() else points
    warnings: tuple[str, ...] = ()
    if dropped:
        warnings = (f"{dropped} of {total} points were not finite and were dropped",)
        logger.info("%s: %s", source, warnings[0])
    if not np.array_equal(T_up_input, np.eye(4)):
        kept = kept @ T_up_input[:3, :3].T
    return Cloud(kept, dropped, warnings, T_up_input)


def _read_numpy(path: Path) -> NDArray[np.float64]:
    """Read an (N, 3 or more) array or one with the fields x, y and z.

    Of an archive the entry `points` is read, else its only one.
    """
    try:
        # Mapped, so that a file shorter than its header says is refused before memory is taken.
        loaded = np.load(path, mmap_mode="r", allow_pickle=False)
        if isinstance(loaded, np.lib.npyio.NpzFile):
            with loaded as archive:
                array = _entry(path, archive)
        else:
            array = np.asarray(loaded)
    except DAMAGED_NUMPY as error:
        raise CloudError(f"{path}: not a complete numpy file: {one_line(error)}") from error
    if array.ndim == 1 and {"x", "y", "z"} <= set(array.dtype.names or ()):
        array = np.column_stack([array[axis] for axis in "xyz"])
    columns = array.shape[1] if array.ndim == 2 else 0
    if not 3 <= columns <= _MOST_COLUMNS or array.dtype.kind not in "fiu":
        raise CloudError(
            f"{path}: expected numbers of shape (N, 3), got {array.dtype} {array.shape}"
        )
    return array[:, :3].astype(np.float64)


def _entry(path: Path, archive: Any) -> NDArray[Any]:
    """Return the array of a .npz; raises CloudError, and ValueError for a damaged one."""
    name = "points" if "points" in archive.files else None
    if name is None and len(archive.files) == 1:
        name = archive.files[0]
    if name is None:
        found = ", ".join(archive.files) or "none"
        raise CloudError(f"{path}: expected an array named points, got {found}")
    packed = archive.zip
    entry = next((e for e in packed.infolist() if e.filename in (f"{name}.npy", name)), None)
    if entry is None or not entry.filename.endswith(".npy"):
        raise CloudError(f"{path}: expected an array named points, got the file {name}")
    with packed.open(entry) as file:
        version = np.lib.format.read_magic(file)
        read_header = (
            np.lib.format.read_array_header_1_0
            if version == (1, 0)
            else np.lib.format.read_array_header_2_0
        )
        shape, _, dtype = read_header(file)
    size = math.prod(shape) * dtype.itemsize
    if size > entry.file_size:
        raise CloudError(
            f"{path}: {name} ends early: expected {size} bytes for {shape}, got {entry.file_size}"
        )
    require_memory(path, size // (3 * dtype.itemsize or 1), 3 * dtype.itemsize)
    return np.asarray(archive[name])


_READERS: dict[str, Callable[[Path], NDArray[np.float64]]] = {
    ".ply": read_ply_points,
    ".pcd": read_pcd_points,
    **dict.fromkeys((".xyz", ".txt", ".csv", ".asc", ".pts"), read_text_points),
    ".npy": _read_numpy,
    ".npz": _read_numpy,
    ".las": read_las_points,
    ".laz": read_las_points,
    ".e57": read_e57_points,
}
CLOUD_SUFFIXES = tuple(_READERS)
