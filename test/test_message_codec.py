"""Maps and alignments survive the message bit by bit; a message that cannot be right is refused."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from test.helpers import yaw_transform
from test.helpers_io import assert_same_map, random_map
from topometric_ros.alignment import (
    AgentPlacement,
    AgentStatus,
    Alignment,
    AlignmentStatus,
    Alternative,
    GlobalMap,
    MergeResult,
    RoomMatch,
)
from topometric_ros.io.bag_messages import (
    ALIGNMENTS_TYPE,
    CLOUD_TYPE,
    MAP_TYPE,
    message_classes,
    typestore,
)
from topometric_ros.io.pointcloud2 import points_from_message
from topometric_ros.runtime.alignment_codec import alignments_from_message, alignments_to_message
from topometric_ros.runtime.cloud_message import map_cloud
from topometric_ros.runtime.frames import transforms_message
from topometric_ros.runtime.message_codec import (
    CodecError,
    header,
    map_from_message,
    map_to_message,
    without_mean_points,
)


def over_the_wire(message: Any, kind: str) -> Any:
    return typestore().deserialize_cdr(typestore().serialize_cdr(message, kind), kind)


@pytest.mark.parametrize("seed", [0, 1])
def test_a_map_survives_the_message_bit_by_bit(seed: int) -> None:
    original = random_map(seed)
    message = over_the_wire(map_to_message(original, message_classes()), MAP_TYPE)
    received = map_from_message(message)
    assert_same_map(received.map, original)
    assert received.observed_by is None
    assert received.observers == ()


def test_a_global_map_keeps_who_saw_what() -> None:
    m = random_map()
    seen = np.random.default_rng(0).integers(1, 1 << 32, len(m.voxels), dtype=np.uint32)
    message = map_to_message(m, message_classes(), seen, ("a", "b"))
    received = map_from_message(over_the_wire(message, MAP_TYPE))
    np.testing.assert_array_equal(received.observed_by, seen)
    assert received.observers == ("a", "b")


def test_rclpy_s_classes_give_the_same_map() -> None:
    pytest.importorskip("topometric_msgs", reason="the message package is not built here")
    from rclpy.serialization import deserialize_message, serialize_message

    from topometric_ros.nodes.messages import message_classes as rclpy_classes

    original = random_map()
    message = map_to_message(original, rclpy_classes())
    received = deserialize_message(serialize_message(message), type(message))
    assert_same_map(map_from_message(received).map, original)


def change(path: str, value: Any) -> Callable[[Any], None]:
    """Return what sets an attribute, by a dotted path that may name positions, of a message."""

    def apply(message: Any) -> None:
        *parents, last = path.split(".")
        for name in parents:
            message = message[int(name)] if name.isdigit() else getattr(message, name)
        setattr(message, last, value)

    return apply


@pytest.mark.parametrize(
    ("damage", "text"),
    [
        (change("schema", "topometric-map/9"), "unknown schema 'topometric-map/9'"),
        (change("agent", ""), "agent: expected a name"),
        (change("agent", "a\nb"), "agent: expected a name"),
        (change("agent", 1000 * "a"), "agent: expected a name"),
        (change("voxel_count", 3), "voxels: expected"),
        (change("voxel_count", 2**32 - 1), "at most 67108864 are read"),
        (change("voxels", np.zeros(9, np.uint8)), "voxels: the packed data is damaged"),
        (change("voxels", np.zeros(0, np.uint8)), "voxels: the packed data is damaged"),
        (change("navigable_count", 5), "navigable: expected"),
        (change("observed_by", np.ones(3, np.uint8)), "observed_by"),
        (change("voxel_size", float("nan")), "voxel_size"),
        (change("voxel_size", 0.0), "voxel_size"),
        (change("origin.x", float("inf")), "origin"),
        (change("t_level_input", np.full(16, np.nan)), "t_level_input"),
        (change("viewpoints.0.x", float("nan")), "viewpoints"),
        (change("rooms.0.id", 7), "room ids must be unique"),
        (change("rooms.0.id", 12), "voxels name rooms"),
        (change("rooms.0.storey", 5), "lies on storey 5"),
        (change("rooms.1.centroid.z", float("inf")), "must be finite"),
        (change("passages.0.room_b", 99), "passage between rooms"),
        (change("passages.0.width", float("nan")), "must be finite"),
        (change("storeys.0.layers.cells_x", 4_000_000), "wall: "),
        (change("storeys.0.layers.cell", 0.0), "expected finite heights"),
        (change("storeys.1.ceiling_z", float("nan")), "expected finite heights"),
        (change("descriptors.0.dimension", 4), "expected 2 x 4 values"),
        (change("descriptors.0.values", np.full(10, np.nan, np.float32)), "must be finite"),
    ],
)
def test_a_message_that_cannot_be_right_is_refused(
    damage: Callable[[Any], None], text: str
) -> None:
    message = map_to_message(random_map(), message_classes())
    damage(message)
    with pytest.raises(CodecError, match=text) as caught:
        map_from_message(message)
    assert "\n" not in str(caught.value)


def test_a_stamp_that_a_message_cannot_hold_is_refused() -> None:
    with pytest.raises(CodecError, match="stamp: expected 0 to 2147483647 s"):
        header(message_classes(), "map", 1 << 62)


def merge_result() -> MergeResult:
    T = yaw_transform(1 / 3, (0.1, 0.2, 1 / 7))
    accepted = Alignment(
        agents=("a", "b"),
        status=AlignmentStatus.ACCEPTED,
        reason="12 m of wall agree",
        T_a_b=T,
        alternatives=(Alternative(yaw_transform(3.0), 0.25),),
        confidence=0.9,
        overlap=1 / 3,
        rmse=0.02,
        matches=(RoomMatch(3, 7, 0.125),),
        covariance=np.arange(36.0).reshape(6, 6) / 7,
        score=12.5,
    )
    refused = Alignment(("a", "c"), AlignmentStatus.WITHDRAWN, "contradicted")
    placements = (
        AgentPlacement("a", "a.ply", AgentStatus.ANCHOR, "anchor", 0, np.eye(4), np.eye(4)),
        AgentPlacement("b", "b.ply", AgentStatus.ALIGNED, "with a", 0, T, T),
        AgentPlacement("c", "c.ply", AgentStatus.UNALIGNED, "nothing", 1, np.eye(4), None),
    )
    m = random_map()
    fused = GlobalMap(m, np.ones(len(m.voxels), np.uint32))
    return MergeResult("global", placements, (accepted, refused), fused, ("mind this",))


def test_a_map_without_mean_points_is_the_same_but_for_these_and_much_smaller() -> None:
    m = random_map()
    bare = without_mean_points(m)
    message = map_to_message(bare, message_classes())
    assert len(message.offsets) < len(map_to_message(m, message_classes()).offsets) / 5
    assert not map_from_message(message).map.offsets.any()
    assert_same_map(dataclasses.replace(bare, offsets=m.offsets), m)


def test_alignments_survive_the_message_bit_by_bit() -> None:
    result = merge_result()
    maps = {"a": random_map(agent="a")}
    message = alignments_to_message(result, message_classes(), 1_000_000_001, maps, ("a",))
    message = over_the_wire(message, ALIGNMENTS_TYPE)
    back = alignments_from_message(message)
    assert (back.global_frame, back.warnings) == ("global", ("mind this",))
    assert [x.status for x in back.agents] == [x.status for x in result.agents]
    assert [(x.id, x.source, x.reason, x.group) for x in back.agents] == [
        (x.id, x.source, x.reason, x.group) for x in result.agents
    ]
    assert back.agents[2].T_global_agent is None
    np.testing.assert_array_equal(back.agents[1].T_global_agent, result.agents[1].T_global_agent)
    one, two = back.alignments[0], result.alignments[0]
    for name in ("agents", "status", "reason", "confidence", "overlap", "rmse", "matches", "score"):
        assert getattr(one, name) == getattr(two, name), name
    np.testing.assert_array_equal(one.T_a_b, two.T_a_b)
    np.testing.assert_array_equal(one.covariance, two.covariance)
    np.testing.assert_array_equal(one.alternatives[0].T_a_b, two.alternatives[0].T_a_b)
    assert back.alignments[1].T_a_b is None
    assert back.alignments[1].covariance is None
    assert (message.agents[0].frame_id, message.agents[0].stale) == ("a/map", True)
    assert not message.agents[1].stale


def test_alignments_that_cannot_be_right_are_refused() -> None:
    def message() -> Any:
        return alignments_to_message(merge_result(), message_classes(), 0, {})

    for path, value, text in (
        ("schema", "topometric-merge/2", "unknown schema"),
        ("alignments.0.status", 9, "expected a status 0..4, got 9"),
        ("alignments.0.t_a_b", np.full(16, np.inf), "expected 16 finite numbers"),
        ("agents.1.status", 3, "expected a status 0..2, got 3"),
    ):
        damaged = message()
        change(path, value)(damaged)
        with pytest.raises(CodecError, match=text):
            alignments_from_message(damaged)


def test_the_cloud_of_a_map_lies_in_its_frame() -> None:
    m = random_map()
    seen = np.ones(len(m.voxels), np.uint32)
    message = over_the_wire(map_cloud(m, message_classes(), m.stamp, seen), CLOUD_TYPE)
    points, dropped = points_from_message(message)
    T = m.T_level_input
    np.testing.assert_allclose(points @ T[:3, :3].T + T[:3, 3], m.centres(), atol=1e-5)
    assert dropped == 0
    assert [field.name for field in message.fields] == ["x", "y", "z", "rgb", "label", "agents"]
    assert message.header.frame_id == m.frame_id


def test_transforms_have_the_global_frame_as_their_parent() -> None:
    T = yaw_transform(0.4, (1, 2, 0))
    message = transforms_message(message_classes(), 5, "global", {"a": T}, {"a": "a/map"})
    (entry,) = message.transforms
    assert (entry.header.frame_id, entry.child_frame_id) == ("global", "a/map")
    assert entry.transform.rotation.z == pytest.approx(np.sin(0.2))
