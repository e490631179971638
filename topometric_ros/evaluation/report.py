"""The report of an evaluation: one HTML page with the tables, then the cases, worst first.

A false merge is worse than a refusal, a refusal of agents that share a lot worse than badly found
rooms. The worst cases have pictures: rooms over truth, matches, the agents laid over each other
and the fused map.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from topometric_ros.evaluation.case_result import CaseResult, Seconds
from topometric_ros.evaluation.figures import reliability_figure
from topometric_ros.evaluation.report_cases import case_card
from topometric_ros.evaluation.table_cells import Table
from topometric_ros.evaluation.tables import is_false, possible, tables
from topometric_ros.visualization.page import page, picture, pill, text, tiles
from topometric_ros.visualization.page import table as html_table

PICTURED = 4
"""So many cases of each preset have pictures."""


def report_html(
    title: str,
    rows: Sequence[CaseResult],
    seconds: Mapping[str, Seconds],
    out: Path,
    *,
    pictured: int = PICTURED,
    progress: Callable[[str], None] = lambda text: None,
) -> str:
    """Return the page; pictures are drawn of what `evaluate_case` left in `out`."""
    ranked = sorted(rows, key=badness, reverse=True)
    presets = dict.fromkeys(row.preset for row in rows)
    done = {p: [row for row in ranked if row.preset == p and not row.failed] for p in presets}
    parts = [
        '<p class="kicker">Evaluation of topometric mapping and merging</p>',
        f"<h1>Suite {text(title)}</h1>",
        tiles(_summary(rows)),
        *(_table(table) for table in tables(rows, seconds)),
        _reliability(rows),
        "<h2>All cases, worst first</h2>",
        f'<section class="card">{_all_cases(ranked)}</section>',
    ]
    for preset, members in done.items():
        parts.append(f"<h2>The worst cases under preset {text(preset)}</h2>")
        for row in members[:pictured]:
            progress(f"drawing {row.case} ({row.preset})")
            parts.append(case_card(row, out, pill(*verdict(row))))
    return page(f"Evaluation: {title}", "\n".join(parts))


def _summary(rows: Sequence[CaseResult]) -> list[tuple[str, str]]:
    """Return how many cases there are and, of every preset, what came out."""
    presets = dict.fromkeys(row.preset for row in rows)
    numbers = [(str(len({row.case for row in rows})), "cases")]
    for preset in presets:
        words = [verdict(row)[1] for row in rows if row.preset == preset]
        numbers += [
            (str(words.count(outcome)), f"{outcome}, preset {preset}")
            for outcome in ("right", "not merged", "false merge", "failed")
        ]
    return numbers


def badness(row: CaseResult) -> tuple[float, ...]:
    """Sort key: false merges, then failures, refusals by the overlap refused, the rooms' score."""
    false = sum(is_false(row, k) for k in range(len(row.overlap)))
    refused = sum(
        overlap
        for overlap, accepted in zip(row.overlap, row.accepted, strict=True)
        if possible(overlap) and not accepted
    )
    scores = [score for score in row.miou_walked if not np.isnan(score)]
    return (false, float(bool(row.failed)), refused, 1 - min(scores, default=1.0))


def verdict(row: CaseResult) -> tuple[str, str]:
    """Return (kind of pill, words) for a case."""
    if row.failed:
        return "bad", "failed"
    pairs = range(len(row.overlap))
    if any(is_false(row, k) for k in pairs):
        return "bad", "false merge"
    if any(possible(row.overlap[k]) and not row.accepted[k] for k in pairs):
        return "warn", "not merged"
    return "good", "right" if any(row.right) else "rightly not merged"


def _table(table: Table) -> str:
    """Return a table with its title and note."""
    cells = [[text(cell) for cell in row] for row in table.cells]
    note = f'<p class="soft">{text(table.note)}</p>' if table.note else ""
    body = html_table(table.head, cells)
    return f'<h2>{text(table.title)}</h2><section class="card">{body}{note}</section>'


def _reliability(rows: Sequence[CaseResult]) -> str:
    """Return the reliability diagram of the confidence, nothing where nothing was accepted."""
    forecasts: dict[str, tuple[list[float], list[bool]]] = {}
    for row in rows:
        confidences, right = forecasts.setdefault(row.preset, ([], []))
        for k, accepted in enumerate(row.accepted):
            if accepted:
                confidences.append(row.confidence[k])
                right.append(bool(row.right[k]))
    words = "Each mark: a tenth of the scale with its N and 95 % interval."
    shown = picture(reliability_figure(forecasts), "reliability of the confidence", words)
    title = "<h2>Reliability of the confidence</h2>"
    return f'{title}<section class="card">{shown}</section>' if shown else ""


def _all_cases(rows: Sequence[CaseResult]) -> str:
    """Return the table of all cases."""
    head = ("case", "preset", "", "overlap", "displacement / m", "angle / °", "MIoU walked")
    cells = [
        [
            text(row.case),
            text(row.preset),
            pill(*verdict(row)),
            _numbers(row.overlap, 2),
            _numbers(row.displacement, 3),
            _numbers(row.angle, 2),
            _numbers(row.miou_walked, 2),
        ]
        for row in rows
    ]
    return html_table(head, cells, "   nnnn")


def _numbers(values: Sequence[float], digits: int) -> str:
    """Return numbers side by side, a dash where there is none."""
    cells = ["–" if np.isnan(value) else f"{value:.{digits}f}" for value in values]
    return ", ".join(cells) or "–"
