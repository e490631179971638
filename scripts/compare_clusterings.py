#!/usr/bin/env python3
"""Compare ways to cluster visibilities: the thesis' MCL and hierarchical clustering.

    compare_clusterings.py FOLDER...

FOLDER is a case as `topometric simulate` writes it. Agent a's map is extracted with preset
`thesis` but for the clustering; the number is the mean IoU over the rooms walked through
(docs/evaluation.md). Hierarchical clustering joins the two clusters whose views are most alike on
average (one less the Jaccard index), up to a distance or to the cut with the largest modularity.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path

import networkx as nx
import numpy as np
from numpy.typing import NDArray
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial import cKDTree
from scipy.spatial.distance import squareform

from topometric_ros.evaluation.metrics_rooms import room_overlap, room_scores
from topometric_ros.extraction import thesis_rooms
from topometric_ros.extraction.config import ExtractionConfig, extraction_preset
from topometric_ros.extraction.pipeline import extract
from topometric_ros.extraction.similarity import SimilarityConfig, cluster_graph
from topometric_ros.extraction.visibility import Visibilities, jaccard
from topometric_ros.simulation.case import SimulatedAgent
from topometric_ros.simulation.case_files import read_case

DISTANCES = (0.7, 0.8, 0.85, 0.9)

Clustering = Callable[[NDArray[np.float64]], NDArray[np.int32]]


def by_mcl(similarity: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the thesis' clusters of views with these Jaccard indices (K, K)."""
    weights = similarity.copy()
    np.fill_diagonal(weights, 0.0)
    return cluster_graph(weights, SimilarityConfig())


def tree(similarity: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the hierarchy of clusters, by average linkage."""
    links: NDArray[np.float64] = linkage(squareform(1.0 - similarity, checks=False), "average")
    return links


def at_distance(distance: float) -> Clustering:
    """Return the clustering that cuts the hierarchy at a distance."""
    return lambda similarity: fcluster(tree(similarity), distance, "distance").astype(np.int32) - 1


def by_modularity(similarity: NDArray[np.float64]) -> NDArray[np.int32]:
    """Return the cut of the hierarchy with the largest modularity."""
    weights = similarity.copy()
    np.fill_diagonal(weights, 0.0)
    graph = nx.from_numpy_array(weights)
    links, best, score = tree(similarity), np.zeros(len(similarity), np.int32), -1.0
    for count in range(2, len(similarity) // 2 + 1):
        labels = fcluster(links, count, "maxclust").astype(np.int32) - 1
        parts = [set(np.flatnonzero(labels == k).tolist()) for k in np.unique(labels)]
        modularity = nx.community.modularity(graph, parts)
        if modularity > score:
            best, score = labels, modularity
    return best


def score(agent: SimulatedAgent, config: ExtractionConfig, clustering: Clustering) -> float:
    """Return the mean IoU over the rooms that an agent walked through."""
    original = thesis_rooms.cluster_visibilities

    def clustered(sets: Visibilities, config: SimilarityConfig) -> NDArray[np.int32]:
        return clustering(jaccard(sets))

    thesis_rooms.cluster_visibilities = clustered
    try:
        m = extract(agent.points, config).map
    finally:
        thesis_rooms.cluster_visibilities = original
    centres = (m.centres() - m.T_level_input[:3, 3]) @ m.T_level_input[:3, :3]
    away, nearest = cKDTree(agent.points).query(centres)
    true = np.where(away <= 2 * m.voxel_size, agent.room[nearest], -1)
    return room_scores(room_overlap(true, m.room), agent.rooms_walked).miou_walked


def main() -> int:
    """Print a row for every case and the means."""
    config = extraction_preset("thesis")
    ways: dict[str, Clustering] = {"MCL": by_mcl, "modularity": by_modularity}
    ways |= {f"distance {distance}": at_distance(distance) for distance in DISTANCES}
    print("| case | " + " | ".join(ways) + " |\n|" + " --- |" * (len(ways) + 1))
    rows = []
    for folder in sys.argv[1:]:
        agent = read_case(Path(folder)).agents[0]
        rows.append([score(agent, config, way) for way in ways.values()])
        print(
            f"| {Path(folder).name} | " + " | ".join(f"{v:.2f}" for v in rows[-1]) + " |",
            flush=True,
        )
    print("| mean | " + " | ".join(f"{v:.2f}" for v in np.mean(rows, axis=0)) + " |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
