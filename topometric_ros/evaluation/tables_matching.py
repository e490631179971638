"""The tables of matched rooms: by stage, and how many of the final ones are right by overlap."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from topometric_ros.evaluation.case_result import CaseResult
from topometric_ros.evaluation.metrics_fusion import LITTLE_OVERLAP
from topometric_ros.evaluation.metrics_matching import MatchCounts
from topometric_ros.evaluation.rows import column, grouped
from topometric_ros.evaluation.table_cells import Table, mean, share

STAGES = {
    "assigned": "descriptors alone, assigned",
    "grown": "best grown hypothesis",
    "final": "accepted alignment",
}
BANDS = ((0.5, 1.01), (0.35, 0.5), (0.2, 0.35), (LITTLE_OVERLAP, 0.2))


def matching_table(rows: Sequence[CaseResult]) -> Table:
    """Return what each stage matched, a row for each group of cases, preset and stage."""
    cells = []
    for group, preset, members in grouped(rows, lambda row: row.group):
        known = [row for row in members if row.room_pairs]
        for stage, words in STAGES.items() if known else ():
            pairs = [(row, k) for row in known for k in range(len(row.room_pairs))]
            counts, loose = _totals(pairs, stage), _totals(pairs, stage, by_overlap=True)
            cells.append(
                (
                    *(group, preset, words),
                    share(counts.right, counts.made),
                    share(counts.right, counts.possible),
                    f"{100 * counts.accuracy:.2f} % (N = {counts.pairs})" if counts.pairs else "–",
                    f"{counts.f1:.2f}",
                    share(loose.right, loose.made),
                    mean(_precisions(known, stage)),
                )
            )
    head = (
        *("cases", "preset", "stage", "precision", "recall", "accuracy", "F1"),
        "precision by overlap",
        "mean precision of a pair of agents",
    )
    note = (
        "A match is right when both rooms have the same true counterpart (§5.3); by overlap: when "
        "both share half of the smaller with one true room. The last column is the mean over pairs "
        "of agents that share a tenth or more and have a match, as published figures are."
    )
    return Table("Matching", head, tuple(cells), note)


def matches_by_overlap(rows: Sequence[CaseResult]) -> Table:
    """Return the matches of alignments by the overlap that there is, a row for each band."""
    cells = []
    for _, preset, members in grouped(rows, lambda row: ""):
        known = [row for row in members if row.room_pairs]
        for low, high in BANDS:
            pairs = [(r, k) for r in known for k, o in enumerate(r.overlap) if low <= o < high]
            taken = [(row, k) for row, k in pairs if row.accepted[k]]
            if pairs:
                forms = [_totals(taken, "final", loose) for loose in (False, True)]
                whole = [_totals(pairs, "final", loose) for loose in (False, True)]
                cells.append(
                    (
                        *(preset, f"{low:g} to {min(high, 1):g}", f"{len(taken)} of {len(pairs)}"),
                        *(cell for counts in forms for cell in _words(counts)),
                        *(f"{counts.f1:.2f}" for counts in whole),
                    )
                )
    head = (
        *("preset", "overlap", "accepted", "precision (§5.3)", "recall", "F1"),
        *("precision by overlap", "recall", "F1"),
        *("F1 with refusals", "the same by overlap"),
    )
    note = (
        "Matches of accepted alignments. By §5.3 one room has one partner; by overlap all pieces "
        "of a room count, and so do all that share half of the smaller with one true room. The "
        "last two columns count the rooms of pairs that were not accepted as missed."
    )
    return Table("Matched rooms by overlap", head, tuple(cells), note)


def _words(counts: MatchCounts) -> tuple[str, str, str]:
    f1 = f"{counts.f1:.2f}" if counts.made + counts.possible else "–"
    return share(counts.right, counts.made), share(counts.right, counts.possible), f1


def _totals(
    pairs: Iterable[tuple[CaseResult, int]], stage: str, by_overlap: bool = False
) -> MatchCounts:
    """Return the counts of a stage's matches over pairs of agents."""
    end = "_overlap" if by_overlap else ""
    total = MatchCounts()
    for row, k in pairs:
        made, right = (getattr(row, stage + name)[k] for name in (end, f"_right{end}"))
        able = getattr(row, f"possible{end}")[k]
        total += MatchCounts(int(made), int(right), int(able), int(row.room_pairs[k]))
    return total


def _precisions(rows: Iterable[CaseResult], stage: str) -> list[float]:
    """Return the precision of every pair of agents that shares a tenth and has a match."""
    return [
        right / made
        for row in rows
        for made, right, overlap in zip(
            column([row], stage), column([row], f"{stage}_right"), row.overlap, strict=True
        )
        if made and overlap >= LITTLE_OVERLAP
    ]
