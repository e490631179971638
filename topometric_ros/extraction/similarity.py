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
from topometric_ros.extraction.markov import markov_clusters, modularity
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
    if not similarity.any():
        return np.arange(len(similarity), dtype=np.int32)
    inflations = np.linspace(config.inflation_low, config.inflation_high, config.inflation_samples)
    scored: dict[bytes, float] = {}
    best, best_score = np.zeros(len(similarity), np.int32), -np.inf
    for inflation in inflations.tolist():
        labels = markov_clusters(similarity, inflation)
        if labels.tobytes() in scored:
            continue
        score = modularity(similarity, labels)
        scored[labels.tobytes()] = score
        found = labels.max() + 1
        logger.debug("inflation %.2f: %d clusters, modularity %.4f", inflation, found, score)
        if score > best_score:
            best, best_score = labels, score
    return best
