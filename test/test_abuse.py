"""Input that is wrong in ways that fuzzing a single message does not reach, and what is said."""

from __future__ import annotations

import dataclasses
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from test.helpers_bags import cloud, transforms
from test.helpers_io import random_map
from test.helpers_sessions import flat_map, session
from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.errors import TopometricError
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.fuse_storeys import merged_layers
from topometric_ros.io.bag_messages import CLOUD_TYPE, message_classes
from topometric_ros.io.bags import Bag, BagMessage
from topometric_ros.io.map_files import encode_map, load_map
from topometric_ros.io.map_format import MapFileError, Section, decode, encode
from topometric_ros.io.summaries import write_atomically
from topometric_ros.runtime.agent_input import AgentInput
from topometric_ros.runtime.alignment_codec import alignments_from_message
from topometric_ros.runtime.bag_input import BagInput
from topometric_ros.runtime.bag_sources import BagSource
from topometric_ros.runtime.frames import published_frames
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.merger_state import MOST_ENDED, MergerState, load_state, save_state
from topometric_ros.runtime.replay_output import ReplayOutput
from topometric_ros.runtime.transforms import TransformBuffer, TransformError


def test_no_two_agents_get_one_frame_and_every_one_gets_a_name() -> None:
    frames = {"a": "map", "b": "map", "c": "a/map", "d": "", "e": "/e/map", "f": "global"}
    named = published_frames(frames, "global")
    assert named == {"a": "a/a/map", "b": "b/map", "c": "a/map", "d": "d/map",
                     "e": "e/map", "f": "f/global"}  # fmt: skip


def test_agents_whose_names_share_their_letters_get_topics_of_their_own(tmp_path: Path) -> None:
    with ReplayOutput(tmp_path / "bag", ["floor-2", "floor_2", "Floor_2"]) as output:
        for agent in ("floor-2", "floor_2", "Floor_2"):
            output.write_map(random_map(agent=agent), 5)
    with Bag(tmp_path / "bag") as bag:
        counts = {name: topic.count for name, topic in bag.topics().items() if topic.count}
    assert counts == {f"/{t}/topometric_map": 1 for t in ("floor_2", "floor_2_", "Floor_2")}


def test_maps_placed_far_apart_by_mistake_cost_no_memory() -> None:
    layers = flat_map("a").storeys[0].layers
    T = np.eye(4)
    T[:2, 3] = (500_000.0, 5_400_000.0)  # As UTM coordinates that were taken for an alignment.
    with pytest.raises(TopometricError, match=r"5400\d{3} m apart"):
        merged_layers([(layers, np.eye(4)), (layers, T)])


def test_alignments_that_no_merger_can_mean_are_refused() -> None:
    kind = message_classes()
    zeros = {"t_a_b": np.zeros(16), "covariance": np.zeros(36)}
    numbers = {"confidence": 0.5, "overlap": 0.5, "rmse": 0.1, "score": 1.0}

    def read(**fields: Any) -> None:
        entry = {"agent_a": "a", "agent_b": "b", "status": 0, "reason": "", "has_transform": False,
                 "has_covariance": False, "matches": [], "alternatives": []}  # fmt: skip
        x = kind.Alignment(**{**entry, **zeros, **numbers, **fields})
        stamp = kind.Header(stamp=kind.Time(sec=0, nanosec=0), frame_id="global")
        message = kind.AlignmentArray(header=stamp, schema="topometric-merge/1", agents=[],
                                      alignments=[x], warnings=[])  # fmt: skip
        alignments_from_message(message)

    read(status=3)
    for fields, text in (
        ({}, "accepted, but without a transform"),
        ({"status": 3, "score": float("nan")}, "finite"),
        ({"status": 3, "agent_b": "a"}, "two agents"),
    ):
        with pytest.raises(TopometricError, match=text):
            read(**fields)


def test_a_tracker_that_names_everything_it_sees_fills_no_memory() -> None:
    buffer = TransformBuffer(history=10**9)
    buffer.add("map", "base", 10**12, np.eye(4))
    for number in range(12_000):
        buffer.add("map", f"thing_{number}", number, np.eye(4))
    assert len(buffer.frames()) <= 10_001
    assert buffer.lookup("map", "base", 10**12) is not None
    with pytest.raises(TransformError, match=r"known: .* and \d+ more"):
        buffer.lookup("map", "nowhere", 5)
    chain = TransformBuffer()
    for number in range(5_000):
        chain.add(f"f{number}", f"f{number + 1}", 1, np.eye(4), static=True)
    with pytest.raises(TransformError, match="more than 1000 frames lie above"):
        chain.map_frame("f5000")


def test_a_bag_whose_frames_form_a_circle_is_refused_cloud_by_cloud() -> None:
    source = BagSource("a", Path("a.bag"), "/a/cloud", CLOUD_TYPE, ())
    reader = BagInput(source, AgentInput(session("a")))
    ring = [("x", "y"), ("y", "z"), ("z", "x")]
    message = transforms(*((parent, child, np.eye(4)) for parent, child in ring), stamp=1)
    reader.agent_input.add_transforms(message, static=True)
    reader.take(BagMessage(1, "/a/cloud", CLOUD_TYPE, cloud(np.ones((5, 3)), "x", 1)))
    assert "form a circle" in reader.refused[0]
    reader.take(BagMessage(2, "/a/cloud", CLOUD_TYPE, cloud(np.ones((5, 3)), "map", 2)))
    reader.require_input()
    assert "1 messages were refused" in reader.warnings()[0]


def test_what_is_no_ordinary_file_is_not_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", tmp_path):
        with pytest.raises(MapFileError, match="a folder, a device or a pipe"):
            load_map(path)
        with pytest.raises(MapFileError, match="a folder, a device or a pipe"):
            load_state(path)


def test_what_is_no_ordinary_file_is_not_replaced_by_one(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for name in ("folder", "pipe"):
        with pytest.raises(MapFileError, match="a folder, a device or a pipe has that name"):
            write_atomically(tmp_path / name, b"12")
    assert (tmp_path / "pipe").is_fifo()
    assert {path.name for path in tmp_path.iterdir()} == {"folder", "pipe"}


def rewritten(path: Path, change: Any) -> None:
    """Change the fields of a state file, its checksums being right again."""
    fields, arrays = decode(path.read_bytes(), "state")
    change(fields)
    sections = [Section(name, "array", array) for name, array in arrays.items()]
    path.write_bytes(encode(fields, sections))


def test_a_state_of_another_version_is_read_or_refused_but_never_believed(tmp_path: Path) -> None:
    known = Alignment(("a", "b"), AlignmentStatus.ACCEPTED, "by hand", np.eye(4))
    state = MergerState(("a", "b"), {n: random_map(agent=n) for n in "ab"}, fixed=(known,))
    path = tmp_path / "state"

    def older(fields: dict[str, Any]) -> None:
        del fields["fixed"][0]["inliers"]
        fields["later"] = {"unknown": 1}

    save_state(path, state)
    rewritten(path, older)
    assert load_state(path).fixed[0].reason == "by hand"

    def without_transform(fields: dict[str, Any]) -> None:
        fields["fixed"][0]["T_a_b"] = None

    for change, text in (
        (lambda f: f.update(schema="topometric-state/9"), "expected 'topometric-state/1'"),
        (lambda f: f.update(order=["a"]), "in the place of 'b'"),
        (lambda f: f.update(newer=["a"]), "makes no sense"),
        (lambda f: f["fixed"][0].update(status="perhaps"), "makes no sense"),
        (without_transform, "without a transform"),
    ):
        save_state(path, state)
        rewritten(path, change)
        with pytest.raises(MapFileError, match=text):
            load_state(path)
    data = np.frombuffer(encode_map(random_map(agent="b")), np.int8)
    save_state(path, state)
    fields, arrays = decode(path.read_bytes(), "state")
    names = [Section(n, "array", data if n == "maps[a]" else x) for n, x in arrays.items()]
    path.write_bytes(encode(fields, names))
    with pytest.raises(MapFileError, match="a map of 'b' in the place of 'a'"):
        load_state(path)


def test_an_agent_that_starts_again_and_again_is_remembered_in_bounded_space() -> None:
    merger = MergerSession(MergeConfig())
    m = random_map(agent="a")
    for number in range(MOST_ENDED + 50):
        merger.add_map(dataclasses.replace(m, session=f"s{number}"))
    assert len(merger.state().ended["a"]) == MOST_ENDED
    with pytest.raises(TopometricError, match="has ended"):
        merger.add_map(dataclasses.replace(m, session=f"s{MOST_ENDED}", sequence=99))
