"""The learned distance of rooms: noise that one room has anyway counts little."""

from __future__ import annotations

import numpy as np

from topometric_ros.matching.assignment import assign, cost_matrix
from topometric_ros.matching.config import matching_preset
from topometric_ros.matching.room_distance import fit_metric, learned_features


def test_what_differs_between_views_of_one_room_counts_less_than_what_does_not():
    draw = np.random.default_rng(0)
    # The first two numbers err much and together, the third hardly.
    noise = draw.normal(size=(500, 1)) * [0.3, 0.3, 0.0] + draw.normal(size=(500, 3)) * 0.02
    metric = fit_metric(noise)
    along, across, steady = (
        float(np.linalg.norm(np.array(step) @ metric))
        for step in ([0.1, 0.1, 0.0], [0.1, -0.1, 0.0], [0.0, 0.0, 0.1])
    )
    assert along < 0.5 * across < 0.5 * steady
    assert np.sqrt(np.mean(np.sum((noise @ metric) ** 2, axis=1))) < 1.1


def test_a_room_seen_in_part_is_nearer_to_itself_than_to_a_smaller_one():
    bins = np.arange(38)

    def room(width: float) -> np.ndarray:
        distances = np.exp(-(((bins[:21] * 0.5 - width) / width) ** 2))
        heights = np.where(bins[:17] < 10, 1.0, 0.0)
        shares = [100 * distances / distances.sum(), 100 * heights / heights.sum()]
        return np.concatenate(shares).astype(np.float32)

    whole = np.stack([room(4.0), room(1.5)])
    seen = np.stack([room(3.5), room(1.4)])
    cost = cost_matrix(learned_features(whole), learned_features(seen))
    assert [(i, j) for i, j, _ in assign(cost)] in ([(0, 0), (1, 1)], [(1, 1), (0, 0)])
    assert cost.max() > 3 * max(cost[0, 0], cost[1, 1])
    assert assign(cost[:1, 1:], matching_preset("default").alone) == []
