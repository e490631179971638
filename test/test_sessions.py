"""A growing map keeps its lattice and room ids; clouds and transforms find their way into it."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from test.helpers import box_room, moved, yaw_transform
from test.helpers_bags import START, cloud, flat, transforms
from test.helpers_sessions import flat_map, session
from topometric_ros.io.pointcloud2 import CloudError
from topometric_ros.runtime.agent_input import AgentInput, InputError
from topometric_ros.runtime.extractor_session import ExtractorSession, SessionError
from topometric_ros.runtime.room_ids import keep_room_ids, renumbered

SECOND = 1_000_000_000


def test_a_growing_map_keeps_its_lattice_and_the_ids_of_its_rooms() -> None:
    one = session()
    one.add_map_cloud(flat(), "map", 1 * SECOND)
    first = one.extract().map
    annex = box_room((13, 0, 0), (5, 7, 2.6), (("x-", 3.0),), step=0.06)
    doors = flat()[~((abs(flat()[:, 0] - 13) < 0.01) & (abs(flat()[:, 1] - 3) < 0.45))]
    one.add_map_cloud(np.concatenate([doors, annex]), "map", 2 * SECOND)
    second = one.extract().map
    assert (first.session, first.sequence) == ("robot1-0", 1)
    assert (second.session, second.sequence) == ("robot1-0", 2)
    assert second.origin == first.origin
    np.testing.assert_array_equal(second.T_level_input, first.T_level_input)
    assert second.stamp == 2 * SECOND
    assert len(second.rooms) > len(first.rooms)
    before = {room.id: np.array(room.centroid) for room in first.rooms}
    after = {room.id: np.array(room.centroid) for room in second.rooms}
    assert before.keys() <= after.keys()
    for room_id, centroid in before.items():
        assert np.linalg.norm(after[room_id] - centroid) < 0.5


def test_rooms_keep_their_ids_however_an_extraction_numbers_them() -> None:
    m = flat_map("robot1")
    ids = [room.id for room in m.rooms]
    assert len(ids) >= 2
    shuffled = renumbered(m, dict(zip(ids, ids[1:] + ids[:1], strict=True)))
    back, next_id = keep_room_ids(m, shuffled, 50)
    np.testing.assert_array_equal(back.room, m.room)
    assert [room.id for room in back.rooms] == sorted(ids)
    assert next_id == 50
    for entry in m.descriptors:
        np.testing.assert_array_equal(back.descriptor(entry.name).values, entry.values)


def test_a_room_never_seen_before_gets_a_new_id() -> None:
    m = flat_map("robot1")
    known = renumbered(m, {room.id: room.id + 20 for room in m.rooms})
    gone = m.rooms[0].id + 20
    room = np.where(known.room == gone, -1, known.room).astype(np.int32)
    less = dataclasses.replace(
        known,
        room=room,
        rooms=tuple(r for r in known.rooms if r.id != gone),
        passages=tuple(p for p in known.passages if gone not in p.rooms),
        descriptors=(),
    )
    again, next_id = keep_room_ids(less, m, 90)
    assert 90 in {r.id for r in again.rooms}
    assert next_id == 91


def test_the_up_axis_becomes_a_part_of_the_map_s_level_transform() -> None:
    one = session(up="y")
    points = flat()[:, [0, 2, 1]] * (1, 1, -1)
    one.add_map_cloud(points, "map", 0)
    m = one.extract().map
    assert len(m.rooms) >= 3
    np.testing.assert_allclose(m.T_level_input[:3, :3] @ (0, 1, 0), (0, 0, 1), atol=0.02)
    second = one.extract().map
    np.testing.assert_allclose(second.T_level_input, m.T_level_input, atol=1e-12)


def test_scans_make_the_same_map_as_the_whole_cloud() -> None:
    scans, whole = session(), session()
    whole.add_map_cloud(flat(), "map", 0)
    T_map_sensor = yaw_transform(0.7, (3, 2, 1))
    for part in np.array_split(flat(), 4):
        scans.add_scan(moved(part, np.linalg.inv(T_map_sensor)), "map", 0, T_map_sensor)
    one, two = scans.extract().map, whole.extract().map
    assert len(one.rooms) == len(two.rooms)
    assert abs(len(one.voxels) - len(two.voxels)) < 0.01 * len(two.voxels)


def test_a_session_without_input_says_so_and_dropped_points_are_told() -> None:
    one = session()
    with pytest.raises(SessionError, match="robot1: no cloud with finite points"):
        one.extract()
    one.add_map_cloud(flat(), "map", 0, dropped=7)
    assert one.extract().map.warnings[0] == "7 points were not finite and were dropped"


def test_a_reset_and_another_map_frame_begin_a_new_session() -> None:
    one = session()
    one.add_map_cloud(flat(), "map", 0)
    one.reset()
    assert (one.session, one.has_input) == ("robot1-1", False)
    one.add_map_cloud(flat(), "map", 0)
    one.add_map_cloud(flat(), "other", 0)
    assert (one.session, one.frame_id, one.counts.map_clouds) == ("robot1-2", "other", 1)


def test_a_frame_that_gets_its_name_later_makes_another_map() -> None:
    one = session()
    one.add_map_cloud(flat(), "", 0)
    one.extract()
    one.add_map_cloud(flat(), "map", 0)
    assert one.change() == 1.0
    assert (one.extract().map.frame_id, one.session) == ("map", "robot1-0")


def test_a_cloud_below_the_map_s_frame_is_a_scan() -> None:
    one = AgentInput(session())
    one.add_transforms(transforms(("map", "odom", np.eye(4)), stamp=START), True)
    moving = transforms(("odom", "lidar", yaw_transform(0.1, (1, 0, 0))), stamp=START)
    one.add_transforms(moving, False)
    one.add_cloud(cloud(flat(), "lidar", START))
    one.add_cloud(cloud(flat(), "map", START))
    counts = one.session.counts
    assert (counts.scans, counts.map_clouds, one.session.frame_id) == (1, 1, "map")


@pytest.mark.parametrize(("mode", "scans"), [("map", 0), ("scan", 1)])
def test_the_mode_overrides_what_tf_says(mode: str, scans: int) -> None:
    one = AgentInput(session(), mode)
    one.add_transforms(transforms(("map", "lidar", np.eye(4)), stamp=START), True)
    one.add_cloud(cloud(flat(), "lidar", START))
    assert one.session.counts.scans == scans
    with pytest.raises(InputError, match="expected one of auto, map, scan, got 'fast'"):
        AgentInput(session(), "fast")


def test_a_scan_waits_for_its_transform() -> None:
    one = AgentInput(session(), "scan")
    one.add_cloud(cloud(flat(), "lidar", START + SECOND))
    assert one.session.counts.scans == 0
    for k in (0, 2):
        later = transforms(("map", "lidar", np.eye(4)), stamp=START + k * SECOND)
        one.add_transforms(later, False)
    assert (one.session.counts.scans, one.skipped_count) == (1, 0)


def test_scans_that_are_registered_already_need_no_tf() -> None:
    one = AgentInput(session(), "scan", map_frame="camera_init")
    one.add_cloud(cloud(flat(), "camera_init", START))
    one.add_cloud(cloud(flat(), "camera_init", START + SECOND))
    assert (one.session.counts.scans, one.session.frame_id) == (2, "camera_init")


def test_a_scan_whose_transform_never_comes_is_skipped_and_counted() -> None:
    one = AgentInput(session(), "scan", waiting=2)
    for k in range(3):
        one.add_cloud(cloud(flat()[:10], "lidar", START + k))
    assert (one.skipped_count, one.overflowed) == (1, 1)
    one.finish()
    assert (one.skipped_count, one.overflowed) == (3, 1)
    assert "no frame lidar on /tf" in one.skipped[-1]


def test_a_scan_that_waits_too_long_names_the_frame_that_is_missing() -> None:
    one = AgentInput(session(), "scan", map_frame="map")
    one.add_transforms(transforms(("odom", "base", np.eye(4)), stamp=START), True)
    one.add_cloud(cloud(flat()[:10], "base", START))
    assert (one.waiting, one.waits_for) == (1, "no frame map on /tf; known: base, odom")
    one.expire(100.0, 5.0)
    one.expire(104.0, 5.0)
    assert (one.waiting, one.skipped_count) == (1, 0)
    one.expire(105.5, 5.0)
    assert (one.waiting, one.waits_for) == (0, "")
    assert one.skipped == ["a scan waited 5 s: no frame map on /tf; known: base, odom"]
    assert one.session.counts.scans == 0


def ghost_session(frame: str, sensor_frame: str = "") -> ExtractorSession:
    """Return a session of one scan of two walls in a row, then of some without the nearer one."""
    one = session()
    clouds = AgentInput(one, "scan", map_frame="map", sensor_frame=sensor_frame)
    T = yaw_transform(0.0, (0.0, 0.0, 1.0))
    clouds.add_transforms(transforms(("map", "lidar", T), stamp=START), True)
    y, z = (axis.ravel() for axis in np.meshgrid(np.linspace(-1, 1, 80), np.linspace(-0.9, 1, 80)))
    far = np.stack([np.full(len(y), 6.0), 2 * y, 2 * z], axis=1)
    near = far[np.abs(y) < 0.5] / 2
    T_cloud = T if frame == "map" else np.eye(4)
    for k, points in enumerate([near, far, far, far, far]):
        clouds.add_cloud(cloud(moved(points, T_cloud), frame, START + k))
    return one


def test_what_scans_look_through_is_dropped_where_the_sensor_is_known() -> None:
    assert near_points(ghost_session("lidar")) == 0
    assert near_points(ghost_session("map", "lidar")) == 0
    assert near_points(ghost_session("map")) > 200, "whoever placed the cloud keeps the sensor's"


def near_points(one: ExtractorSession) -> int:
    points = one._points()
    assert np.count_nonzero(points[:, 0] > 5) > 2000
    return int(np.count_nonzero(points[:, 0] < 4))


def test_only_what_came_or_went_is_a_change() -> None:
    one = session()
    assert one.change() == 1.0
    one.add_map_cloud(flat(), "map", 0)
    one.extract()
    assert one.change() == 0.0
    one.add_map_cloud(flat()[::-1].copy(), "map", 1)
    assert one.change() == 0.0
    one.add_map_cloud(flat()[flat()[:, 0] < 10], "map", 2)
    assert 0.15 < one.change() < 0.5
    one.add_scan(flat() + (0, 0, 20), "map", 3, np.eye(4))
    assert one.change() == 1.0


def test_clouds_taken_for_maps_before_tf_spoke_are_forgotten() -> None:
    one = AgentInput(session())
    one.add_cloud(cloud(flat(), "lidar", START))
    assert one.session.counts.map_clouds == 1
    one.add_transforms(transforms(("map", "lidar", np.eye(4)), stamp=START), True)
    one.add_cloud(cloud(flat(), "lidar", START))
    assert (one.session.counts.map_clouds, one.session.counts.scans) == (0, 1)


def test_a_reset_forgets_waiting_scans_and_what_clouds_were_taken_for() -> None:
    one = AgentInput(session())
    one.add_cloud(cloud(flat(), "lidar", START))
    one.reset()
    assert one.session.session == "robot1-1"
    one.add_transforms(transforms(("map", "lidar", np.eye(4)), stamp=START + SECOND), False)
    one.add_cloud(cloud(flat(), "lidar", START + 2 * SECOND))
    one.reset()
    one.add_transforms(transforms(("map", "lidar", np.eye(4)), stamp=START + 3 * SECOND), False)
    assert (one.session.session, one.session.counts.scans) == ("robot1-2", 0)


def test_a_cloud_that_cannot_be_used_changes_nothing() -> None:
    one = AgentInput(session())
    with pytest.raises(CloudError, match="point_step"):
        one.add_cloud(cloud(flat(), "map", START, point_step=8))
    with pytest.raises(CloudError, match="no finite point of 3"):
        one.add_cloud(cloud(np.full((3, 3), np.nan), "map", START))
    assert not one.session.has_input
