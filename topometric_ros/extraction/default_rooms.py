"""Rooms of preset `default`: floors are cut at every narrowing and merged again by what sees what.

Walls are read above the furniture (`walls.py`), the floor between them is cut into pieces
(`pieces.py`), and pieces are merged where they see each other and no doorway lies between them
(`pair_features.py`, `merging.py`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.extraction.columns import Columns
from topometric_ros.extraction.merging import MergingConfig, merge_pieces
from topometric_ros.extraction.pair_features import pair_features
from topometric_ros.extraction.pieces import markers, watershed
from topometric_ros.extraction.room_kinds import RoomClassifier, join_corridors
from topometric_ros.extraction.room_labels import label_points
from topometric_ros.extraction.storeys import RASTER, StoreyHeights
from topometric_ros.extraction.walls import StoreyRaster, WallsConfig, storey_raster

_FLAT = 0.2
"""Points this near to the floor or the ceiling make no wall, m."""
_UNSEEN = 1.5
"""Floor is at most so many times as wide as it was seen: what was half seen is not narrow."""


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


def storey_regions(
    raster: StoreyRaster, config: NarrowingsConfig, classifier: RoomClassifier | None = None
) -> NDArray[np.int32]:
    """Return the rooms of one storey: (nx, ny) int32, numbered from 1, 0 where there is none.

    An own `classifier` may join more cuts of one corridor than the merging of pieces.
    """
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
    wide = np.minimum(raster.clearance, _UNSEEN * raster.distance)
    regions = merge_pieces(pieces, wide, features, merging)
    if classifier is not None:
        regions = join_corridors(regions, raster.distance, RASTER, classifier)
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
    places: NDArray[np.float64],
    voxel_of_point: NDArray[np.int64],
    config: NarrowingsConfig,
    classifier: RoomClassifier | None = None,
) -> NDArray[np.int32]:
    """Label every point with its room.

    Parameters
    ----------
    columns : columns of the 0.1 m voxels
    heights : (N,) float64, m, mean height of the points seen in each voxel
    storeys : floors and ceilings, lowest first
    storey : (N,) int32, index of the storey of each voxel
    places : (P, 2) float64, cells, x and y of the points on the voxels' lattice
    voxel_of_point : (P,) int64
    config : NarrowingsConfig
    classifier : an own one may join cuts of one corridor

    Returns
    -------
    (P,) int32, rooms numbered from 0, storey by storey; -1 for points that lie farther than
    `reach` from every room of their storey.
    """
    labels = np.full(len(places), -1, np.int32)
    count = 0
    for index, level in enumerate(storeys):
        members = storey == index
        if not members.any():
            continue
        raster = storey_raster(columns, heights, members, level, config.walls)
        regions = storey_regions(raster, config, classifier)
        if not regions.any():
            continue
        between = (level.floor + _FLAT, level.ceiling - _FLAT)
        inside, at, upright = _points_of(
            members, voxel_of_point, heights, places, raster.corner, between
        )
        found = label_points(regions, raster.wall, at, upright, config.reach / RASTER)
        labels[inside] = np.where(found > 0, found - 1 + count, -1)
        count += int(regions.max())
    return labels


@njit(cache=True, nogil=True)
def _points_of(members, voxel_of_point, heights, places, corner, between):  # type: ignore[no-untyped-def]
    """Rows of the points of a storey's voxels (K,), their places in its raster, and which of them
    lie in voxels whose height is between the two."""
    count = 0
    for voxel in voxel_of_point:
        count += members[voxel]
    rows = np.empty(count, np.int64)
    at = np.empty((count, 2))
    upright = np.empty(count, np.bool_)
    k = 0
    for p, voxel in enumerate(voxel_of_point):
        if members[voxel]:
            rows[k] = p
            at[k, 0], at[k, 1] = places[p, 0] - corner[0], places[p, 1] - corner[1]
            upright[k] = between[0] < heights[voxel] < between[1]
            k += 1
    return rows, at, upright
