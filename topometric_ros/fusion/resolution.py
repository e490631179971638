"""A map at a coarser voxel size: maps of unlike resolution are compared at the coarser one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.grid import surface_offsets, voxelise


def coarsened(m: TopometricMap, voxel_size: float) -> TopometricMap:
    """Return a map with voxels of edge `voxel_size` (m), no finer than its own; rasters stay.

    A coarse voxel lies where surface points of the map do and has the room that most of them have.
    Rooms keep their attributes and count their new voxels; one that no voxel is left of goes on.
    """
    if voxel_size <= m.voxel_size or len(m.voxels) == 0:
        return m
    points = m.surface()
    grid, row = voxelise(points, voxel_size, np.asarray(m.origin))
    # Of the pairs (voxel, room), the most frequent of each voxel.
    pairs, count = np.unique(np.column_stack([row, m.room]), axis=0, return_counts=True)
    order = np.lexsort((pairs[:, 1], -count, pairs[:, 0]))
    _, first = np.unique(pairs[order, 0], return_index=True)
    room = pairs[order][first, 1].astype(np.int32)
    return replace(
        m,
        voxel_size=voxel_size,
        voxels=grid.coords,
        offsets=surface_offsets(points, grid, row),
        room=room,
        rooms=tuple(replace(r, voxels=int(np.count_nonzero(room == r.id))) for r in m.rooms),
    )
