"""How well a map's rooms and topological graph agree with the truth.

Everything is counted in voxels of one agent's map: each has the room that was found and the true
room of the nearest labelled point. The mean intersection over union comes in three named forms:

- `paper` (thesis §5.2): Jaccard index of every (true, found) pair, assignment, mean over the
  assigned pairs. Rooms left over cost nothing in it, so their number stands beside it.
- `whole`: the same with every true room as large as all agents of the case together saw it, so
  that what an agent did not see counts against its map.
- `walked` (as `check/score.py` counts): the sum over the assigned pairs divided by the number of
  rooms that the agent walked through; voxels without a true room are left out.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from topometric_ros.voxels.labels import joint_counts

SMALLEST_TRUE_ROOM = 50
"""A room walked through counts from this many voxels on, as in `check/score.py`."""

Edge = tuple[int, int]


@dataclass(frozen=True)
class RoomOverlap:
    """Voxels shared by true and found rooms.

    `both` (T, F) int64; `true_sizes` (T,) are all voxels of a true room, `found_sizes` (F,) all of
    a found room and `found_labelled` (F,) those of them that have a true room.
    """

    true_ids: tuple[int, ...]
    found_ids: tuple[int, ...]
    both: NDArray[np.int64]
    true_sizes: NDArray[np.int64]
    found_sizes: NDArray[np.int64]
    found_labelled: NDArray[np.int64]


@dataclass(frozen=True)
class RoomScores:
    """One map against the truth; NaN where there is nothing to score."""

    miou_paper: float
    left_over: int
    """Found rooms that no true room was assigned to."""
    miou_whole: float
    miou_walked: float
    precision: float
    recall: float
    walked: int
    found: int


@dataclass(frozen=True)
class EdgeCounts:
    """Passages against true links.

    `right` of `found` passages join rooms that are joined in truth; `covered` of the `true` links
    between rooms that the map holds have a passage.
    """

    found: int
    right: int
    true: int
    covered: int


def room_overlap(true: NDArray[np.integer], found: NDArray[np.integer]) -> RoomOverlap:
    """Count the voxels that true and found rooms share.

    Parameters
    ----------
    true, found : (N,) int, room of each voxel, negative: none
    """
    true_ids, found_ids = np.unique(true[true >= 0]), np.unique(found[found >= 0])
    counts = joint_counts(true, found, true_ids, found_ids)
    both = counts[:-1, :-1]
    return RoomOverlap(
        true_ids=tuple(true_ids.tolist()),
        found_ids=tuple(found_ids.tolist()),
        both=both,
        true_sizes=counts[:-1].sum(axis=1),
        found_sizes=counts[:, :-1].sum(axis=0),
        found_labelled=both.sum(axis=0),
    )


def jaccard(
    overlap: RoomOverlap, true_sizes: NDArray[np.int64] | None = None
) -> NDArray[np.float64]:
    """Return the Jaccard index of every true and found room: (T, F) float64 (thesis eq. 31).

    `true_sizes` (T,), where given, replace the sizes of the true rooms.
    """
    sizes = overlap.true_sizes if true_sizes is None else true_sizes
    union = sizes[:, None] + overlap.found_sizes[None, :] - overlap.both
    return overlap.both / np.maximum(union, 1)


def assigned(similarity: NDArray[np.float64]) -> list[tuple[int, int]]:
    """Return the one-to-one (row, column) pairs of largest total; those of nothing are no pairs.

    Examples
    --------
    >>> assigned(np.array([[0.9, 0.8], [0.8, 0.0]]))
    [(0, 1), (1, 0)]
    """
    rows, columns = linear_sum_assignment(-similarity)
    return [(int(i), int(j)) for i, j in zip(rows, columns, strict=True) if similarity[i, j] > 0]


def counterparts(overlap: RoomOverlap) -> dict[int, int]:
    """Return the true room of each found room by assignment of Jaccard indices (thesis §5.2)."""
    pairs = assigned(jaccard(overlap))
    return {overlap.found_ids[j]: overlap.true_ids[i] for i, j in pairs}


def room_scores(
    overlap: RoomOverlap,
    walked: Sequence[int],
    whole_sizes: Mapping[int, int] | None = None,
) -> RoomScores:
    """Score a map's rooms in all three forms.

    Parameters
    ----------
    overlap : of the map's voxels
    walked : true rooms that the agent walked through
    whole_sizes : voxels of each true room as all agents together saw it; for the form `whole`
    """
    similarity = jaccard(overlap)
    pairs = assigned(similarity)
    sizes = dict(zip(overlap.true_ids, overlap.true_sizes.tolist(), strict=True))
    rows = [overlap.true_ids.index(k) for k in walked if sizes.get(k, 0) >= SMALLEST_TRUE_ROOM]
    whole = np.array(
        [max(sizes[k], (whole_sizes or {}).get(k, 0)) for k in overlap.true_ids], np.int64
    )
    precision, recall = precision_and_recall(overlap, rows)
    return RoomScores(
        miou_paper=_mean([similarity[pair] for pair in pairs]),
        left_over=len(overlap.found_ids) - len(pairs),
        miou_whole=_mean_assigned(jaccard(overlap, whole)) if whole_sizes else float("nan"),
        miou_walked=_miou_walked(overlap, rows),
        precision=precision,
        recall=recall,
        walked=len(rows),
        found=len(overlap.found_ids),
    )


def precision_and_recall(overlap: RoomOverlap, rows: Sequence[int]) -> tuple[float, float]:
    """Return precision and recall of rooms (Bormann et al. 2016).

    Precision is the largest share of a found room that lies in one true room, recall the largest
    share of a true room that lies in one found room, each the mean over rooms. A map cut into
    crumbs has precision 1, one without walls recall 1.

    Parameters
    ----------
    rows : the true rooms (rows of `overlap.both`) that recall is taken over
    """
    covered = overlap.both.max(axis=0, initial=0) / overlap.found_sizes
    held = overlap.both[rows].max(axis=1, initial=0) / overlap.true_sizes[rows]
    return _mean(covered.tolist()), _mean(held.tolist())


def edge_counts(
    overlap: RoomOverlap, passages: Iterable[Edge], links: Iterable[Edge]
) -> EdgeCounts:
    """Compare the edges of a map's topological graph with the true ones.

    A found room stands for the true room that most of it lies in. A passage between two pieces of
    one true room is wrong. True links count where the map holds both rooms.

    Parameters
    ----------
    passages : pairs of found rooms, each pair once
    links : pairs of true rooms
    """
    standing: dict[int, int] = {}
    for j, found in enumerate(overlap.found_ids):
        if overlap.found_labelled[j]:
            standing[found] = overlap.true_ids[int(overlap.both[:, j].argmax())]
    held = set(standing.values())
    true = {_sorted(e) for e in links if e[0] != e[1] and set(e) <= held}
    found_edges = {_sorted(edge) for edge in passages}
    mapped = [
        _sorted((standing[i], standing[j])) if i in standing and j in standing else None
        for i, j in sorted(found_edges)
    ]
    right = [edge for edge in mapped if edge in true]
    return EdgeCounts(len(found_edges), len(right), len(true), len(set(right)))


def _miou_walked(overlap: RoomOverlap, rows: Sequence[int]) -> float:
    """Sum over the assigned pairs by the rooms walked through, as `check/score.py` counts it."""
    if not rows:
        return float("nan")
    both = overlap.both[rows]
    union = overlap.true_sizes[rows][:, None] + overlap.found_labelled[None, :] - both
    similarity = both / np.maximum(union, 1)
    return float(sum(similarity[pair] for pair in assigned(similarity)) / len(rows))


def _mean_assigned(similarity: NDArray[np.float64]) -> float:
    return _mean([similarity[pair] for pair in assigned(similarity)])


def _mean(values: Sequence[float]) -> float:
    return float(np.mean(values)) if values else float("nan")


def _sorted(edge: Edge) -> Edge:
    return (edge[0], edge[1]) if edge[0] < edge[1] else (edge[1], edge[0])
