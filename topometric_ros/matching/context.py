"""Rooms of two maps in one feature space, neighbourhood included (thesis §4.3.5, eq. 44-48)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from topometric_ros.matching.config import ContextConfig, MatchingConfig
from topometric_ros.matching.descriptors import MERGED, described, descriptors_of
from topometric_ros.matching.room_graph import RoomGraph, room_graph
from topometric_ros.topometric_map import TopometricMap

Features = NDArray[np.float64]


def embed_pair(
    a: TopometricMap, b: TopometricMap, config: MatchingConfig
) -> tuple[Features, Features]:
    """Embed the rooms of two maps in one feature space.

    Each descriptor is standardised over the rooms of both maps, so that no unit dominates, and
    divided by the square root of its length, so that no descriptor does. Two unlike rooms are then
    about √2 apart, whatever the descriptors.

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
        blocks.append((_by_size(values[0], by_ratio), _by_size(values[1], by_ratio)))
    both = np.concatenate(embed(blocks))
    return (
        contextual(both[: len(a.rooms)], room_graph(a), config.context),
        contextual(both[len(a.rooms) :], room_graph(b), config.context),
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


def embed(
    blocks: Sequence[tuple[Features, Features]], scales: Sequence[Features] | None = None
) -> tuple[Features, Features]:
    """Put the descriptors of two maps' rooms beside each other, each with the same weight.

    Parameters
    ----------
    blocks : of each descriptor the numbers, of sizes their logarithms: (R_a, D) and (R_b, D)
    scales : of each descriptor (D,) what its numbers are divided by; None: their deviation over the
        rooms of both maps
    """
    features = []
    for k, (of_a, of_b) in enumerate(blocks):
        values = np.concatenate([of_a, of_b])
        deviation = values.std(axis=0) if scales is None else scales[k]
        scale = np.where(deviation > 1e-9, deviation, np.inf)
        features.append((values - values.mean(axis=0)) / scale / np.sqrt(max(1, values.shape[1])))
    both = np.concatenate(features, axis=1) / np.sqrt(len(blocks))
    return both[: len(blocks[0][0])], both[len(blocks[0][0]) :]


def _by_size(values: NDArray[np.float32], by_ratio: bool) -> Features:
    """Take logarithms of sizes: a hall differs from an office by a factor, not by an amount."""
    numbers = values.astype(np.float64)
    return np.log1p(np.maximum(numbers, 0.0)) if by_ratio else numbers
