"""Transform consensus: every match registered by itself, outliers removed, mean of the rest.

Thesis §4.4: "after finding a transformation between every match outliers that represent an
incorrect registration are removed. We then find the mean of the remaining transformations". As in
the author's final text, what registered badly goes first, the rest is clustered (DBSCAN), and of
the clusters' means the one counts that leaves the least error between the whole maps. All rooms
of its matches may then be registered at once.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from topometric_ros.alignment import RoomMatch
from topometric_ros.configuration import parameter
from topometric_ros.fusion.poses import Transform, apart, apply, yaw_of, yaw_pose
from topometric_ros.fusion.registration import RegistrationConfig, RegistrationError, register
from topometric_ros.fusion.surface import Surface
from topometric_ros.topometric_map import TopometricMap

_JUDGED = 5000
"""Points of one map that are looked for in the other to judge a cluster."""


@dataclass(frozen=True)
class ConsensusConfig:
    """How the transforms of single matches become one."""

    registration: RegistrationConfig = field(
        default_factory=lambda: RegistrationConfig(
            gates=(1.0, 0.6, 0.4, 0.25), points=2000, steps=15
        )
    )
    smallest_inliers: float = parameter(
        0.3,
        "A match registered badly where a smaller share of its points lies on the other room.",
        minimum=0.0,
        maximum=1.0,
    )
    outlier: float = parameter(
        0.5,
        "Matches whose transforms put the rooms at most this far apart are of one cluster.",
        unit="m",
        minimum=0.001,
    )
    joint: bool = parameter(
        True, "Register all rooms of the agreeing matches at once, from the mean of theirs."
    )


@dataclass(frozen=True)
class Consensus:
    """The transform and the matches that it rests on."""

    T_a_b: Transform
    kept: tuple[RoomMatch, ...]
    dropped: tuple[RoomMatch, ...]
    transforms: Mapping[RoomMatch, Transform]
    """That of each single match that was not registered badly."""


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
        if result.inliers < config.smallest_inliers:
            failed.append(match)
            continue
        transforms.append(result.T_target_source)
        registered.append(match)
    if not transforms:
        raise RegistrationError(f"none of {len(matches)} matched rooms could be registered")
    positions = np.array([b.room_by_id(match.room_b).centroid for match in registered])
    keep, T = _best_cluster(transforms, positions, surface_a, surface_b, config)
    kept = [match for match, own in zip(registered, keep, strict=True) if own]
    lost = [match for match, own in zip(registered, keep, strict=True) if not own]
    if config.joint:
        T = register_jointly(a, b, surface_a, surface_b, T, kept, config)
    singles = dict(zip(registered, transforms, strict=True))
    return Consensus(T, tuple(kept), tuple(lost + failed), singles)


def register_jointly(
    a: TopometricMap,
    b: TopometricMap,
    surface_a: Surface,
    surface_b: Surface,
    T_init: Transform,
    matches: Sequence[RoomMatch],
    config: ConsensusConfig,
) -> Transform:
    """Return T_a_b from all matched rooms at once; parameters and errors as `consensus`."""
    part_a = surface_a.take(np.isin(a.room, [match.room_a for match in matches]))
    part_b = surface_b.take(np.isin(b.room, [match.room_b for match in matches]))
    return register(part_b, part_a, T_init, config.registration).T_target_source


def _best_cluster(
    transforms: Sequence[Transform],
    positions: NDArray[np.float64],
    surface_a: Surface,
    surface_b: Surface,
    config: ConsensusConfig,
) -> tuple[NDArray[np.bool_], Transform]:
    """Return the members and the mean of the cluster under which the whole maps fit best."""
    labels = clusters(transforms, positions, config.outlier)
    groups = [labels == label for label in range(labels.max() + 1)]
    means = [
        mean_pose([T for T, own in zip(transforms, group, strict=True) if own], positions[group])
        for group in groups
    ]
    if len(groups) == 1:
        return groups[0], means[0]
    tree = cKDTree(surface_a.points)
    drawn = surface_b.points[:: max(1, len(surface_b) // _JUDGED)]
    reach = config.outlier
    errors = [
        float(np.minimum(tree.query(apply(T, drawn), distance_upper_bound=reach)[0], reach).mean())
        for T in means
    ]
    best = int(np.argmin(errors))
    return groups[best], means[best]


def clusters(
    transforms: Sequence[Transform], positions: NDArray[np.float64], reach: float
) -> NDArray[np.int64]:
    """Return the number of the cluster that each transform belongs to, by DBSCAN: (n,).

    A lone transform is a cluster, for two matches that differ leave no other. The distance of two
    is how far apart they put `positions` (n, 3), m, on average: a difference read at the frame's
    origin would multiply the yaw's.
    """
    distances = [[apart(one, two, positions) for two in transforms] for one in transforms]
    # With one point enough for a core, DBSCAN's clusters are what hangs together.
    _, labels = connected_components(np.array(distances) <= reach, directed=False)
    return np.asarray(labels, np.int64)


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
