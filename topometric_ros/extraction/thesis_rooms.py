"""Rooms as the thesis finds them (§4.2.7-4.2.8): views, their clusters, votes, smoothing, split."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.propagation import (
    PropagationConfig,
    propagate_labels,
    split_rooms,
    vote,
)
from topometric_ros.extraction.similarity import SimilarityConfig, cluster_visibilities
from topometric_ros.extraction.visibility import VisibilityConfig, visibilities
from topometric_ros.topometric_map import NO_ROOM
from topometric_ros.voxels.grid import VoxelGrid


@dataclass(frozen=True)
class ThesisRoomsConfig:
    """The stages between viewpoints and rooms; the defaults are the thesis' values."""

    visibility: VisibilityConfig = field(default_factory=VisibilityConfig)
    similarity: SimilarityConfig = field(default_factory=SimilarityConfig)
    propagation: PropagationConfig = field(default_factory=PropagationConfig)


def segment(
    grid: VoxelGrid,
    navigable: NDArray[np.int32],
    viewpoints: NDArray[np.float64],
    config: ThesisRoomsConfig,
) -> NDArray[np.int32]:
    """Return the room of every voxel.

    Parameters
    ----------
    grid : the occupied voxels
    navigable : (M, 3) int32; where nothing can be stood on there is no room
    viewpoints : (K, 3) float64, m, level frame
    config : the stages' configurations

    Returns
    -------
    (N,) int32, 0 for the room with most voxels and so on, NO_ROOM for voxels in none
    """
    if len(navigable) == 0 or len(viewpoints) == 0:
        return np.full(len(grid), NO_ROOM, np.int32)
    sets = visibilities(grid, viewpoints, config.visibility)
    labels = vote(sets, cluster_visibilities(sets, config.similarity))
    labels = propagate_labels(grid.coords, labels, config.propagation, grid.index)
    return split_rooms(grid.coords, labels, config.propagation, grid.index)
