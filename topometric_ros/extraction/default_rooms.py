"""Rooms of preset `default`: floors are cut at every narrowing and merged again by what sees what.

Walls are read above the furniture (`walls.py`), the floor between them is cut into pieces
(`pieces.py`), and pieces are merged where they see each other and no doorway lies between them
(`pair_features.py`, `merging.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.configuration import parameter
from topometric_ros.extraction.columns import Columns
from topometric_ros.extraction.merging import MergingConfig, merge_pieces
from topometric_ros.extraction.pair_features import pair_features
from topometric_ros.extraction.pieces import markers, watershed
from topometric_ros.extraction.storeys import RASTER, StoreyHeights
from topometric_ros.extraction.walls import StoreyRaster, WallsConfig, storey_raster


@dataclass(frozen=True)
class NarrowingsConfig:
    """Stages of the room segmentation of preset `default`."""

    walls: WallsConfig = field(default_factory=WallsConfig)
    narrowest: float = parameter(
        0.3, "Distance from the walls that a piece of floor must reach.", unit="m", minimum=0.05
    )
    merging: MergingConfig = field(default_factory=MergingConfig)
    smallest_area: float = parameter(0.5, "Smallest room.", unit="m²", minimum=0.0)
    reach: float = parameter(
        2.0,
        "Voxels farther than this from every room's floor belong to no room.",
        unit="m",
        minimum=0.1,
    )


def storey_regions(raster: StoreyRaster, config: NarrowingsConfig) -> NDArray[np.int32]:
    """Return the rooms of one storey: (nx, ny) int32, numbered from 1, 0 where there is none."""
    pieces = watershed(
        raster.distance,
        raster.domain,
        markers(raster.distance, raster.domain, config.narrowest / RASTER),
    )
    if not pieces.any():
        return pieces
    merging = config.merging
    features = pair_features(
        raster, pieces, round(merging.sample_step / RASTER), merging.view_range / RASTER
    )
    regions = merge_pieces(pieces, raster.distance, features, merging)
    area = np.bincount(regions.ravel()) * RASTER**2
    area[0] = 0.0
    kept = np.flatnonzero(area >= config.smallest_area)
    renumbered = np.zeros(len(area), np.int32)
    renumbered[kept] = np.arange(1, len(kept) + 1)
    return renumbered[regions]


def segment(
    columns: Columns,
    heights: NDArray[np.float64],
    storeys: Sequence[StoreyHeights],
    storey: NDArray[np.int32],
    config: NarrowingsConfig,
) -> NDArray[np.int32]:
    """Label every 0.1 m voxel with its room.

    Parameters
    ----------
    columns : columns of the voxels
    heights : (N,) float64, m, mean height of the points seen in each voxel
    storeys : floors and ceilings, lowest first
    storey : (N,) int32, index of the storey of each voxel

    Returns
    -------
    (N,) int32, rooms numbered from 0, storey by storey; -1 in columns that lie farther than
    `reach` from every room of their storey.
    """
    labels = np.full(len(heights), -1, np.int32)
    count = 0
    for index, level in enumerate(storeys):
        members = storey == index
        if not members.any():
            continue
        raster = storey_raster(columns, heights, members, level, config.walls)
        regions = storey_regions(raster, config)
        if not regions.any():
            continue
        distance, (x, y) = ndimage.distance_transform_edt(regions == 0, return_indices=True)
        nearest = np.where(distance <= config.reach / RASTER, regions[x, y], 0)
        cells = columns.raster_cells()[members] - (raster.corner - columns.corner)
        found = nearest[tuple(cells.T)]
        labels[members] = np.where(found > 0, found - 1 + count, -1)
        count += int(regions.max())
    return labels
