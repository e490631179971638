"""Ways over a raster: from one cell to several goals, as a tree that forks where ways part."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.csgraph import dijkstra

Cell = NDArray[np.int64]
"""(row, column) of a raster: (2,) int64."""


@dataclass(frozen=True)
class Ways:
    """Ways from one cell: `chains` of cells, each from one fork or end to the next by its bends.

    `reached` says of every goal whether a way leads there.
    """

    chains: list[list[Cell]]
    reached: list[bool]


def find_ways(cost: NDArray[np.float64], start: Cell | None, goals: Sequence[Cell | None]) -> Ways:
    """Return the cheapest ways from one cell to others, forked where they part.

    Parameters
    ----------
    cost : (rows, columns) float64, of crossing each cell; inf: not to be crossed
    start, goals : cells; None or outside: not reached
    """
    source, *targets = (_index(cell, cost.shape) for cell in (start, *goals))
    if source is None:
        return Ways([], [False] * len(goals))
    distance, before = dijkstra(
        _steps(cost), directed=False, indices=source, return_predecessors=True
    )
    reached = [t is not None and bool(np.isfinite(distance[t])) for t in targets]
    found = [t for t, ok in zip(targets, reached, strict=True) if ok and t is not None]
    chains = []
    for chain in _chains(before, source, found):
        cells = np.stack(np.unravel_index(chain, cost.shape), axis=1)
        chains.append(_bends(cells, cost))
    return Ways(chains, reached)


def _index(cell: Cell | None, shape: tuple[int, ...]) -> int | None:
    if cell is None or (cell < 0).any() or (cell >= shape).any():
        return None
    return int(np.ravel_multi_index(tuple(cell), shape))


def _chains(before: NDArray[np.int32], source: int, targets: list[int]) -> list[list[int]]:
    """Cut the tree of ways from one cell at its forks and ends; `before` leads to the source."""
    after: dict[int, list[int]] = {source: []}
    for target in targets:
        cell, child = target, -1
        while cell not in after:
            after[cell] = [] if child < 0 else [child]
            cell, child = int(before[cell]), cell
        if child >= 0:
            after[cell].append(child)
    ends = {source, *targets} | {cell for cell, children in after.items() if len(children) > 1}
    chains = []
    for end in sorted(ends):
        for child in after[end]:
            chain = [end, child]
            while chain[-1] not in ends:
                chain.append(after[chain[-1]][0])
            chains.append(chain)
    return chains


def _steps(cost: NDArray[np.float64]) -> sparse.csr_array:
    """Return the costs of stepping between 8-neighbours as a sparse graph of the cells."""
    index = np.arange(cost.size).reshape(cost.shape)
    rows, columns, weights = [], [], []
    for here, there, length in (
        (np.s_[:-1, :], np.s_[1:, :], 1.0),
        (np.s_[:, :-1], np.s_[:, 1:], 1.0),
        (np.s_[:-1, :-1], np.s_[1:, 1:], np.sqrt(2.0)),
        (np.s_[:-1, 1:], np.s_[1:, :-1], np.sqrt(2.0)),
    ):
        weight = (cost[here] + cost[there]) * (length / 2.0)
        open_step = np.isfinite(weight)
        rows.append(index[here][open_step])
        columns.append(index[there][open_step])
        weights.append(weight[open_step])
    entries = (np.concatenate(weights), (np.concatenate(rows), np.concatenate(columns)))
    return sparse.csr_array(entries, shape=(cost.size, cost.size))


def _bends(cells: NDArray[np.int64], cost: NDArray[np.float64]) -> list[NDArray[np.int64]]:
    """Return the fewest cells of a way whose straight lines are hardly dearer than the way."""
    kept = [0]
    while kept[-1] < len(cells) - 1:
        start = kept[-1]
        end = start + 1
        for candidate in range(len(cells) - 1, start, -1):
            if _clear(cells[start], cells[candidate], cells[start : candidate + 1], cost):
                end = candidate
                break
        kept.append(end)
    return [cells[k] for k in kept]


def _clear(
    a: NDArray[np.int64],
    b: NDArray[np.int64],
    way: NDArray[np.int64],
    cost: NDArray[np.float64],
) -> bool:
    """Return whether the line between two cells meets nothing dearer than the way does."""
    number = 2 * int(np.abs(b - a).max()) + 1
    line = np.rint(a + (b - a) * np.linspace(0.0, 1.0, number)[:, None]).astype(np.int64)
    dearest = cost[way[:, 0], way[:, 1]].max()
    return bool(cost[line[:, 0], line[:, 1]].max() <= max(dearest, 1.5))
