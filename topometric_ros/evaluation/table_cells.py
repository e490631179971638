"""A table and its cells: shares with their N, rates of zero with their bound, means and medians."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from topometric_ros.evaluation.metrics_fusion import upper_bound


@dataclass(frozen=True)
class Table:
    """A titled table with a note below it; `cells` are plain text."""

    title: str
    head: tuple[str, ...]
    cells: tuple[tuple[str, ...], ...]
    note: str = ""


def markdown_table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table of numbers in Markdown: the first column to the left, the others not."""
    rule = "|---" + "|---:" * (len(head) - 1) + "|"
    return "\n".join([f"| {' | '.join(head)} |", rule, *(f"| {' | '.join(row)} |" for row in rows)])


def markdown(title: str, made: Iterable[Table]) -> str:
    """Return the tables as a Markdown document."""
    parts = [f"# {title}"]
    for table in made:
        lines = ["| " + " | ".join(table.head) + " |", "|---" * len(table.head) + "|"]
        lines += [
            "| " + " | ".join(cell.replace("|", "\\|") for cell in row) + " |"
            for row in table.cells
        ]
        parts += [f"## {table.title}", "\n".join(lines), *([table.note] if table.note else [])]
    return "\n\n".join(parts) + "\n"


def share(part: float, whole: int) -> str:
    """Return a share with its N, a share of zero with its upper 95 % bound.

    Examples
    --------
    >>> share(3, 4)
    '75 % (3/4)'
    >>> share(0, 30)
    '0 % (0/30; below 9.5 %)'
    >>> share(0, 0)
    '–'
    """
    if whole and not part:
        return rate(0, whole)
    return f"{100 * part / whole:.0f} % ({part:.0f}/{whole})" if whole else "–"


def rate(events: int, trials: int) -> str:
    """Return a rate of what should never be, with its upper 95 % bound.

    Examples
    --------
    >>> rate(0, 30)
    '0 % (0/30; below 9.5 %)'
    """
    if not trials:
        return "–"
    bound = 100 * upper_bound(events, trials)
    return f"{100 * events / trials:.0f} % ({events}/{trials}; below {bound:.1f} %)"


def mean(values: Iterable[float], digits: int = 2) -> str:
    """Return mean, smallest and N of the numbers that are there.

    Examples
    --------
    >>> mean([0.5, 1.0, float("nan")])
    '0.75 (least 0.50, N = 2)'
    """
    known = [value for value in values if not np.isnan(value)]
    if not known:
        return "–"
    least = f"least {min(known):.{digits}f}, N = {len(known)}"
    return f"{np.mean(known):.{digits}f} ({least})"


def median(values: Iterable[float], digits: int, unit: str) -> str:
    """Return median, largest and N.

    Examples
    --------
    >>> median([1.0, 3.0, 2.0], 1, "m")
    '2.0 m (most 3.0, N = 3)'
    """
    known = [value for value in values if not np.isnan(value)]
    if not known:
        return "–"
    most = f"most {max(known):.{digits}f}, N = {len(known)}"
    return f"{np.median(known):.{digits}f} {unit} ({most})"
