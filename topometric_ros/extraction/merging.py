"""Merging the pieces that are one room, and the stretches that are one corridor."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
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
        self.parent[self.parent == gone] = keep
        for counts in (self.pairs, self.seen):
            within = counts[keep, keep] + counts[gone, gone] + counts[keep, gone]
            counts[keep] += counts[gone]
            counts[:, keep] = counts[keep]
            counts[keep, keep] = within
        self.peak[keep] = max(self.peak[keep], self.peak[gone])
        a, b = np.where(self.a == gone, keep, self.a), np.where(self.b == gone, keep, self.b)
        a, b = np.minimum(a, b), np.maximum(a, b)
        # Of two borders that became one, the wider saddle is the one that counts.
        order = np.lexsort((-self.saddle, b, a))
        first = np.ones(len(order), bool)
        first[1:] = (np.diff(a[order]) != 0) | (np.diff(b[order]) != 0)
        rows = order[first & (a[order] != b[order])]
        self.a, self.b = a[rows], b[rows]
        self.saddle, self.corner, self.line = self.saddle[rows], self.corner[rows], self.line[rows]

    def visibility(self) -> NDArray[np.float64]:
        """Return how much each pair sees of the other, relative to how much it sees of itself."""
        own = _ratio(np.diagonal(self.seen), np.diagonal(self.pairs), 1.0)
        across = _ratio(self.seen[self.a, self.b], self.pairs[self.a, self.b], 0.5)
        return across / np.maximum(0.2, np.minimum(own[self.a], own[self.b]))


def _ratio(
    part: NDArray[np.int64], whole: NDArray[np.int64], otherwise: float
) -> NDArray[np.float64]:
    return np.where(whole > 0, part / np.maximum(whole, 1), otherwise)


def merge_pieces(
    pieces: NDArray[np.int32],
    distance: NDArray[np.float64],
    features: PairFeatures,
    config: MergingConfig,
) -> NDArray[np.int32]:
    """Return the regions, numbered like the lowest of their pieces: (nx, ny) int32, 0 none.

    The best pair merges first, ties by the lowest numbers, and the features are taken anew.
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
    while len(state.a):
        score = (
            config.visibility * state.visibility()
            + config.saddle * state.saddle / np.minimum(state.peak[state.a], state.peak[state.b])
            - config.line * state.line
            - config.corner * state.corner
            - config.threshold
        )
        best = int(np.argmax(score))
        if score[best] <= 0:
            break
        state.merge(int(state.a[best]), int(state.b[best]))
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
