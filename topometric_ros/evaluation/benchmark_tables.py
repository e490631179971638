"""The tables of a benchmark as Markdown: every rate with its N, a rate of zero with its bound."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from topometric_ros.evaluation.benchmark import BenchmarkRow
from topometric_ros.evaluation.metrics_fusion import LITTLE_OVERLAP, RIGHT
from topometric_ros.evaluation.table_cells import rate, share

_BANDS = ((0.5, 1.01), (0.35, 0.5), (0.2, 0.35), (LITTLE_OVERLAP, 0.2))

Rows = Sequence[BenchmarkRow]


def benchmark_tables(rows: Rows) -> str:
    """Return the summary, the poses by overlap and every pair, as Markdown."""
    peers = list(dict.fromkeys(row.peer for row in rows))
    by_peer = {peer: [row for row in rows if row.peer == peer] for peer in peers}
    parts = [
        _summary(by_peer),
        "Right pose found, accepted or not, by overlap:\n\n" + _by_overlap(by_peer),
        "Displacement in m of every pair's best pose, **bold** where it was accepted:\n\n"
        + _by_pair(by_peer),
    ]
    failed = [f"- {row.peer} on {row.pair}: {row.error}" for row in rows if row.error]
    if failed:
        parts.append("Runs that gave nothing:\n\n" + "\n".join(failed))
    return "\n\n".join(parts) + "\n"


def share_of(rows: Rows, is_so: Callable[[BenchmarkRow], bool]) -> str:
    """Return the share of rows that are so, with N; where none is, how many there could be."""
    count = sum(is_so(row) for row in rows)
    return share(count, len(rows)) if count else rate(0, len(rows))


def false_merges(rows: Rows) -> str:
    """Return the rate of false merges with N and its upper 95 % bound."""
    return rate(sum(row.false_merge for row in rows), len(rows))


def _summary(by_peer: dict[str, list[BenchmarkRow]]) -> str:
    head = ["method", "right and accepted", "strictly", "right pose found", "strictly"]
    head += ["false merges", "CPU s, median", "most", "peak MB"]
    lines = []
    for peer, rows in by_peer.items():
        possible = [row for row in rows if row.overlap >= LITTLE_OVERLAP]
        seconds = [row.cpu for row in rows if np.isfinite(row.cpu)]
        memory = [row.peak_mb for row in rows if np.isfinite(row.peak_mb)]
        lines.append(
            [
                peer,
                share_of(possible, lambda row: row.accepted and row.right),
                share_of(possible, lambda row: row.accepted and row.strictly_right),
                share_of(possible, lambda row: row.right),
                share_of(possible, lambda row: row.strictly_right),
                false_merges(rows),
                f"{np.median(seconds):.1f}" if seconds else "–",
                f"{max(seconds):.1f}" if seconds else "–",
                f"{max(memory):.0f}" if memory else "–",
            ]
        )
    return _table(head, lines)


def _by_overlap(by_peer: dict[str, list[BenchmarkRow]]) -> str:
    lines = []
    for low, high in _BANDS:
        cells = [[row for row in rows if low <= row.overlap < high] for rows in by_peer.values()]
        if any(cells):
            name = f"{low:g} and more" if high > 1 else f"{low:g} to {high:g}"
            lines.append([name, *(share_of(cell, lambda row: row.right) for cell in cells)])
    return _table(["overlap", *by_peer], lines)


def _by_pair(by_peer: dict[str, list[BenchmarkRow]]) -> str:
    pairs = dict.fromkeys((row.pair, row.overlap) for rows in by_peer.values() for row in rows)
    lines = []
    for pair, overlap in pairs:
        line = [pair, f"{overlap:.2f}"]
        for rows in by_peer.values():
            row = next((row for row in rows if row.pair == pair), None)
            line.append("" if row is None else _displacement(row))
        lines.append(line)
    return _table(["pair", "overlap", *by_peer], lines)


def _displacement(row: BenchmarkRow) -> str:
    if not np.isfinite(row.displacement):
        return "–"
    text = f"{row.displacement:.3f}" if row.displacement < 10 else f"{row.displacement:.0f}"
    if row.displacement < RIGHT[0] and row.angle >= RIGHT[1]:
        text += f" ({row.angle:.0f}°)"
    return f"**{text}**" if row.accepted else text


def _table(head: Sequence[str], lines: Sequence[Sequence[str]]) -> str:
    rule = "|---" + "|---:" * (len(head) - 1) + "|"
    return "\n".join(
        [f"| {' | '.join(head)} |", rule, *(f"| {' | '.join(line)} |" for line in lines)]
    )
