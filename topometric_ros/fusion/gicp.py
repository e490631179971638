"""Generalised ICP about all axes, by small_gicp (Segal, Haehnel & Thrun 2009; Koide 2024).

Each point has its own covariance, flat along its surface, so pairs are compared plane to plane. It
knows nothing of which side of a wall was seen. Comes with the extra `gicp`.
"""

from __future__ import annotations

import os
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from topometric_ros.configuration import missing_extra
from topometric_ros.fusion.icp import ALL, gates_of, measured, shared_part
from topometric_ros.fusion.poses import Transform
from topometric_ros.fusion.registration_config import Registration, RegistrationConfig
from topometric_ros.fusion.surface import NEIGHBOURS, Surface


def gicp(
    source: Surface,
    target: Surface,
    T_init: Transform,
    config: RegistrationConfig,
    tree: cKDTree | None = None,
) -> Registration:
    """Refine all six unknowns of a pose; a :class:`Registrar`.

    Raises
    ------
    ConfigurationError
        small_gicp is not installed.
    RegistrationError
        The surfaces share too little.
    """
    library = _library()
    tree = tree or cKDTree(target.points)
    gates = gates_of(config, max(source.spacing, target.spacing))
    source = shared_part(source, tree, T_init, gates[0], config)
    clouds = [library.PointCloud(np.ascontiguousarray(s.points)) for s in (target, source)]
    trees = [library.KdTree(cloud, num_threads=1) for cloud in clouds]
    for cloud, own in zip(clouds, trees, strict=True):
        library.estimate_covariances(cloud, own, num_neighbors=NEIGHBOURS, num_threads=1)
    T = T_init
    for gate in gates:
        found = library.align(
            clouds[0],
            clouds[1],
            trees[0],
            init_T_target_source=T,
            registration_type="GICP",
            # Pairs of unlike voxels lie up to a voxel apart along the wall.
            max_correspondence_distance=max(gate, 1.5 * target.spacing),
            num_threads=1,
            max_iterations=config.steps,
        )
        T = np.array(found.T_target_source)
    return measured(source, target, tree, T, config, ALL)


def _library() -> Any:
    """Return the module; its idle threads must not spin on the cores that others need."""
    os.environ.setdefault("OMP_WAIT_POLICY", "PASSIVE")
    try:
        import small_gicp
    except ImportError as error:
        raise missing_extra("registration.method: gicp", "small_gicp", "gicp") from error
    return small_gicp
