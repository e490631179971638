"""One row of results: a case under a preset; how it is computed and how it stands in the CSV.

Numbers of each agent or each two agents stand in one cell, divided by semicolons. The row holds
nothing that differs from run to run: CPU seconds are kept apart (`Seconds`).
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass
from typing import Any, get_type_hints

Numbers = tuple[float, ...]


@dataclass(frozen=True)
class CaseResult:
    """A case under a preset. Lengths: A agents, P pairs of them; NaN where there is no value.

    `stages` of matching are the assignment alone, the best grown hypothesis (whether or not it was
    believed) and the matches of the accepted alignment.
    """

    key: str
    case: str
    preset: str
    group: str
    building: str
    seed: int
    failed: str = ""
    """Why there is no result: the error in one line."""
    points: Numbers = ()
    """(A,) points of the raw cloud."""
    message_bytes: Numbers = ()
    """(A,) size of the map's message."""
    rooms_walked: Numbers = ()
    """(A,) true rooms that the agent walked through; none where rooms are not scored here."""
    rooms_found: Numbers = ()
    miou_paper: Numbers = ()
    left_over: Numbers = ()
    miou_whole: Numbers = ()
    miou_walked: Numbers = ()
    room_precision: Numbers = ()
    room_recall: Numbers = ()
    edges_found: Numbers = ()
    edges_right: Numbers = ()
    edges_true: Numbers = ()
    edges_covered: Numbers = ()
    overlap: Numbers = ()
    """(P,) true overlap."""
    accepted: Numbers = ()
    """(P,) 1 or 0."""
    confidence: Numbers = ()
    displacement: Numbers = ()
    """(P,) m; NaN where nothing was accepted or there is no true transform."""
    angle: Numbers = ()
    """(P,) degrees."""
    nearest: Numbers = ()
    """(P,) m."""
    right: Numbers = ()
    """(P,) 1 where a transform was accepted and is right."""
    strict: Numbers = ()
    room_pairs: Numbers = ()
    """(P,) rooms of a times rooms of b."""
    possible: Numbers = ()
    possible_overlap: Numbers = ()
    assigned: Numbers = ()
    """(P,) matches made, one room to one; `assigned_overlap` with further pieces of rooms."""
    assigned_right: Numbers = ()
    assigned_overlap: Numbers = ()
    assigned_right_overlap: Numbers = ()
    grown: Numbers = ()
    grown_right: Numbers = ()
    grown_overlap: Numbers = ()
    grown_right_overlap: Numbers = ()
    final: Numbers = ()
    final_right: Numbers = ()
    final_overlap: Numbers = ()
    final_right_overlap: Numbers = ()


@dataclass(frozen=True)
class Seconds:
    """CPU seconds that a row took: extraction of all agents, and merging with fusion."""

    extraction: float
    merging: float


_KINDS = get_type_hints(CaseResult)
COLUMNS = tuple(field.name for field in dataclasses.fields(CaseResult))


def to_cells(row: CaseResult) -> list[str]:
    """Return the row's cells in the order of `COLUMNS`."""
    return [_cell(getattr(row, name)) for name in COLUMNS]


def from_cells(cells: dict[str, str]) -> CaseResult:
    """Undo :func:`to_cells`; raises ValueError or KeyError for cells that are no row."""
    return CaseResult(**{name: _value(name, cells[name]) for name in COLUMNS})


def _cell(value: Any) -> str:
    if isinstance(value, tuple):
        return ";".join(f"{number:.7g}" for number in value)
    return " ".join(str(value).split())


def _value(name: str, cell: str) -> Any:
    kind = _KINDS[name]
    if kind is str:
        return cell
    if kind is int:
        return int(cell)
    return tuple(float(number) for number in cell.split(";")) if cell else ()
