"""The files of an evaluation: rows.csv, the same for the same suite, and seconds.csv beside it."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path

import topometric_ros
from topometric_ros.evaluation.case_result import (
    COLUMNS,
    CaseResult,
    Numbers,
    Seconds,
    from_cells,
    to_cells,
)
from topometric_ros.evaluation.suite import CaseSpec
from topometric_ros.io.summaries import write_atomically
from topometric_ros.runtime.config import dump_config, preset_config

logger = logging.getLogger(__name__)

ROWS, SECONDS = "rows.csv", "seconds.csv"


def row_key(spec: CaseSpec, preset: str) -> str:
    """Return what a row depends on but the code: case, parameters and version, as 16 digits."""
    text = json.dumps(asdict(spec), sort_keys=True, default=str)
    text += topometric_ros.__version__ + dump_config(preset_config(preset))
    return hashlib.sha256(text.encode()).hexdigest()[:16]


def read_rows(folder: Path) -> dict[str, CaseResult]:
    """Return the rows of an earlier run by their keys; rows that failed are left out, to be redone.

    A file of other columns counts as none.
    """
    rows = {}
    try:
        with (folder / ROWS).open(newline="", encoding="utf-8") as file:
            for cells in csv.DictReader(file):
                row = from_cells(cells)
                if not row.failed:
                    rows[row.key] = row
    except FileNotFoundError:
        return {}
    except (KeyError, TypeError, ValueError) as error:
        logger.warning("%s: rows of another version, all are computed again: %s", folder, error)
        return {}
    return rows


def clear(folder: Path) -> None:
    """Forget the rows and maps of an earlier run."""
    for path in (folder / ROWS, folder / SECONDS, *(folder / "maps").glob("*.tmap")):
        path.unlink(missing_ok=True)


def write_rows(folder: Path, rows: Sequence[CaseResult]) -> None:
    """Write the rows in the order given, in one step."""
    _write(folder / ROWS, COLUMNS, [to_cells(row) for row in rows])


def read_seconds(folder: Path) -> dict[str, Seconds]:
    """Return the CPU seconds of an earlier run's rows by their keys."""
    try:
        with (folder / SECONDS).open(newline="", encoding="utf-8") as file:
            return {
                cells["key"]: Seconds(float(cells["extraction"]), float(cells["merging"]))
                for cells in csv.DictReader(file)
            }
    except (FileNotFoundError, KeyError, TypeError, ValueError):
        return {}


def write_seconds(folder: Path, seconds: Mapping[str, Seconds]) -> None:
    """Write the CPU seconds of the rows."""
    cells = [[key, f"{s.extraction:.2f}", f"{s.merging:.2f}"] for key, s in seconds.items()]
    _write(folder / SECONDS, ("key", "extraction", "merging"), cells)


def _write(path: Path, head: Sequence[str], cells: Sequence[Sequence[str]]) -> None:
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(head)
    writer.writerows(cells)
    write_atomically(path, stream.getvalue().encode())


def grouped(
    rows: Sequence[CaseResult], group: Callable[[CaseResult], str]
) -> list[tuple[str, str, list[CaseResult]]]:
    """Return (group, preset, rows) in the order of first rows, presets of a group together."""
    groups = dict.fromkeys(group(row) for row in rows)
    presets = dict.fromkeys(row.preset for row in rows)
    split = [
        (g, p, [row for row in rows if group(row) == g and row.preset == p])
        for g in groups
        for p in presets
    ]
    return [part for part in split if part[2]]


def column(rows: Iterable[CaseResult], name: str) -> Numbers:
    """Return the numbers of a column of all rows, one after another."""
    return tuple(value for row in rows for value in getattr(row, name))
