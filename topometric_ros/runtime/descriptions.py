"""Descriptors of a growing map: only rooms whose voxels have changed are described again.

A descriptor is a function of one room's voxels alone, so the rows of a room that is the same in
the version before are taken from there, and the result is that of describing all rooms.
"""

from __future__ import annotations

import dataclasses
import hashlib

import numpy as np

from topometric_ros.matching.config import MatchingConfig
from topometric_ros.matching.descriptors import describe
from topometric_ros.matching.descriptors.base import room_voxels
from topometric_ros.topometric_map import NO_ROOM, Descriptors, TopometricMap


def describe_changed(
    m: TopometricMap, previous: TopometricMap | None, config: MatchingConfig
) -> TopometricMap:
    """Return a map with every room's descriptors, as :func:`describe` does.

    Parameters
    ----------
    m : the map to describe
    previous : an earlier version, described under the same `config`; None: there is none
    config : MatchingConfig
    """
    usable = previous is not None and previous.voxel_size == m.voxel_size
    if previous is None or not usable or config.context.kind == "merged":
        return describe(m, config)
    known = {digest: row for row, digest in enumerate(_digests(previous))}
    rows = [known.get(digest, -1) for digest in _digests(m)]
    changed = [room for room, row in zip(m.rooms, rows, strict=True) if row < 0]
    ids = np.array([room.id for room in changed], np.int64)
    part = dataclasses.replace(
        m,
        room=np.where(np.isin(m.room, ids), m.room, NO_ROOM).astype(np.int32),
        rooms=tuple(changed),
        passages=(),
        descriptors=(),
    )
    taken = np.array(rows, np.int64)
    entries = []
    for entry in describe(part, config).descriptors:
        before = previous.descriptor(entry.name)
        if before is None or before.version != entry.version:
            return describe(m, config)
        values = np.empty((len(rows), entry.values.shape[1]), np.float32)
        values[taken < 0] = entry.values
        values[taken >= 0] = before.values[taken[taken >= 0]]
        entries.append(Descriptors(entry.name, entry.version, values))
    return dataclasses.replace(m, descriptors=tuple(entries))


def _digests(m: TopometricMap) -> list[bytes]:
    """Return what tells each room's voxels from others."""
    return [hashlib.blake2b(voxels.tobytes()).digest() for voxels in room_voxels(m)]
