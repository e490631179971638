"""Clusters of similar visibilities (thesis §4.2.8, eq. 31-34): a room is where views are alike.

The Jaccard indices of all pairs are the weights of a graph, which Markov clustering takes apart.
Its inflation, which sets how finely, is the one whose clusters have the largest modularity on that
same graph.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.extraction.visibility import Visibilities, jaccard

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class SimilarityConfig:
    """How views are clustered; the defaults are the thesis' values."""

    cut: float = parameter(
        0.0, "Pairs of views with a smaller Jaccard index are not joined.", minimum=0.0, maximum=1.0
    )
    inflation_low: float = parameter(
        1.2, "Smallest inflation that is tried.", minimum=1.01, maximum=10.0
    )
    inflation_high: float = parameter(
        2.5, "Largest inflation that is tried.", minimum=1.01, maximum=10.0
    )
    inflation_samples: int = parameter(
        14, "How many inflations are tried, evenly spaced.", minimum=1, maximum=100
    )


def cluster_visibilities(sets: Visibilities, config: SimilarityConfig) -> NDArray[np.int32]:
    """Return the cluster of every visibility (eq. 34).

    Returns
    -------
    (K,) int32, clusters numbered in the order of their first views
    """
    similarity = jaccard(sets)
    np.fill_diagonal(similarity, 0.0)
    similarity[similarity < config.cut] = 0.0
    return cluster_graph(similarity, config)


def cluster_graph(similarity: NDArray[np.float64], config: SimilarityConfig) -> NDArray[np.int32]:
    """Return the clusters of a weighted graph with the largest modularity over the inflations.

    Parameters
    ----------
    similarity : (K, K) float64, symmetric weights, 0 on the diagonal and where there is no edge
    config : inflations that are tried; of equal modularities the smallest inflation wins

    Returns
    -------
    (K,) int32, clusters numbered in the order of their first nodes
    """
    import networkx

    if not similarity.any():
        return np.arange(len(similarity), dtype=np.int32)
    graph = networkx.from_numpy_array(similarity)
    inflations = np.linspace(config.inflation_low, config.inflation_high, config.inflation_samples)
    scored: dict[bytes, float] = {}
    best, best_score = np.zeros(len(similarity), np.int32), -np.inf
    for inflation in inflations.tolist():
        labels = markov_clusters(similarity, inflation)
        if labels.tobytes() in scored:
            continue
        groups = [np.flatnonzero(labels == c).tolist() for c in range(labels.max() + 1)]
        score = networkx.community.modularity(graph, groups, weight="weight")
        scored[labels.tobytes()] = score
        logger.debug("inflation %.2f: %d clusters, modularity %.4f", inflation, len(groups), score)
        if score > best_score:
            best, best_score = labels, score
    return best


def markov_clusters(similarity: NDArray[np.float64], inflation: float) -> NDArray[np.int32]:
    """Return the Markov clusters (van Dongen 2000) of a weighted graph at one inflation.

    A node that the package puts into several clusters stays in the first, one that it puts
    into none becomes its own.

    Parameters
    ----------
    similarity : (K, K) float64; the package adds the loops of weight 1 = J(A, A)
    inflation : > 1; larger gives more clusters

    Returns
    -------
    (K,) int32, clusters numbered in the order of their first nodes
    """
    import markov_clustering
    from scipy.sparse import csr_matrix

    # The package takes no other sparse format, and no sparse array.
    flow = markov_clustering.run_mcl(csr_matrix(similarity), inflation=inflation)
    owner = np.full(len(similarity), -1, np.int64)
    for number, members in enumerate(markov_clustering.get_clusters(flow)):
        nodes = np.asarray(members)
        owner[nodes[owner[nodes] < 0]] = number
    alone = owner < 0
    owner[alone] = len(similarity) + np.flatnonzero(alone)
    _, first, cluster = np.unique(owner, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.int32)
    rank[np.argsort(first)] = np.arange(len(first), dtype=np.int32)
    return rank[cluster.reshape(-1)]
