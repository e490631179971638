"""The tables of an evaluation, for Markdown and the report alike: presets side by side."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from topometric_ros.evaluation.case_result import CaseResult, Seconds
from topometric_ros.evaluation.metrics_fusion import (
    LITTLE_OVERLAP,
    NO_OVERLAP,
    RAW_POINT_BYTES,
    brier_score,
    reliability,
)
from topometric_ros.evaluation.rows import column, grouped
from topometric_ros.evaluation.table_cells import Table, mean, median, rate, share
from topometric_ros.evaluation.tables_matching import matches_by_overlap, matching_table


def tables(rows: Sequence[CaseResult], seconds: Mapping[str, Seconds]) -> list[Table]:
    """Return all tables that the rows have numbers for, presets side by side."""
    failed = [row for row in rows if row.failed]
    done = [row for row in rows if not row.failed]
    made = [
        _fusion(done),
        _rooms(done),
        _graph(done),
        matching_table(done),
        matches_by_overlap(done),
        _calibration(done),
        _wire(done),
        _seconds(done, seconds),
    ]
    if failed:
        cells = tuple((row.case, row.preset, row.failed) for row in failed)
        made.insert(0, Table("Failed", ("case", "preset", "why"), cells))
    return [table for table in made if table.cells]


def is_false(row: CaseResult, pair: int) -> bool:
    """Return whether a pair of agents was merged and must not have been, or wrongly."""
    return bool(row.accepted[pair]) and not row.right[pair]


def possible(overlap: float) -> bool:
    """Return whether a refusal counts against us: the agents share a tenth or more."""
    return overlap >= LITTLE_OVERLAP


def _fusion(rows: Sequence[CaseResult]) -> Table:
    cells = []
    for group, preset, members in grouped(rows, lambda row: row.group):
        pairs = [(row, k) for row in members for k in range(len(row.overlap))]
        able = [(row, k) for row, k in pairs if possible(row.overlap[k])]
        apart = [(row, k) for row, k in pairs if row.overlap[k] < NO_OVERLAP]
        right = [(row, k) for row, k in pairs if row.right[k]]
        cells.append(
            (
                group,
                preset,
                share(sum(row.right[k] for row, k in able), len(able)),
                share(sum(row.strict[k] for row, k in able), len(able)),
                rate(sum(is_false(row, k) for row, k in pairs), len(pairs)),
                rate(sum(is_false(row, k) for row, k in apart), len(apart)),
                median((100 * row.displacement[k] for row, k in right), 1, "cm"),
                median((row.angle[k] for row, k in right), 2, "°"),
                median((100 * row.nearest[k] for row, k in right), 1, "cm"),
            )
        )
    head = (
        "cases",
        "preset",
        "right",
        "strictly right",
        "false merges",
        "false merges of pairs that share nothing",
        "displacement",
        "rotation",
        "nearest",
    )
    note = (
        "Right: accepted, mean displacement of b's points below 0.5 m and rotation below 5°; "
        "strictly: 0.1 m and 1°; both of the pairs that share a tenth or more. False: accepted and "
        "not right. Of the right ones: displacement, rotation error, and mean distance to the "
        "nearest point of the truly placed cloud, which is kinder."
    )
    return Table("Fusion", head, tuple(cells), note)


def _rooms(rows: Sequence[CaseResult]) -> Table:
    cells = []
    for group, preset, members in grouped(rows, lambda row: row.group):
        if not any(row.rooms_walked for row in members):
            continue
        cells.append(
            (
                group,
                preset,
                mean(column(members, "miou_paper")),
                " of ".join(
                    f"{sum(column(members, name)):.0f}" for name in ("left_over", "rooms_found")
                ),
                mean(column(members, "miou_whole")),
                mean(column(members, "miou_walked")),
                mean(column(members, "room_precision")),
                mean(column(members, "room_recall")),
                f"{sum(column(members, 'rooms_walked')):.0f}",
            )
        )
    head = (
        "cases",
        "preset",
        "MIoU paper",
        "rooms left over",
        "MIoU whole",
        "MIoU walked",
        "precision",
        "recall",
        "rooms walked",
    )
    note = (
        "N are maps. Paper: mean over the assigned pairs of rooms (§5.2), which rooms left over do "
        "not lower. Whole: true rooms as large as all agents together saw them. Walked: divided by "
        "the rooms walked through. Precision and recall as in Bormann et al. 2016."
    )
    return Table("Rooms", head, tuple(cells), note)


def _graph(rows: Sequence[CaseResult]) -> Table:
    cells = []
    for group, preset, members in grouped(rows, lambda row: row.group):
        found, right = (int(sum(column(members, f"edges_{x}"))) for x in ("found", "right"))
        true, covered = (int(sum(column(members, f"edges_{x}"))) for x in ("true", "covered"))
        if found or true:
            cells.append((group, preset, share(right, found), share(covered, true)))
    note = (
        "Precision: passages that join rooms which are joined in truth. Recall: true links between "
        "rooms that the map holds. Only of cases whose links are known."
    )
    head = ("cases", "preset", "precision", "recall")
    return Table("Edges of the topological graph", head, tuple(cells), note)


def _calibration(rows: Sequence[CaseResult]) -> Table:
    cells = []
    for _, preset, members in grouped(rows, lambda row: ""):
        accepted = [
            (r.confidence[k], bool(r.right[k])) for r, k in _pairs(members) if r.accepted[k]
        ]
        forecast, right = [c for c, _ in accepted], [r for _, r in accepted]
        if accepted:
            brier = f"{brier_score(forecast, right):.3f} (N = {len(accepted)})"
            cells.append((preset, "all accepted", f"{np.mean(forecast):.2f}", _of(right), brier))
        for b in reliability(forecast, right):
            span = f"{b.low:.1f}–{b.high:.1f}"
            hits = share(round(b.right * b.count), b.count)
            cells.append((preset, span, f"{b.confidence:.2f}", hits, ""))
    head = ("preset", "confidence", "mean confidence", "right", "Brier score")
    note = "Of accepted alignments: a calibrated confidence is right as often as it says."
    return Table("Calibration of the confidence", head, tuple(cells), note)


def _wire(rows: Sequence[CaseResult]) -> Table:
    cells = []
    for _, preset, members in grouped(rows, lambda row: ""):
        seen = [row for row in members if row.rooms_walked]
        sizes, points = column(seen, "message_bytes"), column(seen, "points")
        if sizes:
            shares = [100 * s / (RAW_POINT_BYTES * p) for s, p in zip(sizes, points, strict=True)]
            kilobytes = median([s / 1000 for s in sizes], 0, "kB")
            cells.append((preset, kilobytes, median(shares, 1, "%")))
    note = (
        "One map as topometric_msgs/TopometricMap; the raw cloud has 12 bytes a point. N are maps."
    )
    head = ("preset", "message", "of the raw cloud")
    return Table("Bytes on the wire", head, tuple(cells), note)


def _seconds(rows: Sequence[CaseResult], seconds: Mapping[str, Seconds]) -> Table:
    cells = []
    for group, preset, members in grouped(rows, lambda row: row.group):
        spent = [seconds[row.key] for row in members if row.key in seconds]
        extraction = [s.extraction for s in spent]
        cells.append(
            (
                *(group, preset, median(extraction, 1, "s")),
                median([s.merging for s in spent], 1, "s"),
            )
        )
    head = ("cases", "preset", "extraction of all agents", "merging")
    note = "CPU seconds a case. Maps that another case has made already cost no extraction."
    return Table("CPU seconds", head, tuple(cells), note)


def _pairs(rows: Iterable[CaseResult]) -> Iterable[tuple[CaseResult, int]]:
    return ((row, k) for row in rows for k in range(len(row.overlap)))


def _of(values: Sequence[bool]) -> str:
    return share(sum(values), len(values))
