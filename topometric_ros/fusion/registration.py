"""Registration: one protocol, several ways, chosen by `registration.method`.

    gravity_icp   point-to-plane ICP, yaw and translation: the default
    axis_icp      the same, turning about any one axis
    icp           the same about all axes, where the tilt is to be estimated
    gicp          generalised ICP about all axes (extra `gicp`)
    fpfh_ransac   features and a RANSAC under gravity, from no first pose; then gravity_icp
    deep_closest_point
                  counterparts from a network, SVD about the vertical (extra `learned`); then
                  gravity_icp

A further way is a :class:`Registrar` in a file of its own and a line here.
"""

from __future__ import annotations

from scipy.spatial import cKDTree

from topometric_ros.fusion.deep_closest_point import deep_closest_point
from topometric_ros.fusion.fpfh_ransac import fpfh_ransac
from topometric_ros.fusion.gicp import gicp
from topometric_ros.fusion.icp import axis_icp, full_icp, gravity_icp
from topometric_ros.fusion.poses import Transform
from topometric_ros.fusion.registration_config import (
    METHODS,
    Registrar,
    Registration,
    RegistrationConfig,
    RegistrationError,
)
from topometric_ros.fusion.surface import Surface

__all__ = [
    "METHODS",
    "REGISTRARS",
    "Registrar",
    "Registration",
    "RegistrationConfig",
    "RegistrationError",
    "register",
]

_WAYS = (gravity_icp, axis_icp, full_icp, gicp, fpfh_ransac, deep_closest_point)

REGISTRARS: dict[str, Registrar] = dict(zip(METHODS, _WAYS, strict=True))


def register(
    source: Surface,
    target: Surface,
    T_init: Transform,
    config: RegistrationConfig,
    tree: cKDTree | None = None,
) -> Registration:
    """Refine the pose of one surface on another, in the way that the configuration names.

    Parameters
    ----------
    source, target : Surface, each in its own gravity-aligned frame
    T_init : (4, 4) float64, T_target_source to start from, rotation about z only
    config : RegistrationConfig
    tree : the tree of the target's points, if the caller has one

    Raises
    ------
    RegistrationError
        Fewer pairs than `smallest_pairs` at the start or under way.
    ConfigurationError
        The way asked for is not installed, or its parameters are no numbers.
    """
    return REGISTRARS[config.method](source, target, T_init, config, tree)
