"""How many matches of rooms are right (thesis §5.3).

A match is right when the true counterparts of both rooms, by the assignment of §5.2, are the same
true room. Where a map splits a room only one piece has a counterpart, so the *overlap form* stands
beside it: both rooms share with one true room at least half of the smaller of the two.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.evaluation.metrics_rooms import RoomOverlap, counterparts

Pair = tuple[int, int]


@dataclass(frozen=True)
class MatchCounts:
    """Matches made and right, and how many right ones there are among all `pairs` of rooms."""

    made: int = 0
    right: int = 0
    possible: int = 0
    pairs: int = 0

    def __add__(self, other: MatchCounts) -> MatchCounts:
        """Return the counts of both together."""
        return MatchCounts(
            self.made + other.made,
            self.right + other.right,
            self.possible + other.possible,
            self.pairs + other.pairs,
        )

    @property
    def precision(self) -> float:
        """Share of the matches made that are right; NaN without matches."""
        return _share(self.right, self.made)

    @property
    def recall(self) -> float:
        """Share of the right matches that were made; NaN where there are none."""
        return _share(self.right, self.possible)

    @property
    def accuracy(self) -> float:
        """Share of all pairs of rooms that are rightly matched or rightly not matched."""
        wrong = (self.made - self.right) + (self.possible - self.right)
        return _share(self.pairs - wrong, self.pairs)

    @property
    def f1(self) -> float:
        """Harmonic mean of precision and recall."""
        return _share(2 * self.right, self.made + self.possible)


def match_counts(
    matches: Iterable[Pair], right_pairs: set[Pair], rooms_a: int, rooms_b: int
) -> MatchCounts:
    """Count matches; `right_pairs` are all that there are, of `rooms_a` times `rooms_b`.

    Examples
    --------
    >>> match_counts([(0, 0), (1, 2)], {(0, 0), (1, 1)}, 3, 3).accuracy
    0.7777777777777778
    """
    made = set(matches)
    return MatchCounts(len(made), len(made & right_pairs), len(right_pairs), rooms_a * rooms_b)


def one_to_one(matches: Iterable[Pair]) -> list[Pair]:
    """Return the matches of which neither room was in an earlier one: no further pieces of a room.

    Examples
    --------
    >>> one_to_one([(0, 0), (1, 1), (2, 1)])
    [(0, 0), (1, 1)]
    """
    of_a: set[int] = set()
    of_b: set[int] = set()
    kept = []
    for i, j in matches:
        if i not in of_a and j not in of_b:
            kept.append((i, j))
        of_a.add(i)
        of_b.add(j)
    return kept


def right_by_counterpart(a: RoomOverlap, b: RoomOverlap) -> set[Pair]:
    """Return all pairs of found rooms with the same counterpart (thesis §5.3)."""
    of_true = {true: found for found, true in counterparts(b).items()}
    return {(found, of_true[true]) for found, true in counterparts(a).items() if true in of_true}


def right_by_overlap(a: RoomOverlap, b: RoomOverlap) -> set[Pair]:
    """Return all pairs of found rooms that share half of the smaller with one true room."""
    of_a, of_b = _rooms_of_true(a), _rooms_of_true(b)
    return {(i, j) for true in of_a.keys() & of_b.keys() for i in of_a[true] for j in of_b[true]}


def _rooms_of_true(overlap: RoomOverlap) -> dict[int, list[int]]:
    """Return for each true room the found rooms that share half of the smaller of both with it."""
    smaller: NDArray[np.int64] = np.minimum(
        overlap.true_sizes[:, None], overlap.found_sizes[None, :]
    )
    same = (overlap.both > 0) & (2 * overlap.both >= smaller)
    return {
        true: [overlap.found_ids[j] for j in np.flatnonzero(same[i])]
        for i, true in enumerate(overlap.true_ids)
    }


def _share(part: int, whole: int) -> float:
    return part / whole if whole else float("nan")
