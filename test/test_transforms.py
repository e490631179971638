"""The transform buffer answers what it was told, and says what it was not."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from test.helpers import yaw_transform
from test.helpers_bags import transforms
from topometric_ros.runtime.transforms import (
    TransformBuffer,
    TransformError,
    TransformNotYetError,
    interpolate,
)

SECOND = 1_000_000_000


def moving_robot() -> TransformBuffer:
    """A robot that drives and turns from 10 s to 12 s, with a sensor mounted on it."""
    buffer = TransformBuffer()
    buffer.add("map", "odom", 0, yaw_transform(0.5, (10, 0, 0)), static=True)
    buffer.add("base", "lidar", 0, yaw_transform(0.0, (0, 0, 1)), static=True)
    buffer.add("odom", "base", 10 * SECOND, yaw_transform(0.0, (0, 0, 0)))
    buffer.add("odom", "base", 12 * SECOND, yaw_transform(1.0, (4, 0, 0)))
    return buffer


def test_a_chain_is_looked_up_through_the_tree() -> None:
    buffer = moving_robot()
    expected = yaw_transform(0.5, (10, 0, 0)) @ yaw_transform(0.5, (2, 0, 1))
    np.testing.assert_allclose(buffer.lookup("map", "lidar", 11 * SECOND), expected, atol=1e-12)
    back = buffer.lookup("lidar", "map", 11 * SECOND)
    np.testing.assert_allclose(back @ expected, np.eye(4), atol=1e-12)


def test_siblings_meet_at_their_common_ancestor() -> None:
    buffer = TransformBuffer()
    buffer.add("map", "a", 0, yaw_transform(0.2, (1, 0, 0)), static=True)
    buffer.add("map", "b", 0, yaw_transform(0.9, (0, 3, 0)), static=True)
    expected = np.linalg.inv(yaw_transform(0.2, (1, 0, 0))) @ yaw_transform(0.9, (0, 3, 0))
    np.testing.assert_allclose(buffer.lookup("a", "b", 5), expected, atol=1e-12)


def test_a_frame_lies_on_itself() -> None:
    np.testing.assert_array_equal(moving_robot().lookup("map", "map", 3), np.eye(4))


@given(st.floats(0, 1), st.floats(-3, 3), st.floats(-3, 3))
@settings(max_examples=30)
def test_interpolation_lies_between_and_is_symmetric(share: float, a: float, b: float) -> None:
    first, second = yaw_transform(a, (1, 2, 3)), yaw_transform(b, (3, 2, 1))
    there = interpolate(first, second, share)
    back = interpolate(second, first, 1 - share)
    if abs(abs(a - b) - np.pi) > 1e-3:  # Half a turn has two ways round.
        np.testing.assert_allclose(there, back, atol=1e-9)
    np.testing.assert_allclose(there[:3, :3] @ there[:3, :3].T, np.eye(3), atol=1e-9)


def test_a_missing_frame_is_named_with_those_known() -> None:
    with pytest.raises(TransformNotYetError, match="no frame camera on /tf; known: base, lidar"):
        moving_robot().lookup("map", "camera", 11 * SECOND)


def test_two_trees_are_told_apart() -> None:
    buffer = moving_robot()
    buffer.add("other/map", "other/base", 0, np.eye(4), static=True)
    with pytest.raises(TransformNotYetError, match="roots other/map and map"):
        buffer.lookup("map", "other/base", 0)


def test_a_moment_outside_the_known_range_is_refused_with_the_range() -> None:
    buffer = moving_robot()
    with pytest.raises(TransformNotYetError, match=r"13\.000 s: known from 10\.000 to 12\.000 s"):
        buffer.lookup("map", "lidar", 13 * SECOND)
    with pytest.raises(TransformError, match=r"9\.000 s: known from") as caught:
        buffer.lookup("map", "lidar", 9 * SECOND)
    assert not isinstance(caught.value, TransformNotYetError)


def test_transforms_may_arrive_in_any_order() -> None:
    buffer, shuffled = TransformBuffer(), TransformBuffer()
    poses = [(k * SECOND, yaw_transform(0.1 * k, (k, 0, 0))) for k in range(6)]
    for stamp, T in poses:
        buffer.add("map", "base", stamp, T)
    for k in (3, 0, 5, 1, 4, 2, 3):
        shuffled.add("map", "base", *poses[k])
    for stamp in range(0, 5 * SECOND, SECOND // 3):
        np.testing.assert_array_equal(
            buffer.lookup("map", "base", stamp), shuffled.lookup("map", "base", stamp)
        )


def test_history_is_bounded_where_it_is_asked_for() -> None:
    buffer = TransformBuffer(history=2 * SECOND)
    for k in range(10):
        buffer.add("map", "base", k * SECOND, np.eye(4))
    buffer.lookup("map", "base", 7 * SECOND)
    with pytest.raises(TransformError, match=r"known from 7\.000 to 9\.000"):
        buffer.lookup("map", "base", 6 * SECOND)


def test_a_clock_set_back_begins_a_new_history() -> None:
    buffer = TransformBuffer(history=2 * SECOND)
    buffer.add("map", "base", 100 * SECOND, np.eye(4))
    T = yaw_transform(0.1, (1, 0, 0))
    for k in range(3):
        buffer.add("map", "base", k * SECOND, T)
    np.testing.assert_allclose(buffer.lookup("map", "base", SECOND), T, atol=1e-12)
    with pytest.raises(TransformNotYetError, match=r"known from 0\.000 to 2\.000"):
        buffer.lookup("map", "base", 100 * SECOND)


def test_the_map_frame_is_the_nearest_map_above_else_the_root() -> None:
    buffer = moving_robot()
    assert buffer.map_frame("lidar") == "map"
    buffer.add("earth", "map", 0, np.eye(4), static=True)
    assert buffer.map_frame("lidar") == "map"
    buffer.add("fleet/map", "earth", 0, np.eye(4), static=True)
    assert buffer.map_frame("lidar") == "map"
    buffer.add("world", "r2/odom", 0, np.eye(4), static=True)
    assert buffer.map_frame("r2/odom") == "world"
    assert buffer.map_frame("unknown") == "unknown"


def test_a_circle_of_frames_is_an_error_and_no_loop() -> None:
    buffer = TransformBuffer()
    buffer.add("a", "b", 0, np.eye(4), static=True)
    buffer.add("b", "a", 0, np.eye(4), static=True)
    with pytest.raises(TransformError, match="form a circle"):
        buffer.lookup("a", "b", 0)


def test_an_impossible_transform_costs_only_itself() -> None:
    buffer = TransformBuffer()
    message = transforms(("map", "odom", np.eye(4)), ("odom", "base", np.eye(4)), stamp=0)
    message.transforms[0].transform.rotation.w = 0.0
    assert len(buffer.add_message(message, static=True)) == 1
    assert buffer.frames() == {"odom", "base"}


def test_messages_are_read_and_impossible_ones_refused() -> None:
    buffer = TransformBuffer()
    T = yaw_transform(0.7, (1, 2, 3))
    buffer.add_message(transforms(("/map", "base", T), stamp=7 * SECOND), static=False)
    np.testing.assert_allclose(buffer.lookup("map", "base", 7 * SECOND), T, atol=1e-12)
    broken = transforms(("map", "base", T), stamp=8 * SECOND)
    broken.transforms[0].transform.rotation.w = float("nan")
    (refused,) = buffer.add_message(broken, static=False)
    assert refused == "base in map: a rotation quaternion of length nan, expected 1"
    broken.transforms[0].transform.rotation.w = 0.0
    broken.transforms[0].transform.rotation.z = 0.0
    (refused,) = buffer.add_message(broken, static=False)
    assert "expected 1" in refused
    with pytest.raises(TransformError, match="makes no tree"):
        buffer.add("map", "map", 0, np.eye(4))
    with pytest.raises(TransformError, match="finite"):
        buffer.add("map", "base", 0, np.full((4, 4), np.nan))
    with pytest.raises(TransformError, match="not a rotation"):
        buffer.add("map", "base", 0, np.diag([2.0, 2, 2, 1]))
