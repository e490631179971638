"""Transform consensus: every match registered by itself, outliers removed, mean of the rest.

Thesis §4.4: "after finding a transformation between every match outliers that represent an
incorrect registration are removed. We then find the mean of the remaining transformations".
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import RoomMatch
from topometric_ros.configuration import parameter
from topometric_ros.fusion.poses import Transform, apart, apply, yaw_of, yaw_pose
from topometric_ros.fusion.registration import RegistrationConfig, RegistrationError, register
from topometric_ros.fusion.surface import Surface
from topometric_ros.topometric_map import TopometricMap


@dataclass(frozen=True)
class ConsensusConfig:
    """How the transforms of single matches become one."""

    registration: RegistrationConfig = field(
        default_factory=lambda: RegistrationConfig(
            gates=("1.0", "0.6", "0.4", "0.25"), points=2000, steps=15
        )
    )
    outlier: float = parameter(
        0.5,
        "A match whose transform lies farther than this from the middle one is an outlier, or than "
        "2.5 times the median distance where that is more.",
        unit="m",
        minimum=0.0,
    )


@dataclass(frozen=True)
class Consensus:
    """The mean transform and the matches that it rests on."""

    T_a_b: Transform
    kept: tuple[RoomMatch, ...]
    dropped: tuple[RoomMatch, ...]


def consensus(
    a: TopometricMap,
    b: TopometricMap,
    surface_a: Surface,
    surface_b: Surface,
    T_init: Transform,
    matches: Sequence[RoomMatch],
    config: ConsensusConfig,
) -> Consensus:
    """Register every matched pair of rooms from the coarse transform and average what agrees.

    Parameters
    ----------
    a, b : the maps, whose voxels' room labels say which surface points belong to a match
    surface_a, surface_b : their surfaces, rows as the maps' voxels, level frames
    T_init : (4, 4) float64, T_a_b of the matched centroids, level frames

    Raises
    ------
    RegistrationError
        No match could be registered.
    """
    transforms, registered, failed = [], [], []
    for match in matches:
        part_a = surface_a.take(a.room == match.room_a)
        part_b = surface_b.take(b.room == match.room_b)
        try:
            result = register(part_b, part_a, T_init, config.registration)
        except RegistrationError:
            failed.append(match)
            continue
        transforms.append(result.T_target_source)
        registered.append(match)
    if not transforms:
        raise RegistrationError(f"none of {len(matches)} matched rooms could be registered")
    positions = np.array([b.room_by_id(match.room_b).centroid for match in registered])
    keep = inliers(transforms, positions, config.outlier)
    kept = [match for match, own in zip(registered, keep, strict=True) if own]
    lost = [match for match, own in zip(registered, keep, strict=True) if not own]
    mean = mean_pose([T for T, own in zip(transforms, keep, strict=True) if own], positions[keep])
    return Consensus(mean, tuple(kept), tuple(lost + failed))


def inliers(
    transforms: Sequence[Transform], positions: NDArray[np.float64], outlier: float
) -> NDArray[np.bool_]:
    """Return which transforms lie near the middle one, the one nearest to all others.

    The distance of two is how far apart they put `positions` (n, 3), m, on average: a difference
    read at the frame's origin would multiply the yaw's.
    """
    distances = np.array([[apart(one, two, positions) for two in transforms] for one in transforms])
    from_middle = distances[int(np.argmin(np.median(distances, axis=1)))]
    return from_middle <= max(outlier, 2.5 * float(np.median(from_middle)))


def mean_pose(transforms: Sequence[Transform], positions: NDArray[np.float64]) -> Transform:
    """Return the mean of transforms about z: circular for the yaw, at the middle of `positions`.

    Examples
    --------
    >>> one, two = yaw_pose(3.1, (1.0, 0.0, 0.0)), yaw_pose(-3.1, (3.0, 0.0, 0.0))
    >>> mean = mean_pose([one, two], np.zeros((1, 3)))
    >>> round(abs(yaw_of(mean)), 4), mean[:3, 3].tolist()
    (3.1416, [2.0, 0.0, 0.0])
    """
    yaws = np.array([yaw_of(T) for T in transforms])
    yaw = float(np.arctan2(np.sin(yaws).mean(), np.cos(yaws).mean()))
    middle = positions.mean(axis=0)
    there = np.mean([apply(T, middle[None])[0] for T in transforms], axis=0)
    T = yaw_pose(yaw, (0.0, 0.0, 0.0))
    T[:3, 3] = there - T[:3, :3] @ middle
    return T
