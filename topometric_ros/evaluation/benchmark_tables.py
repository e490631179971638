"""The tables of a benchmark as Markdown: every rate with its N, a rate of zero with its bound."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

import numpy as np

from topometric_ros.evaluation.benchmark import BenchmarkRow
from topometric_ros.evaluation.metrics_fusion import LITTLE_OVERLAP, RIGHT
from topometric_ros.evaluation.table_cells import markdown_table, rate, share

_BANDS = ((0.5, 1.01), (0.35, 0.5), (0.2, 0.35), (LITTLE_OVERLAP, 0.2))

Rows = Sequence[BenchmarkRow]


def benchmark_tables(
    rows: Rows, origin: str = "", not_simulated: Mapping[str, str] | None = None
) -> str:
    """Return the summary, one table a measure by cell, and every pair, as Markdown.

    Parameters
    ----------
    origin : in words, where the pairs are from
    not_simulated : cases that gave no pair, and why
    """
    peers = list(dict.fromkeys(row.peer for row in rows))
    by_peer = {peer: [row for row in rows if row.peer == peer] for peer in peers}
    parts = [
        *([f"{origin}."] if origin else []),
        _summary(by_peer),
        *_by_cell(by_peer),
        "Right pose found, accepted or not, by the overlap that there is:\n\n"
        + _by_overlap(by_peer),
        "Displacement in m of every pair's best pose, **bold** where it was accepted:\n\n"
        + _by_pair(by_peer),
    ]
    failed = [f"- {row.peer} on {row.pair}: {row.error}" for row in rows if row.error]
    if failed:
        parts.append("Runs that gave nothing:\n\n" + "\n".join(failed))
    if not_simulated:
        told = [f"- {name}: {why}" for name, why in not_simulated.items()]
        parts.append("Cases that could not be simulated:\n\n" + "\n".join(told))
    return "\n\n".join(parts) + "\n"


def share_of(rows: Rows, is_so: Callable[[BenchmarkRow], bool]) -> str:
    """Return the share of rows that are so, with N; where none is, how many there could be."""
    return share(sum(is_so(row) for row in rows), len(rows))


def false_merges(rows: Rows) -> str:
    """Return the rate of false merges with N and its upper 95 % bound."""
    return rate(sum(row.false_merge for row in rows), len(rows))


def _summary(by_peer: dict[str, list[BenchmarkRow]]) -> str:
    head = ["method", "right and accepted", "strictly", "right pose found", "strictly"]
    head += ["false merges", "CPU s, median", "most", "peak MB"]
    lines = []
    for peer, rows in by_peer.items():
        possible = _possible(rows)
        seconds = _known(row.cpu for row in rows)
        lines.append(
            [
                peer,
                share_of(possible, lambda row: row.accepted and row.right),
                share_of(possible, lambda row: row.accepted and row.strictly_right),
                share_of(possible, lambda row: row.right),
                share_of(possible, lambda row: row.strictly_right),
                false_merges(rows),
                _median(seconds),
                f"{max(seconds):.1f}" if seconds else "–",
                _peak(rows),
            ]
        )
    return markdown_table(head, lines)


def _by_cell(by_peer: dict[str, list[BenchmarkRow]]) -> list[str]:
    """Return one titled table a measure, cells down and methods across; none of a single cell."""
    cells = dict.fromkeys(row.cell for rows in by_peer.values() for row in rows)
    if len(cells) < 2:
        return []
    measures: dict[str, Callable[[Rows], str]] = {
        "Right and accepted": lambda rows: share_of(
            _possible(rows), lambda row: row.accepted and row.right
        ),
        "Strictly right and accepted": lambda rows: share_of(
            _possible(rows), lambda row: row.accepted and row.strictly_right
        ),
        "Right pose found, accepted or not": lambda rows: share_of(
            _possible(rows), lambda row: row.right
        ),
        "False merges": false_merges,
        "CPU seconds, median": lambda rows: _median(row.cpu for row in rows),
        "Peak memory, MB": _peak,
    }
    parts = []
    for title, measured in measures.items():
        lines = [
            [cell, *(measured([r for r in rows if r.cell == cell]) for rows in by_peer.values())]
            for cell in cells
        ]
        parts.append(f"{title}, by cell:\n\n" + markdown_table(["cell", *by_peer], lines))
    return parts


def _possible(rows: Rows) -> Rows:
    """Return the rows of pairs that share enough for a refusal to count."""
    return [row for row in rows if row.overlap >= LITTLE_OVERLAP]


def _known(values: Iterable[float]) -> list[float]:
    return [value for value in values if np.isfinite(value)]


def _median(values: Iterable[float]) -> str:
    known = _known(values)
    return f"{np.median(known):.1f}" if known else "–"


def _peak(rows: Rows) -> str:
    known = _known(row.peak_mb for row in rows)
    return f"{max(known):.0f}" if known else "–"


def _by_overlap(by_peer: dict[str, list[BenchmarkRow]]) -> str:
    lines = []
    for low, high in _BANDS:
        cells = [[row for row in rows if low <= row.overlap < high] for rows in by_peer.values()]
        if any(cells):
            name = f"{low:g} and more" if high > 1 else f"{low:g} to {high:g}"
            lines.append([name, *(share_of(cell, lambda row: row.right) for cell in cells)])
    return markdown_table(["overlap", *by_peer], lines)


def _by_pair(by_peer: dict[str, list[BenchmarkRow]]) -> str:
    pairs = dict.fromkeys((row.pair, row.overlap) for rows in by_peer.values() for row in rows)
    lines = []
    for pair, overlap in pairs:
        line = [pair, f"{overlap:.2f}"]
        for rows in by_peer.values():
            row = next((row for row in rows if row.pair == pair), None)
            line.append("" if row is None else _displacement(row))
        lines.append(line)
    return markdown_table(["pair", "overlap", *by_peer], lines)


def _displacement(row: BenchmarkRow) -> str:
    if not np.isfinite(row.displacement):
        return "–"
    text = f"{row.displacement:.3f}" if row.displacement < 10 else f"{row.displacement:.0f}"
    if row.displacement < RIGHT[0] and row.angle >= RIGHT[1]:
        text += f" ({row.angle:.0f}°)"
    return f"**{text}**" if row.accepted else text
