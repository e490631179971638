"""Matching rooms: context, assignment, growing and the choice among hypotheses."""

from __future__ import annotations

import numpy as np

from test.helpers import moved, yaw_transform
from test.helpers_matching import (
    A_ROOMS,
    B_ROOMS,
    T_A_B,
    T_BUILDING_A,
    T_BUILDING_B,
    agent_map,
    error_of,
)
from topometric_ros.matching.assignment import assign, cost_matrix
from topometric_ros.matching.choice import choose, compatible
from topometric_ros.matching.config import (
    ChoiceConfig,
    ContextConfig,
    GrowingConfig,
    matching_preset,
)
from topometric_ros.matching.context import contextual
from topometric_ros.matching.hypotheses import Hypothesis, grow, grow_all, register_positions
from topometric_ros.matching.propose import propose_from_rooms
from topometric_ros.matching.room_graph import RoomGraph, room_graph

CENTROIDS = np.array([[0, 0, 0], [4, 0, 0], [8, 1, 0], [9, 5, 0], [14, 5, 0]], dtype=float)
CHAIN_YAW = yaw_transform(0.7, (3.0, -2.0, 0.5))


def chain(centroids: np.ndarray) -> RoomGraph:
    """Return rooms in a row, each next to the one before."""
    n = len(centroids)
    return RoomGraph(
        ids=tuple(range(n)),
        centroids=centroids,
        floors=centroids[:, 2].copy(),
        areas=np.ones(n),
        neighbours=tuple(tuple(j for j in (i - 1, i + 1) if 0 <= j < n) for i in range(n)),
        passages={(i, i + 1): centroids[i : i + 2].mean(axis=0)[None] for i in range(n - 1)},
    )


def chains() -> tuple[RoomGraph, RoomGraph, np.ndarray]:
    """Return one chain seen by two agents and costs that are low for the same room."""
    other = moved(CENTROIDS, np.linalg.inv(CHAIN_YAW))
    cost = np.full((5, 5), 1.5)
    np.fill_diagonal(cost, 0.1)
    return chain(CENTROIDS), chain(other), cost


def test_more_rooms_on_one_side_leave_rooms_unmatched() -> None:
    cost = cost_matrix(np.array([[0.0], [5.0]]), np.array([[9.0], [0.1], [5.2]]))
    assert [(i, j) for i, j, _ in assign(cost)] == [(0, 1), (1, 2)]
    assert [(i, j) for i, j, _ in assign(cost.T)] == [(1, 0), (2, 1)]
    assert assign(np.zeros((0, 3))) == []


def test_context_adds_weighted_neighbours_at_every_step() -> None:
    graph = chain(CENTROIDS[:3])
    features = np.array([[1.0], [10.0], [100.0]])
    once = contextual(features, graph, ContextConfig("convolution", 0.5, 1))
    assert once.ravel().tolist() == [6.0, 60.5, 105.0]
    twice = contextual(features, graph, ContextConfig("convolution", 0.5, 2))
    assert twice.ravel().tolist() == [36.25, 116.0, 135.25]


def test_registering_positions_finds_yaw_and_translation() -> None:
    T, error = register_positions(moved(CENTROIDS, CHAIN_YAW), CENTROIDS)
    np.testing.assert_allclose(T, CHAIN_YAW, atol=1e-12)
    assert error < 1e-12


def test_positions_without_weight_do_not_count() -> None:
    target = moved(CENTROIDS, CHAIN_YAW)
    target[0] += 5.0
    weights = np.ones(len(CENTROIDS))
    weights[0] = 0.0
    T, _ = register_positions(target, CENTROIDS, weights)
    np.testing.assert_allclose(T, CHAIN_YAW, atol=1e-12)


def test_one_position_gives_a_translation_and_no_turn() -> None:
    T, _ = register_positions(np.array([[1.0, 2.0, 3.0]]), np.array([[0.0, 0.0, 1.0]]))
    np.testing.assert_array_equal(T, yaw_transform(0.0, (1.0, 2.0, 2.0)))


def test_one_seed_grows_along_the_whole_chain() -> None:
    graph_a, graph_b, cost = chains()
    hypothesis = grow((2, 2, 0.1), cost, graph_a, graph_b, GrowingConfig())
    assert sorted((i, j) for i, j, _ in hypothesis.matches) == [(i, i) for i in range(5)]
    np.testing.assert_allclose(hypothesis.T_a_b, CHAIN_YAW, atol=1e-9)


def test_matches_above_the_largest_cost_do_not_join() -> None:
    graph_a, graph_b, cost = chains()
    cost[4, 4] = 3.0
    hypothesis = grow((0, 0, 0.1), cost, graph_a, graph_b, GrowingConfig(cost_max=1.0))
    assert sorted(i for i, _, _ in hypothesis.matches) == [0, 1, 2, 3]


def test_a_match_that_bends_the_registration_does_not_join() -> None:
    graph_a, graph_b, cost = chains()
    graph_b.centroids[4] += (0.0, 9.0, 0.0)
    hypothesis = grow((0, 0, 0.1), cost, graph_a, graph_b, GrowingConfig(error_increase_max=0.5))
    assert sorted(i for i, _, _ in hypothesis.matches) == [0, 1, 2, 3]


def test_every_seed_starts_afresh() -> None:
    graph_a, graph_b, cost = chains()
    grown = grow_all(cost, graph_a, graph_b, GrowingConfig(seeds_per_room=0))
    assert len(grown) == 5
    assert all(len(h.matches) == 5 for h in grown)


def test_hypotheses_that_match_a_room_twice_are_incompatible() -> None:
    def hypothesis(*pairs: tuple[int, int]) -> Hypothesis:
        return Hypothesis(tuple((i, j, 0.1) for i, j in pairs), np.eye(4), 0.0, True)

    assert compatible(hypothesis((0, 0), (1, 1)), hypothesis((2, 2), (1, 1)))
    assert not compatible(hypothesis((0, 0)), hypothesis((0, 1)))
    assert not compatible(hypothesis((0, 0)), hypothesis((1, 0)))


def test_the_thesis_chooses_the_largest_after_similar_ones_became_one() -> None:
    graph_a, graph_b, cost = chains()
    growing = GrowingConfig(passages=False)
    left = grow((0, 0, 0.1), cost[:3, :3], chain(CENTROIDS[:3]), chain(graph_b.centroids[:3]),
                growing)  # fmt: skip
    right = Hypothesis(((3, 3, 0.2), (4, 4, 0.2)), left.T_a_b, 0.0, True)
    wrong = Hypothesis(((0, 4, 0.1), (1, 3, 0.1), (2, 2, 0.1), (3, 1, 0.1)),
                       yaw_transform(2.0, (30.0, 0, 0)), 0.1, True)  # fmt: skip
    chosen = choose([wrong, left, right], graph_a, graph_b, growing, ChoiceConfig(rule="thesis"))
    assert len(chosen) == 1
    assert sorted((i, j) for i, j, _ in chosen[0].matches) == [(i, i) for i in range(5)]


def test_ties_go_to_the_lowest_mean_distance() -> None:
    graph_a, graph_b, _ = chains()
    near, far = (
        Hypothesis(((i, i, d), (i + 1, i + 1, d)), yaw_transform(0.0, (i * 20.0, 0, 0)), 0.0, True)
        for i, d in ((0, 0.2), (2, 0.4))
    )
    chosen = choose([far, near], graph_a, graph_b, GrowingConfig(), ChoiceConfig(rule="thesis"))
    assert chosen == [near]


def test_rooms_of_two_agents_propose_the_right_pose_first() -> None:
    noise = 0.01
    a = agent_map("a", A_ROOMS, T_BUILDING_A, noise=noise)
    b = agent_map("b", B_ROOMS, T_BUILDING_B, noise=noise, seed=1)
    candidates = propose_from_rooms(a, b, matching_preset("default"))
    shift, turn = error_of(candidates[0].T_a_b, T_A_B, b.centres())
    assert shift < 0.5
    assert turn < 5.0
    assert {(m.room_a, m.room_b) for m in candidates[0].matches} >= {(0, 0), (2, 2), (4, 4)}
    assert all(c.source == "rooms" for c in candidates)


def test_a_single_common_room_proposes_poses_by_its_doors() -> None:
    a, b = agent_map("a", (0, 2), T_BUILDING_A), agent_map("b", (0, 2), T_BUILDING_B)
    candidates = propose_from_rooms(a, b, matching_preset("default"))
    best = min(error_of(c.T_a_b, T_A_B, b.centres())[0] for c in candidates)
    assert best < 0.3


def test_the_thesis_preset_proposes_one_pose_and_maps_without_rooms_none() -> None:
    a, b = agent_map("a", A_ROOMS, T_BUILDING_A), agent_map("b", B_ROOMS, T_BUILDING_B)
    assert len(propose_from_rooms(a, b, matching_preset("thesis"))) == 1
    bare = agent_map("c", A_ROOMS, T_BUILDING_A, bare=True)
    assert propose_from_rooms(a, bare, matching_preset("default")) == []
    assert len(room_graph(bare)) == 0
