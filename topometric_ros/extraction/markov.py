"""Markov clustering of a weighted graph (van Dongen 2000) and Newman's modularity of the result.

A random walker stays inside a cluster for long. Expansion lets the flow spread by a step, inflation
favours what is strong already, and small flows are dropped; in the end each node flows to the
attractors of its cluster. The flow is kept as sparse columns, so a round costs what flows there
are. A test compares the clusters with those of the `markov_clustering` package.
"""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

_ROUNDS = 100
"""Rounds of expanding and inflating, at most."""
_SMALLEST_FLOW = 1e-3
"""Smaller parts of a node's flow are dropped, but for its largest."""
_RELATIVE, _ABSOLUTE = 1e-5, 1e-8
"""Change of a flow from round to round below which it has settled."""


def markov_clusters(similarity: NDArray[np.float64], inflation: float) -> NDArray[np.int32]:
    """Return the Markov clusters of a weighted graph at one inflation.

    A node whose flow ends in several clusters belongs to the one with the lowest first nodes, one
    without any is a cluster of its own.

    Parameters
    ----------
    similarity : (K, K) float64, symmetric, 0 where there is no edge; loops count 1, J(A, A)
    inflation : > 1; larger gives more clusters

    Returns
    -------
    (K,) int32, clusters numbered in the order of their first nodes
    """
    count = len(similarity)
    flow = np.array(similarity, np.float64)
    np.fill_diagonal(flow, 1.0)
    flow /= flow.sum(axis=0)
    # Row c of the transpose is column c of the flow: what leaves node c.
    ends, nodes, shares = _sparse_rows(np.ascontiguousarray(flow.T))
    ends, nodes, shares = _settled(ends, nodes, shares, float(inflation))
    of_row = np.repeat(np.arange(count), np.diff(ends))
    members: dict[int, list[int]] = {int(a): [] for a in nodes[(nodes == of_row) & (shares > 0)]}
    for node, attractor in zip(of_row.tolist(), nodes.tolist(), strict=True):
        if attractor in members:
            members[attractor].append(node)
    owner = np.arange(count, 2 * count)
    for number, cluster in reversed(list(enumerate(sorted(members.values())))):
        owner[cluster] = number
    return in_order_of_first(owner)


def in_order_of_first(labels: NDArray[np.integer]) -> NDArray[np.int32]:
    """Return labels (K,) renumbered from 0 in the order in which they first occur."""
    _, first, label = np.unique(labels, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first), dtype=np.int32)
    return rank[label.reshape(-1)]


def modularity(similarity: NDArray[np.float64], labels: NDArray[np.integer]) -> float:
    """Return how much of a graph's weight lies within clusters beyond what chance puts there.

    Parameters
    ----------
    similarity : (K, K) float64, symmetric weights without loops, not all 0
    labels : (K,) the cluster of each node, from 0

    Returns
    -------
    Newman's weighted modularity (2004, eq. 7), at most 1
    """
    strength = similarity.sum(axis=1)
    total = strength.sum()
    inside = (similarity * (labels[:, None] == labels[None])).sum()
    of_cluster = np.bincount(labels, weights=strength)
    return float(inside / total - ((of_cluster / total) ** 2).sum())


@njit(cache=True, nogil=True)
def _sparse_rows(matrix):  # type: ignore[no-untyped-def]
    """Where each row of a dense matrix ends among its non-zero entries, their columns, values."""
    count = np.count_nonzero(matrix)
    ends = np.zeros(len(matrix) + 1, np.int64)
    columns, values = np.empty(count, np.int64), np.empty(count)
    entry = 0
    for row in range(len(matrix)):
        for column in range(matrix.shape[1]):
            if matrix[row, column] != 0.0:
                columns[entry], values[entry] = column, matrix[row, column]
                entry += 1
        ends[row + 1] = entry
    return ends, columns, values


@njit(cache=True, nogil=True)
def _settled(ends, nodes, shares, inflation):  # type: ignore[no-untyped-def]
    """Expand, inflate and prune until the flow no longer changes; it is stored as it came."""
    for _ in range(_ROUNDS):
        more_ends, more_nodes, more_shares, change = _round(ends, nodes, shares, inflation)
        ends, nodes, shares = more_ends, more_nodes, more_shares
        if change <= _ABSOLUTE:
            break
    return ends, nodes, shares


@njit(cache=True, nogil=True)
def _round(ends, nodes, shares, inflation):  # type: ignore[no-untyped-def]
    """One round; also the largest change of a flow beyond the relative tolerance."""
    count = len(ends) - 1
    new_ends = np.zeros(count + 1, np.int64)
    new_nodes, new_shares = np.empty(len(nodes), np.int64), np.empty(len(nodes))
    flow = np.zeros(count)
    entry, change = 0, 0.0
    for source in range(count):
        for e in range(ends[source], ends[source + 1]):
            share = shares[e]
            for f in range(ends[nodes[e]], ends[nodes[e] + 1]):
                flow[nodes[f]] += share * shares[f]
        strongest = _inflated(flow, inflation)
        while entry + count > len(new_nodes):
            new_nodes = np.append(new_nodes, np.empty(len(new_nodes), np.int64))
            new_shares = np.append(new_shares, np.empty(len(new_shares)))
        before = ends[source]
        for node in range(count):
            share = flow[node] if flow[node] >= _SMALLEST_FLOW or node == strongest else 0.0
            flow[node] = 0.0
            old = 0.0
            if before < ends[source + 1] and nodes[before] == node:
                old = shares[before]
                before += 1
            change = max(change, abs(share - old) - _RELATIVE * old)
            if share > 0.0:
                new_nodes[entry], new_shares[entry] = node, share
                entry += 1
        new_ends[source + 1] = entry
    return new_ends, new_nodes[:entry].copy(), new_shares[:entry].copy(), change


@njit(cache=True, nogil=True)
def _inflated(flow, inflation):  # type: ignore[no-untyped-def]
    """Raise a node's outflow to a power, in place, with sum 1 again; where most of it goes."""
    total, strongest = 0.0, 0
    for node in range(len(flow)):
        if flow[node] > 0.0:
            flow[node] = flow[node] ** inflation
            total += flow[node]
            if flow[node] > flow[strongest]:
                strongest = node
    for node in range(len(flow)):
        flow[node] /= total
    return strongest
