"""Numbers in text files: point lists of any common kind, and the tables of ASCII PLY and PCD."""

from __future__ import annotations

import os
import warnings
from collections.abc import Iterator
from itertools import chain
from pathlib import Path
from typing import IO

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import one_line
from topometric_ros.io.pointcloud2 import CloudError

_COMMENTS = (b"#", b"//")
_MARK = b"\xef\xbb\xbf"
"""What some programs put before a text in UTF-8."""


def read_text_points(path: Path) -> NDArray[np.float64]:
    """Read x, y and z from the first three columns of a text file: (N, 3) float64.

    Columns are parted by spaces, tabs, commas or semicolons; beside semicolons, commas are decimal.
    Lines of comments are left out, and one line with the columns' names or the number of points
    before all others.

    Raises
    ------
    CloudError
        A line does not begin with three numbers.
    """
    with path.open("rb") as file:
        rows = _rows(file)
        first = next(rows, None)
        if first is not None and _is_heading(first):
            first = next(rows, None)
        if first is None:
            return np.empty((0, 3))
        try:
            return np.loadtxt(chain([first], rows), usecols=(0, 1, 2), ndmin=2, comments=None)
        except ValueError as error:
            raise CloudError(f"{path}: expected three numbers a line: {one_line(error)}") from error


def table_of_text(
    path: Path, file: IO[bytes], columns: list[int], count: int, what: str, items: str
) -> NDArray[np.float64]:
    """Return three columns of the next `count` lines of an open file: (count, 3) float64.

    `what` and `items` name the file and its lines in errors.

    Raises
    ------
    CloudError
        A line lacks a number, or there are too few lines.
    """
    if count == 0:
        return np.empty((0, 3))
    # Every number takes two bytes at least, so that a wrong count takes no memory.
    most = (os.fstat(file.fileno()).st_size - file.tell()) // (2 * (max(columns) + 1)) + 1
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", UserWarning)  # No rows: counted below.
            points = np.loadtxt(
                file, usecols=columns, max_rows=min(count, most), ndmin=2, comments=None
            )
    except ValueError as error:
        raise CloudError(
            f"{path}: the {what}'s {items} cannot be read: {one_line(error)}"
        ) from error
    if len(points) < count:
        raise CloudError(
            f"{path}: the {what} ends early: expected {count} {items}, got {len(points)}"
        )
    return points


def _rows(file: IO[bytes]) -> Iterator[bytes]:
    for number, line in enumerate(file):
        row = line.removeprefix(_MARK) if number == 0 else line
        if b";" in row:
            row = row.replace(b",", b".").replace(b";", b" ")
        else:
            row = row.replace(b",", b" ")
        if row.strip() and not row.lstrip().startswith(_COMMENTS):
            yield row


def _is_heading(row: bytes) -> bool:
    """Whether a file's first row is one of names, or the number of points alone."""
    words = row.split()
    if len(words) == 1 and words[0].isdigit():
        return True
    try:
        [float(word) for word in words[:3]]
    except ValueError:
        return len(words) >= 3 and all(word[:1].isalpha() or word[:1] == b'"' for word in words[:3])
    return False
