"""Maps of small made-up buildings for the tests of search, evidence and verification."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from test.helpers import box_room, moved
from topometric_ros.extraction.layers import LayersConfig, storey_layers
from topometric_ros.topometric_map import Storey, TopometricMap
from topometric_ros.voxels.grid import thin

Room = tuple[tuple[float, float, float], tuple[float, float, float], tuple[tuple[str, float], ...]]

FLAT: tuple[Room, ...] = (
    ((0.0, 0.0, 0.0), (5.0, 4.0, 2.6), (("x+", 1.0),)),
    ((5.1, 0.0, 0.0), (3.4, 2.2, 2.6), (("x-", 1.0), ("y+", 0.9))),
    ((5.1, 2.3, 0.0), (6.2, 3.1, 2.6), (("y-", 0.9), ("x+", 2.2))),
    ((11.4, 1.2, 0.0), (2.6, 6.0, 2.6), (("x-", 3.3),)),
    ((0.0, 4.1, 0.0), (3.3, 2.9, 2.6), (("y-", 1.5),)),
)
"""Five rooms, no two alike."""

OTHER: tuple[Room, ...] = (
    ((0.0, 0.0, 0.0), (3.0, 7.0, 2.6), (("x+", 5.2),)),
    ((3.1, 4.2, 0.0), (7.4, 1.6, 2.6), (("x-", 1.0), ("y+", 6.0))),
    ((6.0, 5.9, 0.0), (4.3, 5.2, 2.6), (("y-", 3.1),)),
)
"""Another building."""

TWIN: tuple[Room, ...] = (
    ((0.0, 0.0, 0.0), (5.0, 4.0, 2.6), (("x+", 1.0),)),
    ((5.1, 0.0, 0.0), (2.0, 4.0, 2.6), (("x-", 1.0), ("x+", 3.0))),
    ((7.2, 0.0, 0.0), (5.0, 4.0, 2.6), (("x-", 3.0),)),
)
"""A building that half a turn carries onto itself."""


def building(rooms: Sequence[Room]) -> NDArray[np.float64]:
    """Return the points of a building: (N, 3) float64, m."""
    return np.concatenate([box_room(*room) for room in rooms])


def map_of(
    points: NDArray[np.float64],
    floors: Sequence[float] = (0.0,),
    T: NDArray[np.float64] | None = None,
) -> TopometricMap:
    """Return a map with nothing but storeys, of points seen in the frame that `T` leads to."""
    T = np.eye(4) if T is None else T
    heights = [float(z + T[2, 3]) for z in floors]
    layers = storey_layers(thin(moved(points, T), 0.05), heights, LayersConfig())
    nothing = np.zeros((0, 3), np.int32)
    return TopometricMap(
        agent="robot1",
        session="1",
        sequence=0,
        frame_id="map",
        stamp=0,
        voxel_size=0.1,
        origin=(0.0, 0.0, 0.0),
        voxels=nothing,
        offsets=nothing.astype(np.int8),
        room=np.zeros(0, np.int32),
        navigable=nothing,
        viewpoints=nothing.astype(np.float32),
        storeys=tuple(
            Storey(i, z, None, part)
            for i, (z, part) in enumerate(zip(heights, layers, strict=True))
        ),
    )
