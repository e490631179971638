"""Similar views are clustered by Markov clustering with the inflation of largest modularity."""

from __future__ import annotations

from dataclasses import replace

import markov_clustering
import networkx
import numpy as np
import pytest
from scipy.sparse import csr_matrix

from topometric_ros.extraction.markov import in_order_of_first, markov_clusters, modularity
from topometric_ros.extraction.similarity import SimilarityConfig, cluster_graph

CONFIG = SimilarityConfig()


def communities(seed: int, sizes: tuple[int, ...], between: float) -> np.ndarray:
    """Return weights of a graph of communities: strong inside, weak in between."""
    rng = np.random.default_rng(seed)
    owner = np.repeat(np.arange(len(sizes)), sizes)
    inside = owner[:, None] == owner[None]
    weights = np.where(inside, rng.uniform(0.5, 0.9, inside.shape), rng.uniform(0, between))
    weights = np.triu(weights, 1)
    return weights + weights.T


def test_communities_are_found_in_the_order_of_their_first_nodes() -> None:
    expected = np.repeat([0, 1, 2], [6, 9, 4]).tolist()
    assert cluster_graph(communities(1, (6, 9, 4), 0.1), CONFIG).tolist() == expected


def test_the_clusters_have_the_largest_modularity_of_all_inflations() -> None:
    weights = communities(2, (5, 7, 6, 8), 0.5)
    tried = [modularity(weights, markov_clusters(weights, i)) for i in np.linspace(1.2, 2.5, 14)]
    assert modularity(weights, cluster_graph(weights, CONFIG)) == pytest.approx(max(tried))


def views_along_corridors(seed: int, count: int) -> np.ndarray:
    """Return Jaccard-like weights of places that see less of each other the farther apart."""
    rng = np.random.default_rng(seed)
    places = rng.uniform(0.0, 12.0, (count, 2)) * (1.0, 0.3)
    distance = np.linalg.norm(places[:, None] - places[None], axis=2)
    weights = np.triu(
        np.maximum(0.0, 0.9 - 0.3 * distance) * rng.uniform(0.7, 1, distance.shape), 1
    )
    return weights + weights.T


GRAPHS = [
    communities(6, (8, 3, 12), 0.3),
    communities(7, (20, 20, 15, 5), 0.6),
    views_along_corridors(8, 40),
    views_along_corridors(9, 90),
]


@pytest.mark.parametrize("weights", GRAPHS)
@pytest.mark.parametrize("inflation", [1.2, 1.5, 2.0, 2.5])
def test_clusters_are_those_of_the_markov_clustering_package(
    weights: np.ndarray, inflation: float
) -> None:
    flow = markov_clustering.run_mcl(csr_matrix(weights), inflation=inflation)
    owner = np.full(len(weights), -1)
    for number, members in enumerate(markov_clustering.get_clusters(flow)):
        nodes = np.asarray(members)
        owner[nodes[owner[nodes] < 0]] = number
    owner[owner < 0] = len(weights) + np.flatnonzero(owner < 0)
    assert markov_clusters(weights, inflation).tolist() == in_order_of_first(owner).tolist()


@pytest.mark.parametrize("weights", GRAPHS)
def test_modularity_is_that_of_networkx(weights: np.ndarray) -> None:
    graph = networkx.from_numpy_array(weights)
    for labels in (markov_clusters(weights, 1.6), np.arange(len(weights)) % 3):
        groups = [np.flatnonzero(labels == c).tolist() for c in np.unique(labels)]
        expected = networkx.community.modularity(graph, groups, weight="weight")
        assert modularity(weights, labels) == pytest.approx(expected, abs=1e-12)


def test_a_larger_inflation_never_gives_fewer_clusters_here() -> None:
    weights = communities(3, (6, 6, 6), 0.6)
    counts = [markov_clusters(weights, i).max() + 1 for i in (1.2, 2.0, 4.0, 8.0)]
    assert counts == sorted(counts)


def test_views_without_anything_in_common_are_clusters_of_their_own() -> None:
    assert cluster_graph(np.zeros((3, 3)), CONFIG).tolist() == [0, 1, 2]
    assert cluster_graph(np.zeros((0, 0)), CONFIG).tolist() == []
    weights = np.zeros((3, 3))
    weights[0, 2] = weights[2, 0] = 0.5
    assert cluster_graph(weights, CONFIG).tolist() == [0, 1, 0]


def test_clustering_leaves_its_input_alone_and_repeats_itself() -> None:
    weights = communities(4, (10, 12), 0.4)
    before = weights.copy()
    first, second = (cluster_graph(weights, CONFIG) for _ in range(2))
    assert (weights == before).all()
    assert first.tobytes() == second.tobytes()


def test_one_inflation_can_be_asked_for() -> None:
    weights = communities(5, (6, 6), 0.3)
    single = replace(CONFIG, inflation_low=2.0, inflation_samples=1)
    assert cluster_graph(weights, single).tolist() == markov_clusters(weights, 2.0).tolist()
