"""Descriptors of room geometry, and the one function that puts them into a map (thesis §4.3.1)."""

from __future__ import annotations

import dataclasses

from topometric_ros.matching.config import MatchingConfig
from topometric_ros.matching.descriptors.base import Descriptor
from topometric_ros.matching.descriptors.engineered import EngineeredDescriptor
from topometric_ros.matching.descriptors.learned import LearnedDescriptor
from topometric_ros.matching.descriptors.shape import ShapeDescriptor
from topometric_ros.matching.descriptors.spectral import SpectralDescriptor
from topometric_ros.matching.descriptors.topological import TopologicalDescriptor
from topometric_ros.topometric_map import Descriptors, TopometricMap

MERGED = "_with_neighbours"
"""Ends the name of the descriptor of a room merged with its neighbours."""

__all__ = [
    "MERGED",
    "Descriptor",
    "EngineeredDescriptor",
    "LearnedDescriptor",
    "ShapeDescriptor",
    "SpectralDescriptor",
    "TopologicalDescriptor",
    "describe",
    "described",
    "descriptors_of",
]


def descriptors_of(config: MatchingConfig) -> tuple[Descriptor, ...]:
    """Return the descriptors that a configuration names, in its order."""
    c = config.descriptors
    known: dict[str, Descriptor] = {
        "engineered": EngineeredDescriptor(c.box, c.roughness_neighbours),
        "spectral": SpectralDescriptor(
            c.eigenvalues, c.matrix, c.neighbourhood, c.spectral_cell, c.spectral_nodes
        ),
        "shape": ShapeDescriptor(),
        "learned": LearnedDescriptor(),
        "topological": TopologicalDescriptor(),
    }
    return tuple(known[name] for name in c.names)


def describe(topometric_map: TopometricMap, config: MatchingConfig) -> TopometricMap:
    """Return the map with every room's descriptors, replacing those it had (eq. 43).

    Under the context `merged` each descriptor comes twice: of the room, and of its geometry merged
    with that of its neighbours, the name ending in :data:`MERGED`.
    """
    entries = []
    for descriptor in descriptors_of(config):
        values = descriptor(topometric_map)
        entries.append(Descriptors(descriptor.name, descriptor.version, values))
        if config.context.kind == "merged":
            merged = descriptor(topometric_map, neighbourhoods(topometric_map))
            entries.append(Descriptors(descriptor.name + MERGED, descriptor.version, merged))
    return dataclasses.replace(topometric_map, descriptors=tuple(entries))


def described(topometric_map: TopometricMap, config: MatchingConfig) -> TopometricMap:
    """Return the map itself where its descriptors are those of `config`, else describe it."""
    for descriptor in descriptors_of(config):
        names = [descriptor.name]
        if config.context.kind == "merged":
            names.append(descriptor.name + MERGED)
        for name in names:
            entry = topometric_map.descriptor(name)
            if (
                entry is None
                or entry.version != descriptor.version
                or entry.values.shape[1:] != (descriptor.dimension,)
            ):
                return describe(topometric_map, config)
    return topometric_map


def neighbourhoods(topometric_map: TopometricMap) -> list[tuple[int, ...]]:
    """Return each room's id together with those of its neighbours in the topological graph."""
    near: dict[int, set[int]] = {room.id: {room.id} for room in topometric_map.rooms}
    for passage in topometric_map.passages:
        first, second = passage.rooms
        near[first].add(second)
        near[second].add(first)
    return [tuple(sorted(near[room.id])) for room in topometric_map.rooms]
