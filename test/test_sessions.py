"""A growing map keeps its lattice and room ids; an alignment changes only for a better one."""

from __future__ import annotations

import dataclasses
from functools import cache

import numpy as np
import pytest

from test.helpers import box_room, moved, yaw_transform
from test.helpers_bags import START, cloud, flat, transforms
from test.helpers_io import random_map
from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.fusion.align import Prepared
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.io.clouds import up_rotation
from topometric_ros.io.pointcloud2 import CloudError
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.runtime.accumulator import PointAccumulator
from topometric_ros.runtime.agent_input import AgentInput, InputError
from topometric_ros.runtime.extractor_session import ExtractorSession, SessionError
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.room_ids import keep_room_ids, renumbered
from topometric_ros.runtime.stability import steadier
from topometric_ros.runtime.transforms import TransformError
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.grid import thin

SECOND = 1_000_000_000


def session(agent: str = "robot1", up: str = "z") -> ExtractorSession:
    names = (f"{agent}-{i}" for i in range(100))
    return ExtractorSession(
        agent, ExtractionConfig(), MatchingConfig(), lambda: next(names), up_rotation(up)
    )


@cache
def flat_map(agent: str, seed: int = 0) -> TopometricMap:
    """Return the flat's map in a frame that depends on the seed."""
    one = session(agent)
    T = yaw_transform(0.4 * seed, (seed, 2.0 * seed, 0.0))
    one.add_map_cloud(moved(flat(), T), f"{agent}/map", 5)
    return one.extract().map


def test_scans_gathered_in_any_batches_give_the_same_means() -> None:
    points = np.random.default_rng(0).normal(size=(3000, 3))
    whole, parts = PointAccumulator(0.3), PointAccumulator(0.3)
    whole.add(points)
    for part in np.array_split(points, 7):
        parts.add(part)
        parts.points()
    np.testing.assert_allclose(whole.points(), parts.points(), atol=1e-12)
    np.testing.assert_allclose(whole.points(), thin(points, 0.3), atol=1e-12)


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
    assert one.skipped_count == 1
    one.finish()
    assert one.skipped_count == 3
    assert "no frame lidar on /tf" in one.skipped[-1]


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


def test_two_maps_of_one_place_are_merged() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    with pytest.raises(SessionError, match="no map was received yet"):
        merger.merge()
    assert merger.add_map(flat_map("b", 1), "b.bag")
    assert merger.add_map(flat_map("a"), "a.bag")
    assert not merger.add_map(flat_map("a"))
    result = merger.merge()
    assert [agent.id for agent in result.agents] == ["a", "b"]
    assert [agent.source for agent in result.agents] == ["a.bag", "b.bag"]
    assert [x.agents for x in result.alignments] == [("a", "b")]


def test_nothing_is_aligned_twice_and_nothing_published_before_it_is_known() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    assert merger.transforms() == {}
    merger.add_map(flat_map("a"))
    merger.add_map(random_map(3, "b"))
    first = merger.merge()
    assert list(merger.transforms()) == ["a"]
    told: list[str] = []
    again = merger.merge(told.append)
    assert not [text for text in told if text.startswith("aligning")]
    assert again.alignments[0] is first.alignments[0] or again.alignments == first.alignments


def test_an_alignment_set_by_hand_holds_until_removed() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    merger.add_map(flat_map("a"))
    merger.add_map(random_map(3, "b"))
    T = yaw_transform(0.3, (1, 2, 0))
    merger.set_alignment("b", "a", np.linalg.inv(T))
    result = merger.merge()
    assert result.alignments[0].status is AlignmentStatus.ACCEPTED
    assert result.alignments[0].reason == "set by hand"
    np.testing.assert_allclose(result.alignments[0].T_a_b, T, atol=1e-12)
    np.testing.assert_allclose(merger.transforms()["b"], T, atol=1e-9)
    assert merger.remove_alignment("a", "b")
    assert not merger.remove_alignment("a", "b")
    assert merger.merge().alignments[0].reason != "set by hand"


def test_an_impossible_alignment_by_hand_is_refused() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    for a, b, T, error, text in (
        ("a", "c", np.eye(4), SessionError, "no agent 'c'; known: a, b"),
        ("a", "a", np.eye(4), SessionError, "needs two agents"),
        ("a", "b", np.zeros((4, 4)), TransformError, "not a rotation"),
        ("a", "b", np.full((4, 4), np.nan), TransformError, "finite"),
    ):
        with pytest.raises(error, match=text):
            merger.set_alignment(a, b, T)


def test_a_new_session_stops_the_transform_and_keeps_the_old_map_until_it_is_aligned() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    old = flat_map("b", 1)
    merger.add_map(flat_map("a"))
    merger.add_map(old)
    accepted = Alignment(("a", "b"), AlignmentStatus.ACCEPTED, "known", T_a_b=np.eye(4))
    merger.set_alignment("a", "b", accepted.T_a_b)
    merger.merge()
    assert set(merger.transforms()) == {"a", "b"}
    elsewhere = dataclasses.replace(random_map(9, "b"), session="new", sequence=1)
    assert merger.add_map(elsewhere)
    assert set(merger.transforms()) == {"a"}
    assert merger.stale == ("b",)
    result = merger.merge()
    assert merger.maps["b"] is old
    assert set(merger.transforms()) == {"a"}
    assert any("session new is not aligned yet" in warning for warning in result.warnings)
    with pytest.raises(SessionError, match="which has ended"):
        merger.add_map(dataclasses.replace(old, sequence=9))


def test_an_accepted_alignment_changes_only_for_a_better_one() -> None:
    a, b = flat_map("a"), flat_map("b")
    config = MergeConfig(check="none")
    one, two = (Prepared(m, config.search.scoring, config.matching) for m in (a, b))
    right = Alignment(("a", "b"), AlignmentStatus.ACCEPTED, "", np.eye(4), overlap=0.9, score=1.0)
    held, support = steadier(right, 1e9, right, one, two, config)
    value = held.score
    assert support == 1e9
    assert value > 0
    slightly = dataclasses.replace(right, T_a_b=yaw_transform(0.01), score=1.05 * value)
    np.testing.assert_array_equal(
        steadier(right, 1e9, slightly, one, two, config)[0].T_a_b, np.eye(4)
    )
    clearly = dataclasses.replace(slightly, score=1.2 * value)
    assert steadier(right, 1e9, clearly, one, two, config)[0] is clearly
    # More evidence counts as better where the answer stays the same.
    assert steadier(right, 100.0, slightly, one, two, config)[0] is slightly
    refused = Alignment(("a", "b"), AlignmentStatus.AMBIGUOUS, "two poses")
    np.testing.assert_array_equal(
        steadier(right, 1e9, refused, one, two, config)[0].T_a_b, np.eye(4)
    )


def test_an_alignment_that_no_longer_holds_gives_way() -> None:
    config = MergeConfig()
    one, two = (
        Prepared(flat_map(name), config.search.scoring, config.matching) for name in ("a", "b")
    )
    wrong = Alignment(
        ("a", "b"), AlignmentStatus.ACCEPTED, "", yaw_transform(0.8, (3, 1, 0)), overlap=0.9
    )
    refused = Alignment(("a", "b"), AlignmentStatus.AMBIGUOUS, "two poses")
    assert steadier(wrong, 1e9, refused, one, two, config)[0] is refused
