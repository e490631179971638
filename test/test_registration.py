"""Fine registration under gravity, and the consensus of matched rooms."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from test.helpers import box_room, moved, yaw_transform
from test.helpers_matching import (
    A_ROOMS,
    B_ROOMS,
    T_A_B,
    T_BUILDING_A,
    T_BUILDING_B,
    agent_map,
    error_of,
)
from topometric_ros.alignment import RoomMatch
from topometric_ros.configuration import with_values
from topometric_ros.errors import ConfigurationError
from topometric_ros.extraction.config import extraction_preset
from topometric_ros.extraction.pipeline import extract
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.consensus import ConsensusConfig, clusters, consensus, mean_pose
from topometric_ros.fusion.poses import inverse
from topometric_ros.fusion.registration import RegistrationConfig, RegistrationError, register
from topometric_ros.fusion.surface import Surface, surface_of
from topometric_ros.topometric_map import TopometricMap

OFF = yaw_transform(np.radians(1.5), (0.1, -0.12, 0.06))
"""How far off registration starts: what a 0.1 m raster leaves, twice over."""


@cache
def maps(noise: float = 0.0) -> tuple[TopometricMap, TopometricMap]:
    """Return the maps of two agents that share a corridor and two rooms."""
    a = agent_map("a", A_ROOMS, T_BUILDING_A, noise=noise)
    return a, agent_map("b", B_ROOMS, T_BUILDING_B, noise=noise, seed=1)


def test_a_moved_copy_is_found_to_the_last_millimetre() -> None:
    a, _ = maps()
    target = surface_of(a)
    T = yaw_transform(0.9, (5.0, 1.0, -0.4))
    back = inverse(T)
    source = Surface(
        moved(target.points, back), target.normals @ back[:3, :3].T, target.sided, target.spacing
    )
    result = register(source, target, OFF @ T, RegistrationConfig())
    shift, turn = error_of(result.T_target_source, T, source.points)
    assert shift < 0.002
    assert turn < 0.02
    assert result.inliers > 0.95


@pytest.mark.parametrize(("noise", "within"), [(0.0, 0.012), (0.02, 0.01)])
def test_two_agents_are_registered_to_millimetres(noise: float, within: float) -> None:
    # Without noise all of a wall is rounded alike, by up to an eighth of a voxel.
    a, b = maps(noise)
    result = register(surface_of(b), surface_of(a), T_A_B @ OFF, RegistrationConfig())
    shift, turn = error_of(result.T_target_source, T_A_B, b.centres())
    assert shift < within
    assert turn < 0.1
    assert result.rmse < 0.03


def tilted(source: Surface, T: NDArray[np.float64]) -> Surface:
    """Return a surface in another frame: its points and normals moved by `T`."""
    turn = T[:3, :3].T
    return Surface(moved(source.points, T), source.normals @ turn, source.sided, source.spacing)


@pytest.mark.parametrize("method", ["icp", "gicp", "axis_icp"])
def test_a_tilt_is_found_where_it_is_to_be_estimated(method: str) -> None:
    if method == "gicp":
        pytest.importorskip("small_gicp")
    a, b = maps(0.01)
    tilt = np.eye(4)
    tilt[:3, :3] = Rotation.from_rotvec(np.radians([2.0, 0.0, 0.0])).as_matrix()
    T_true = tilt @ T_A_B
    target = tilted(surface_of(a), tilt)
    kept = RegistrationConfig()
    held = register(surface_of(b), target, T_A_B, kept)
    assert error_of(held.T_target_source, T_true, b.centres())[1] > 1.9
    config = RegistrationConfig(method=method, axis=(1.0, 0.0, 0.0))
    result = register(surface_of(b), target, T_A_B, config)
    shift, turn = error_of(result.T_target_source, T_true, b.centres())
    assert shift < 0.03
    assert turn < 0.2
    assert np.linalg.eigvalsh(result.covariance).min() > 0
    assert result.covariance[3, 3] < held.covariance[3, 3] / 4


def test_features_find_a_pose_from_nowhere() -> None:
    a, b = maps(0.01)
    far = yaw_transform(2.0, (40.0, -9.0, 3.0))
    config = RegistrationConfig(method="fpfh_ransac")
    found = register(surface_of(b), surface_of(a), far, config)
    shift, turn = error_of(found.T_target_source, T_A_B, b.centres())
    assert shift < 0.02
    assert turn < 0.1


@pytest.mark.parametrize("axis", [[0, 0, 0], [0.0, 1.0], ["up", "0", "0"], [0, 0, np.inf]])
def test_an_axis_that_is_none_is_told(axis: list[object]) -> None:
    with pytest.raises(ConfigurationError, match=r"consensus\.registration\.axis: expected"):
        with_values(MergeConfig(), {"consensus.registration.axis": axis})


@settings(max_examples=3)
@given(yaw=st.floats(-3.1, 3.1), x=st.floats(-20, 20), z=st.floats(-3, 3))
def test_the_result_does_not_depend_on_the_frames(yaw: float, x: float, z: float) -> None:
    a, b = maps(0.01)
    T = yaw_transform(yaw, (x, -x, z))
    source, target = surface_of(b), surface_of(a)
    turned = Surface(
        moved(target.points, T), target.normals @ T[:3, :3].T, target.sided, target.spacing
    )
    here = register(source, target, T_A_B @ OFF, RegistrationConfig(points=1000))
    there = register(source, turned, T @ T_A_B @ OFF, RegistrationConfig(points=1000))
    shift, turn = error_of(inverse(T) @ there.T_target_source, here.T_target_source, source.points)
    assert shift < 1e-4
    assert turn < 1e-2


def test_the_same_input_gives_the_same_bytes() -> None:
    a, b = maps(0.01)
    one, two = (
        register(surface_of(b), surface_of(a), T_A_B @ OFF, RegistrationConfig()) for _ in range(2)
    )
    assert one.T_target_source.tobytes() == two.T_target_source.tobytes()
    assert one.covariance.tobytes() == two.covariance.tobytes()


def test_the_covariance_is_symmetric_positive_and_holds_gravity_apart() -> None:
    a, b = maps(0.01)
    covariance = register(surface_of(b), surface_of(a), T_A_B, RegistrationConfig()).covariance
    np.testing.assert_array_equal(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > 0
    assert np.sqrt(covariance[3, 3]) == pytest.approx(np.radians(0.3))
    assert np.count_nonzero(covariance[3:5]) == 2
    assert 1e-4 < np.sqrt(covariance[0, 0]) < 0.02


def test_a_corridor_is_least_sure_of_its_length() -> None:
    corridor = agent_map("a", (0,), np.eye(4), bare=True)
    walls = surface_of(corridor)
    along = walls.take(np.abs(walls.normals[:, 0]) < 0.3)
    covariance = register(along, along, np.eye(4), RegistrationConfig()).covariance
    assert covariance[0, 0] > 25 * covariance[1, 1]


def test_a_wall_does_not_attract_its_other_side() -> None:
    """Two faces 0.12 m apart, free on opposite sides, stay two faces."""
    grid = np.stack(np.meshgrid(np.arange(0, 4, 0.1), np.arange(0, 2.5, 0.1)), -1).reshape(-1, 2)
    n = len(grid)
    face = np.column_stack([grid[:, 0], np.zeros(n), grid[:, 1]])
    north, south = np.tile([0.0, 1.0, 0.0], (n, 1)), np.tile([0.0, -1.0, 0.0], (n, 1))
    known, unknown = np.ones(n, bool), np.zeros(n, bool)
    target = Surface(face, north, known, 0.1)
    with pytest.raises(RegistrationError, match="pairs"):
        register(Surface(face + (0, 0.12, 0), south, known, 0.1), target, np.eye(4),
                 RegistrationConfig())  # fmt: skip
    pulled = register(Surface(face + (0, 0.12, 0), south, unknown, 0.1), target, np.eye(4),
                      RegistrationConfig())  # fmt: skip
    assert pulled.T_target_source[1, 3] == pytest.approx(-0.12, abs=0.01)


def test_normals_of_walls_and_slabs_point_into_their_rooms() -> None:
    a, _ = maps()
    surface = surface_of(a)
    floor = np.abs(surface.points[:, 2] - a.storeys[0].floor_z) < 0.03
    level = floor & (np.abs(surface.normals[:, 2]) > 0.9)
    assert (surface.normals[level, 2] > 0).all()
    high = surface.points[:, 2] - a.storeys[0].floor_z
    wall = (high > 0.5) & (high < 2.0) & (np.abs(surface.normals[:, 2]) < 0.3)
    assert surface.sided[wall].mean() > 0.7
    room = a.room_by_id(2)
    own = wall & (a.room == 2) & surface.sided
    inward = np.array(room.centroid) - surface.points[own]
    assert (np.sum(inward * surface.normals[own], axis=1) > 0).mean() > 0.85


def test_surfaces_that_do_not_meet_are_refused_with_the_number() -> None:
    a, b = maps()
    far = yaw_transform(0.0, (200.0, 0.0, 0.0))
    with pytest.raises(RegistrationError, match="only 0 points"):
        register(surface_of(b), surface_of(a), far, RegistrationConfig())


@pytest.mark.parametrize("gates", [["wide"], [], [0.4, -0.1], 0.4])
def test_gates_that_are_no_lengths_are_refused(gates: object) -> None:
    with pytest.raises(ConfigurationError, match=r"registration\.gates: expected a list of 1 or"):
        with_values(MergeConfig(), {"registration.gates": gates})


def test_an_outlier_is_dropped_before_the_mean() -> None:
    positions = np.array([[0.0, 0, 0], [5.0, 0, 0], [5.0, 5, 0], [0, 5.0, 0]])
    transforms = [yaw_transform(0.01 * k, (1 + 0.02 * k, 0, 0)) for k in (-1, 0, 1)]
    transforms.insert(1, yaw_transform(1.5, (8.0, 0, 0)))
    labels = clusters(transforms, positions, 0.5)
    assert labels.tolist() == [0, 1, 0, 0]
    keep = labels == 0
    mean = mean_pose([T for T, own in zip(transforms, keep, strict=True) if own], positions[keep])
    assert error_of(mean, yaw_transform(0.0, (1.0, 0, 0)), positions)[0] < 0.005


def test_matched_rooms_agree_on_the_transform_and_a_wrong_match_is_dropped() -> None:
    a, b = maps(0.01)
    matches = [RoomMatch(0, 0, 0.1), RoomMatch(2, 2, 0.1), RoomMatch(4, 4, 0.1)]
    wrong = RoomMatch(1, 3, 0.2)
    result = consensus(
        a, b, surface_of(a), surface_of(b), T_A_B @ OFF, [*matches, wrong], ConsensusConfig()
    )
    assert result.dropped == (wrong,)
    assert set(result.kept) == set(matches)
    shift, turn = error_of(result.T_a_b, T_A_B, b.centres())
    assert shift < 0.015
    assert turn < 0.2
    with pytest.raises(RegistrationError, match="none of 1"):
        consensus(a, b, surface_of(a), surface_of(b), T_A_B,
                  [dataclasses.replace(wrong)], ConsensusConfig())  # fmt: skip


def test_one_face_of_a_wall_is_not_pulled_onto_the_other() -> None:
    # Each agent walked one of two rooms and looked through the door into a corner of the other.
    left = box_room((0.0, 0.0, 0.0), (4.0, 6.0, 2.6), doors=(("x+", 0.8),))
    right = box_room((4.16, 0.0, 0.0), (5.0, 6.0, 2.6), doors=(("x-", 0.8),))
    glimpse_a = right[(right[:, 0] < 6.66) & (right[:, 1] < 1.4)]
    glimpse_b = left[(left[:, 0] > 1.5) & (left[:, 1] < 1.4)]
    config = extraction_preset("default")
    a = extract(np.concatenate([left, glimpse_a]), config).map
    b = extract(np.concatenate([right, glimpse_b]), config).map
    result = register(
        surface_of(b), surface_of(a), yaw_transform(0.0, (0.06, 0.0, 0.0)), RegistrationConfig()
    )
    assert np.linalg.norm(result.T_target_source[:3, 3]) < 0.02
