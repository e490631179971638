"""What every way of registering two surfaces takes and gives, and the errors it may raise.

A method is a function of the type :class:`Registrar`. `fusion.registration` names those that there
are; a new one, such as a learned one, is a function in a file of its own and a line there.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from topometric_ros.configuration import needs_extras, parameter
from topometric_ros.errors import ConfigurationError, TopometricError
from topometric_ros.fusion.poses import Transform
from topometric_ros.fusion.surface import Surface

METHODS = ("gravity_icp", "axis_icp", "icp", "gicp", "fpfh_ransac", "deep_closest_point")
"""Names of the ways to register; see :mod:`topometric_ros.fusion.registration`."""


class RegistrationError(TopometricError):
    """Two surfaces that share too little to be registered."""


def _some_direction(axis: tuple[float, ...]) -> None:
    if np.linalg.norm(axis) < 1e-9:
        raise ConfigurationError(f"expected some direction, got {list(axis)}")


@dataclass(frozen=True)
class RegistrationConfig:
    """How surfaces are registered and how sure the result is held to be."""

    method: str = parameter(
        "gravity_icp",
        "gravity_icp: point-to-plane ICP, yaw and translation; axis_icp: the same about `axis`; "
        "icp: about all axes, where tilt is to be estimated; gicp: generalised ICP about all axes "
        "(extra `gicp`); fpfh_ransac: features and RANSAC without a first pose, then gravity_icp; "
        "deep_closest_point: counterparts from a network (extra `learned`), then gravity_icp.",
        choices=METHODS,
        rule=needs_extras(
            {
                "gicp": ("small_gicp", "gicp"),
                "deep_closest_point": ("onnxruntime", "learned"),
            }
        ),
    )
    axis: tuple[float, ...] = parameter(
        (0.0, 0.0, 1.0),
        "Axis of the level frame that axis_icp turns about: x, y, z.",
        count=(3, 3),
        rule=_some_direction,
    )
    gates: tuple[float, ...] = parameter(
        (0.4, 0.25, 0.15, 0.08),
        "Largest distances of a pair of points from its plane, one round of ICP each; none is "
        "taken below half a voxel.",
        unit="m",
        minimum=0.001,
        maximum=100.0,
        count=(1, None),
    )
    steps: int = parameter(10, "Largest number of steps in a round.", minimum=1, maximum=100)
    points: int = parameter(
        8000, "Points drawn from what the source shares with the target.", minimum=100
    )
    seed: int = parameter(0, "Seed of the draw of the source's points.", minimum=0)
    normals_cosine: float = parameter(
        0.6, "Smallest cosine between the normals of a pair.", minimum=0.0, maximum=1.0
    )
    unsided_weight: float = parameter(
        0.1,
        "Weight of a pair of which it is not known that both points were seen from one side.",
        minimum=0.0,
        maximum=1.0,
    )
    feature_size: float = parameter(
        0.2, "Edge of the cells whose features fpfh_ransac matches.", unit="m", minimum=0.05,
        maximum=1.0,
    )  # fmt: skip
    smallest_pairs: int = parameter(50, "Fewer pairs than this register nothing.", minimum=10)
    gravity_deviation: float = parameter(
        0.3,
        "Standard deviation of roll and pitch, which are taken from the agents and not estimated.",
        unit="deg",
        minimum=0.0,
        maximum=10.0,
    )
    correlated_area: float = parameter(
        0.25,
        "Area of surface whose errors are one and the same: it counts as one measurement.",
        unit="m²",
        minimum=0.0001,
        maximum=100.0,
    )


@dataclass(frozen=True)
class Registration:
    """The transform that ICP ends at.

    `rmse` (m) is of the pairs' distances to their planes within the last gate, `inliers` the share
    of the points drawn that have such a pair. `covariance` (6, 6) over (x, y, z, roll, pitch, yaw)
    in m and rad: translation in the target frame, small turns about its axes. Turns that a method
    holds have the variance of the agents' gravity, without correlations.
    """

    T_target_source: Transform
    rmse: float
    inliers: float
    covariance: NDArray[np.float64]


class Registrar(Protocol):
    """A way to refine, or to find, the pose of one surface on another.

    Raises RegistrationError where the surfaces share too little.
    """

    def __call__(
        self,
        source: Surface,
        target: Surface,
        T_init: Transform,
        config: RegistrationConfig,
        tree: cKDTree | None = None,
    ) -> Registration:
        """Return T_target_source; `tree` is that of the target's points, if there is one."""
