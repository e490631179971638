"""Tilted clouds are levelled by their floors; level ones are left alone, whatever slopes there."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from test.helpers import box_room, moved, yaw_transform
from topometric_ros.extraction.errors import ExtractionError
from topometric_ros.extraction.level import LevelConfig, estimate_level, no_floor


def _turn(axis: tuple[float, float, float], angle: float) -> NDArray[np.float64]:
    """Return the (4, 4) turn about an axis by `angle` degrees (Rodrigues)."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    K = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    a = np.radians(angle)
    T = np.eye(4)
    T[:3, :3] += np.sin(a) * K + (1 - np.cos(a)) * K @ K
    return T


def _slope(x: float, y: float, z: float, rise: float) -> NDArray[np.float64]:
    """A plane of x by y metres that starts at height z and rises by `rise` degrees along x."""
    u, v = np.meshgrid(np.arange(0, x, 0.06), np.arange(0, y, 0.06))
    return np.stack([u.ravel(), v.ravel(), z + u.ravel() * np.tan(np.radians(rise))], -1)


def _stairs(steps: int) -> NDArray[np.float64]:
    treads = [_slope(0.28, 1.2, 0.18 * i, 0.0) + (0.28 * i, 1.0, 0.0) for i in range(steps)]
    return np.concatenate(treads)


_HOUSE = box_room((0, 0, 0), (8, 6, 2.6), (("x+", 3.0),), step=0.06)


@pytest.mark.parametrize("angle", [2.0, 3.0, 8.0, 14.0])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0.3, -1, 0)])
def test_a_tilt_is_undone_to_a_twentieth_of_a_degree(
    angle: float, axis: tuple[float, float, float]
) -> None:
    T = _turn(axis, angle)
    level = estimate_level(moved(_HOUSE, T), LevelConfig())
    up = (level.T_level_input @ T)[:3, 2]
    assert np.degrees(np.arccos(min(1.0, up[2]))) < 0.05
    assert np.degrees(level.tilt) == pytest.approx(angle, abs=0.05)
    assert f"{angle:.1f}°" in str(level.findings[0])
    R = level.T_level_input[:3, :3]
    assert np.allclose(R @ R.T, np.eye(3))
    assert np.linalg.det(R) == pytest.approx(1.0)


@pytest.mark.parametrize(
    "extra",
    [
        np.zeros((0, 3)),
        _slope(8, 6, 2.7, 12.0),
        _slope(10, 3, -1.5, 6.0) + (8.0, 0.0, 0.0),
        _stairs(14),
    ],
    ids=["alone", "sloped roof", "ramp", "stairs"],
)
@pytest.mark.parametrize("yaw", [0.0, 0.6])
def test_a_level_house_stays_as_it_is(extra: NDArray[np.float64], yaw: float) -> None:
    points = moved(np.concatenate([_HOUSE, extra]), yaw_transform(yaw, (40.0, -7.0, 3.3)))
    points += np.random.default_rng(0).normal(0, 0.01, points.shape)
    level = estimate_level(points, LevelConfig())
    assert np.array_equal(level.T_level_input, np.eye(4))
    assert level.tilt == 0.0
    assert level.findings == ()


def test_a_long_corridor_stays_as_it_is() -> None:
    corridor = box_room((0, 0, 0), (40, 2, 2.6), step=0.08)
    level = estimate_level(corridor + (0.03, 0.04, 0.0), LevelConfig())
    assert np.array_equal(level.T_level_input, np.eye(4))


@pytest.mark.parametrize("angle", [0.25, 0.6, 1.2])
def test_a_small_tilt_is_taken_out_where_the_walls_lean_too(angle: float) -> None:
    T = _turn((1, 0.4, 0), angle)
    noise = np.random.default_rng(0).normal(0, 0.01, _HOUSE.shape)
    level = estimate_level(moved(_HOUSE + noise, T), LevelConfig(smallest_tilt=0.2))
    assert np.degrees(np.arccos(min(1.0, (level.T_level_input @ T)[2, 2]))) < 0.06


def test_a_small_tilt_of_a_small_map_is_told_and_left() -> None:
    points = moved(_HOUSE, _turn((1, 0, 0), 0.7))
    level = estimate_level(points, LevelConfig())
    assert np.array_equal(level.T_level_input, np.eye(4))
    assert "0.7°" in level.findings[0].message
    assert "level.smallest_tilt" in level.findings[0].advice


def test_a_small_tilt_of_a_long_map_is_taken_out() -> None:
    hall = box_room((0, 0, 0), (60, 16, 2.6), step=0.09)
    T = _turn((0.2, 1, 0), 0.6)
    level = estimate_level(moved(hall, T), LevelConfig())
    assert np.degrees(np.arccos(min(1.0, (level.T_level_input @ T)[2, 2]))) < 0.06


def test_a_sloping_floor_between_upright_walls_is_told_and_left() -> None:
    sloping = _HOUSE.copy()
    sloping[:, 2] += sloping[:, 0] * np.tan(np.radians(1.2))
    level = estimate_level(sloping, LevelConfig())
    assert np.array_equal(level.T_level_input, np.eye(4))
    assert "1.2°" in level.findings[0].message
    assert "walls stand more upright" in level.findings[0].message


def test_floors_alone_are_believed_from_a_larger_tilt_on() -> None:
    floor = _slope(12, 8, 0.0, 1.2)
    level = estimate_level(floor, LevelConfig())
    assert level.tilt == 0.0
    assert "no walls confirm it" in level.findings[0].message
    assert estimate_level(floor, LevelConfig(trusted_tilt=1.0)).tilt > 0.0


def test_levelling_can_be_switched_off() -> None:
    level = estimate_level(moved(_HOUSE, _turn((1, 0, 0), 3.0)), LevelConfig(enabled=False))
    assert np.array_equal(level.T_level_input, np.eye(4))


def test_another_axis_with_larger_layers_is_named() -> None:
    on_its_side = _HOUSE[:, [1, 2, 0]]
    (finding,) = estimate_level(on_its_side, LevelConfig()).findings
    assert "use --up y" in finding.advice
    with pytest.raises(ExtractionError, match=r"no floor found with z up.*use --up y"):
        estimate_level(on_its_side, LevelConfig(refusal_area=20.0, refusal=2.0))
    assert estimate_level(on_its_side, LevelConfig(check_up=False)).findings == ()


def test_without_a_floor_the_option_is_named() -> None:
    assert "use --up x" in str(no_floor(_slope(4, 4, 0, 0)[:, [2, 0, 1]], LevelConfig()))
    assert "--up x or --up y" in str(no_floor(_slope(1, 1, 0, 0), LevelConfig()))


def test_a_cloud_too_small_for_any_floor_is_asked_whether_it_is_in_metres() -> None:
    assert "is it in metres (--scale)?" in str(no_floor(np.zeros((1, 3)), LevelConfig()))
    assert "0.00894 m x" in str(no_floor(_slope(9, 4, 0, 0) / 1000, LevelConfig()))
