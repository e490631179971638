"""Rooms of two maps in one feature space, neighbourhood included (thesis §4.3.5, eq. 44-48)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.matching.config import ContextConfig, MatchingConfig
from topometric_ros.matching.descriptors import MERGED, described, descriptors_of
from topometric_ros.matching.room_distance import learned_features
from topometric_ros.matching.room_graph import RoomGraph, room_graph
from topometric_ros.topometric_map import TopometricMap

Features = NDArray[np.float64]


def embed_pair(
    a: TopometricMap, b: TopometricMap, config: MatchingConfig
) -> tuple[Features, Features]:
    """Embed the rooms of two maps in one feature space.

    Each descriptor is standardised over the rooms of both maps, so that no unit dominates, and
    divided by the square root of its length, so that no descriptor does. Two unlike rooms are then
    about √2 apart, whatever the descriptors. Where the distance is `learned`, the descriptor
    `shape` is instead divided by how much one room's differs from agent to agent
    (:mod:`topometric_ros.matching.room_distance`).

    Returns
    -------
    features_a, features_b : (R_a, D) and (R_b, D) float64, no unit
    """
    a, b = described(a, config), described(b, config)
    names = [(d.name, d.by_ratio) for d in descriptors_of(config)]
    if config.context.kind == "merged":
        names += [(name + MERGED, by_ratio) for name, by_ratio in names]
    blocks = []
    for name, by_ratio in names:
        values = [entry.values for m in (a, b) if (entry := m.descriptor(name)) is not None]
        if config.distance == "learned" and name.removesuffix(MERGED) == "shape":
            blocks.append((learned_features(values[0]), learned_features(values[1])))
        else:
            blocks.append(_standardised(*(_by_size(v, by_ratio) for v in values)))
    both = [np.concatenate(of_one, axis=1) for of_one in zip(*blocks, strict=True)]
    return (
        contextual(both[0] / np.sqrt(len(blocks)), room_graph(a), config.context),
        contextual(both[1] / np.sqrt(len(blocks)), room_graph(b), config.context),
    )


def contextual(features: Features, graph: RoomGraph, config: ContextConfig) -> Features:
    """Add the neighbours' features to every room's, `steps` times (eq. 48).

    Examples
    --------
    >>> chain = RoomGraph((0, 1), np.zeros((2, 3)), np.zeros(2), np.ones(2), ((1,), (0,)), {})
    >>> config = ContextConfig("convolution", weight=0.5)
    >>> contextual(np.array([[1.0], [3.0]]), chain, config).tolist()
    [[2.5], [3.5]]
    """
    if config.kind != "convolution":
        return features
    adjacency = np.zeros((len(graph), len(graph)))
    for row, near in enumerate(graph.neighbours):
        adjacency[row, list(near)] = config.weight
    for _ in range(config.steps):
        features = features + adjacency @ features
    return features


def _standardised(of_a: Features, of_b: Features) -> tuple[Features, Features]:
    """Divide a descriptor by its deviation over the rooms of both maps, and by √ of its length."""
    values = np.concatenate([of_a, of_b])
    deviation = values.std(axis=0)
    scale = np.where(deviation > 1e-9, deviation, np.inf) * np.sqrt(max(1, values.shape[1]))
    middle = values.mean(axis=0)
    return (of_a - middle) / scale, (of_b - middle) / scale


def _by_size(values: NDArray[np.float32], by_ratio: bool) -> Features:
    """Take logarithms of sizes: a hall differs from an office by a factor, not by an amount."""
    numbers = values.astype(np.float64)
    return np.log1p(np.maximum(numbers, 0.0)) if by_ratio else numbers
