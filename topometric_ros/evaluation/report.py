"""The report of an evaluation: one HTML page with the tables, then the cases, worst first.

A false merge is worse than a refusal, a refusal of agents that share a lot worse than badly found
rooms. The worst cases have pictures: rooms over truth, matches, the agents laid over each other
and the fused map.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from topometric_ros.alignment import GlobalMap
from topometric_ros.evaluation.case_result import CaseResult, Seconds
from topometric_ros.evaluation.evaluate_case import case_folder
from topometric_ros.evaluation.figures import reliability_figure, rooms_over_truth
from topometric_ros.evaluation.table_cells import Table
from topometric_ros.evaluation.tables import is_false, possible, tables
from topometric_ros.io.map_files import load_global_map, load_map
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.figures import global_figure, hex_colour
from topometric_ros.visualization.page import details, page, picture, pill, text, tiles
from topometric_ros.visualization.page import table as html_table
from topometric_ros.visualization.pair_figures import matches_figure, overlay_figure
from topometric_ros.visualization.stage_files import alignment_of
from topometric_ros.voxels.palette import agent_colour

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
            parts.append(_case(row, out))
    return page(f"Evaluation: {title}", "\n".join(parts))


def _summary(rows: Sequence[CaseResult]) -> list[tuple[str, str]]:
    """Return how many cases there are and, of every preset, what came out."""
    presets = dict.fromkeys(row.preset for row in rows)
    numbers = [(str(len({row.case for row in rows})), "cases")]
    for preset in presets:
        words = [verdict(row)[1] for row in rows if row.preset == preset]
        for outcome in ("right", "not merged", "false merge", "failed"):
            numbers.append((str(words.count(outcome)), f"{outcome}, preset {preset}"))
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
    return f'<section class="card">{shown}</section>' if shown else ""


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


def _case(row: CaseResult, out: Path) -> str:
    """Return the pictures of a case, from its folder."""
    folder = case_folder(out, row.case, row.preset)
    merged = json.loads((folder / "merge.json").read_text(encoding="utf-8"))
    agents = [agent["id"] for agent in merged["agents"]]
    maps = {agent["id"]: load_map(out / agent["source"]) for agent in merged["agents"]}
    rooms = [_rooms_card(name, maps[name], row, i, folder) for i, name in enumerate(agents)]
    parts = [
        f"<h3>{text(row.case)} ({text(row.preset)}) {pill(*verdict(row))}</h3>",
        f'<div class="pair">{"".join(rooms)}</div>',
    ]
    for entry in merged["alignments"]:
        parts.append(_pair(entry, maps, agents))
    placed = [a["id"] for a in merged["agents"] if a["T_global_agent"] is not None]
    if len(placed) > 1:
        fused, observed_by, _ = load_global_map(folder / "global.tmap")
        if observed_by is not None:
            png = global_figure(GlobalMap(fused, observed_by), agents, placed)
            parts.append(picture(png, "fused map", "The fused map; outlined: what each saw."))
    return f'<section class="card">{"".join(parts)}</section>'


def _rooms_card(name: str, m: TopometricMap, row: CaseResult, i: int, folder: Path) -> str:
    """Return one agent's rooms over the truth."""
    words = f"agent {name}: {len(m.rooms)} rooms"
    if row.miou_walked:
        words += f", {row.rooms_walked[i]:.0f} walked through, MIoU walked {row.miou_walked[i]:.2f}"
    true_room = np.load(folder / f"{name}.truth.npy")
    png = rooms_over_truth(m, true_room)
    return f"<div>{picture(png, f'rooms of {name} over truth', words)}</div>"


def _pair(entry: Mapping[str, Any], maps: Mapping[str, TopometricMap], agents: list[str]) -> str:
    """Return what one alignment said, its overlay and its matches."""
    alignment = alignment_of(entry)
    a, b = (maps[name] for name in alignment.agents)
    words = f"{' and '.join(alignment.agents)}: {alignment.status}: {alignment.reason}"
    parts = [f"<p>{text(words)}</p>"]
    if alignment.T_a_b is not None:
        colours = [hex_colour(agent_colour(agents.index(name))) for name in alignment.agents]
        png = overlay_figure(a, b, alignment.T_a_b, (colours[0], colours[1]))
        parts.append(picture(png, "overlay", "Walls laid over each other; red: in conflict."))
    if alignment.matches:
        note = f"{len(alignment.matches)} matched rooms; unmatched rooms are grey."
        parts.append(details("matches", picture(matches_figure(a, b, alignment), "matches", note)))
    return "".join(parts)


def _numbers(values: Sequence[float], digits: int) -> str:
    """Return numbers side by side, a dash where there is none."""
    cells = ["–" if np.isnan(value) else f"{value:.{digits}f}" for value in values]
    return ", ".join(cells) or "–"
