"""Merging the pieces that are one room, and the stretches that are one corridor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.configuration import parameter
from topometric_ros.extraction.pair_features import PairFeatures
from topometric_ros.extraction.storeys import RASTER


@dataclass(frozen=True)
class MergingConfig:
    """Weights of the features of two touching pieces; they merge where the sum is positive."""

    visibility: float = parameter(4.9, "Weight of mutual visibility.", minimum=0.0)
    saddle: float = parameter(4.7, "Weight of the opening's width over the rooms'.", minimum=0.0)
    line: float = parameter(2.0, "Weight against walls that go on beyond the opening.", minimum=0.0)
    corner: float = parameter(2.2, "Weight against free wall ends at the opening.", minimum=0.0)
    threshold: float = parameter(4.4, "What the weighted sum must exceed.")
    view_range: float = parameter(
        12.0, "Range within which floor points look at each other.", unit="m", minimum=2.0
    )
    sample_step: float = parameter(
        0.7, "Spacing of the floor points that look.", unit="m", minimum=0.2, maximum=3.0
    )
    corridors: bool = parameter(True, "Join stretches of one corridor.")
    corridor_width: float = parameter(
        1.25,
        "Largest typical width of a corridor (twice the mean distance).",
        unit="m",
        minimum=0.3,
    )


@dataclass
class _Regions:
    """The state of a merge: pairs as in PairFeatures, with pieces replaced by their regions."""

    parent: NDArray[np.int64]
    a: NDArray[np.int64]
    b: NDArray[np.int64]
    saddle: NDArray[np.float64]
    corner: NDArray[np.float64]
    line: NDArray[np.float64]
    peak: NDArray[np.float64]
    pairs: NDArray[np.int64]
    seen: NDArray[np.int64]

    def merge(self, keep: int, gone: int) -> None:
        """Join region `gone` to `keep` (the lower number)."""
        rows = (self.a, self.b, self.saddle, self.corner, self.line)
        self.sort(_absorb(keep, gone, self.parent, rows, len(self.a), *self.counts()))

    def counts(self) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.int64]]:
        """Return what is known of the regions themselves."""
        return self.peak, self.pairs, self.seen

    def sort(self, count: int) -> None:
        """Keep the first `count` pairs, in the order of their numbers."""
        order = np.lexsort((self.b[:count], self.a[:count]))
        self.a, self.b = self.a[order], self.b[order]
        self.saddle, self.corner, self.line = (
            self.saddle[order],
            self.corner[order],
            self.line[order],
        )


@njit(cache=True, nogil=True)
def _absorb(keep, gone, parent, rows, count, peak, pairs, seen):  # type: ignore[no-untyped-def]
    """Join a region to another, in place; return how many of the pairs (rows) are left.

    Of two borders that become one, the wider saddle is the one that counts.
    """
    a, b, saddle, corner, line = rows
    for piece in range(len(parent)):
        if parent[piece] == gone:
            parent[piece] = keep
    for numbers in (pairs, seen):
        within = numbers[keep, keep] + numbers[gone, gone] + numbers[keep, gone]
        numbers[keep] += numbers[gone]
        numbers[:, keep] = numbers[keep]
        numbers[keep, keep] = within
    peak[keep] = max(peak[keep], peak[gone])
    border = np.full(len(parent), -1, np.int64)
    for row in range(count):
        if a[row] == keep or b[row] == keep:
            border[a[row] + b[row] - keep] = row
    for row in range(count):
        if a[row] != gone and b[row] != gone:
            continue
        other = a[row] + b[row] - gone
        if other != keep and border[other] < 0:
            a[row], b[row] = min(keep, other), max(keep, other)
            continue
        into = border[other] if other != keep else -1
        if into >= 0 and saddle[row] > saddle[into]:
            saddle[into], corner[into], line[into] = saddle[row], corner[row], line[row]
        a[row] = -1
    left = 0
    for row in range(count):
        if a[row] >= 0:
            a[left], b[left] = a[row], b[row]
            saddle[left], corner[left], line[left] = saddle[row], corner[row], line[row]
            left += 1
    return left


@njit(cache=True, nogil=True)
def _merge_all(parent, rows, peak, pairs, seen, weights):  # type: ignore[no-untyped-def]
    """Merge the best pair until none is positive; return how many pairs are left.

    A pair's visibility is how much one sees of the other, relative to how much it sees of itself.
    """
    a, b, saddle, corner, line = rows
    count = len(a)
    while True:
        best, highest = -1, 0.0
        for row in range(count):
            x, y = a[row], b[row]
            across = seen[x, y] / pairs[x, y] if pairs[x, y] > 0 else 0.5
            own_x = seen[x, x] / pairs[x, x] if pairs[x, x] > 0 else 1.0
            own_y = seen[y, y] / pairs[y, y] if pairs[y, y] > 0 else 1.0
            score = (
                weights[0] * (across / max(0.2, min(own_x, own_y)))
                + weights[1] * saddle[row] / min(peak[x], peak[y])
                - weights[2] * line[row]
                - weights[3] * corner[row]
                - weights[4]
            )
            if score > highest or (best >= 0 and score == highest and (x, y) < (a[best], b[best])):
                best, highest = row, score
        if best < 0:
            return count
        count = _absorb(a[best], b[best], parent, rows, count, peak, pairs, seen)


def merge_pieces(
    pieces: NDArray[np.int32],
    distance: NDArray[np.float64],
    features: PairFeatures,
    config: MergingConfig,
) -> NDArray[np.int32]:
    """Return the regions, numbered like the lowest of their pieces: (nx, ny) int32, 0 none.

    The best pair merges first, ties by the lowest numbers, and the features are taken anew.
    `distance` (nx, ny) float64, cells, from the walls, tells how wide a corridor is.
    """
    state = _Regions(
        parent=np.arange(len(features.peak)),
        a=features.a.copy(),
        b=features.b.copy(),
        saddle=features.saddle.copy(),
        corner=features.corner.copy(),
        line=features.line.copy(),
        peak=features.peak.copy(),
        pairs=features.pairs.copy(),
        seen=features.seen.copy(),
    )
    rows = (state.a, state.b, state.saddle, state.corner, state.line)
    weights = np.array(
        [config.visibility, config.saddle, config.line, config.corner, config.threshold]
    )
    state.sort(_merge_all(state.parent, rows, *state.counts(), weights))
    if config.corridors:
        _join_corridors(state, pieces, distance * RASTER, config.corridor_width)
    regions = np.zeros(len(state.parent) + 1, np.int32)
    regions[1:] = state.parent + 1
    return regions[pieces]


def _join_corridors(
    state: _Regions, pieces: NDArray[np.int32], distance: NDArray[np.float64], widest: float
) -> None:
    """Merge narrow regions of like width, one of them long, that meet without a narrowing."""
    numbers = np.arange(1, len(state.parent) + 1)
    area = np.bincount(pieces.ravel(), minlength=len(numbers) + 1)[1:].astype(float)
    total = np.asarray(ndimage.sum_labels(distance, pieces, numbers), dtype=float)
    for piece, region in enumerate(state.parent):
        if region != piece:
            area[region] += area[piece]
            total[region] += total[piece]
    while len(state.a):
        width = 2 * total / np.maximum(area, 1)
        length = area * RASTER**2 / (4 * np.maximum(width, 1e-9) ** 2)
        pair_width = np.sort(np.stack([width[state.a], width[state.b]]), axis=0)
        pair_length = np.sort(np.stack([length[state.a], length[state.b]]), axis=0)
        joins = (
            (pair_width[1] <= widest)
            & (pair_length[1] >= 6)
            & (pair_length[0] >= 1.2)
            & (pair_width[1] <= 1.5 * pair_width[0])
            & (state.saddle * RASTER >= 0.85 * pair_width[0])
        )
        if not joins.any():
            return
        best = int(np.argmax(np.where(joins, state.saddle, -1.0)))
        keep, gone = int(state.a[best]), int(state.b[best])
        area[keep] += area[gone]
        total[keep] += total[gone]
        state.merge(keep, gone)
