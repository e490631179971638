"""Bags of every kind are read without ROS, and what is wrong with one is told in one line."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

from test.helpers import SHARED_DATA, needs_shared_data
from test.helpers_bags import SECOND, START, cloud, flat, write_map_bag, write_scan_bag
from topometric_ros.io.bag_messages import CLOUD_TYPE, TRANSFORM_TYPE, typestore
from topometric_ros.io.bag_writer import BagWriter
from topometric_ros.io.bags import Bag, BagError, split_source
from topometric_ros.io.pointcloud2 import points_from_message

POINTS = flat()[:500]
OFFICIAL = SHARED_DATA / "bags" / "rosbag2_official"


def read(path: Path, topics: list[str]) -> list[tuple[int, str, str]]:
    with Bag(path) as bag:
        return [(entry.time, entry.topic, entry.type) for entry in bag.messages(topics)]


def test_a_bag_comes_back_as_it_was_written(tmp_path: Path) -> None:
    path = write_map_bag(tmp_path / "b", {"/r1/cloud_map": POINTS, "/r2/cloud_map": POINTS + 1})
    with Bag(path) as bag:
        assert [(t.name, t.type, t.count) for t in bag.topics().values()] == [
            ("/r1/cloud_map", CLOUD_TYPE, 1),
            ("/r2/cloud_map", CLOUD_TYPE, 1),
        ]
        first, second = bag.messages(["/r2/cloud_map", "/r1/cloud_map"])
    assert (first.time, first.topic) == (START + 5, "/r1/cloud_map")
    assert (second.time, second.topic) == (START + SECOND + 5, "/r2/cloud_map")
    points, dropped = points_from_message(second.message)
    np.testing.assert_array_equal(points, (POINTS + 1).astype(np.float32))
    assert dropped == 0


def test_the_same_messages_give_the_same_bytes(tmp_path: Path) -> None:
    write_map_bag(tmp_path / "one" / "b", {"/cloud": POINTS})
    write_map_bag(tmp_path / "two" / "b", {"/cloud": POINTS})
    for name in ("b.mcap", "metadata.yaml"):
        one, two = (tmp_path / side / "b" / name for side in ("one", "two"))
        assert one.read_bytes() == two.read_bytes()


def test_late_joiners_get_latched_topics(tmp_path: Path) -> None:
    path = write_scan_bag(tmp_path / "b", POINTS)
    with Reader(path) as reader:
        durability = {c.topic: c.ext.offered_qos_profiles[0].durability for c in reader.connections}
    assert durability["/tf_static"].name == "TRANSIENT_LOCAL"
    assert durability["/tf"].name == "VOLATILE"


def test_a_bare_file_and_a_directory_without_metadata_are_bags(tmp_path: Path) -> None:
    path = write_map_bag(tmp_path / "b", {"/cloud": POINTS})
    assert len(read(path / "b.mcap", ["/cloud"])) == 1
    (path / "metadata.yaml").unlink()
    assert len(read(path, ["/cloud"])) == 1


def test_a_sqlite_bag_is_read(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "s", version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        connection = writer.add_connection("/cloud", CLOUD_TYPE, typestore=typestore())
        for i in range(3):
            raw = typestore().serialize_cdr(cloud(POINTS, "map", START + i), CLOUD_TYPE)
            writer.write(connection, START + i, raw)
    assert [time for time, *_ in read(tmp_path / "s", ["/cloud"])] == [START, START + 1, START + 2]
    assert len(read(tmp_path / "s" / "s.db3", ["/cloud"])) == 3


def test_split_files_are_one_bag_in_time_order(tmp_path: Path) -> None:
    (tmp_path / "split").mkdir()
    for i, name in enumerate(("late", "early")):
        path = tmp_path / name
        with BagWriter(path) as bag:
            bag.add_topic("/cloud", CLOUD_TYPE)
            for k in range(2):
                time = START + (10 - 10 * i + k) * SECOND
                bag.write("/cloud", time, cloud(POINTS, "map", time))
        shutil.move(path / f"{name}.mcap", tmp_path / "split" / f"part_{i}.mcap")
    times = [(time - START) // SECOND for time, *_ in read(tmp_path / "split", ["/cloud"])]
    assert times == [0, 1, 10, 11]


@needs_shared_data
def test_real_split_files_are_read() -> None:
    path = OFFICIAL / "rosbag2_py" / "test" / "resources" / "mcap" / "wbag"
    with Bag(path) as bag:
        assert sum(topic.count for topic in bag.topics().values()) > 0


@needs_shared_data
@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_bags_with_types_that_nobody_knows_are_passed_over(storage: str) -> None:
    base = OFFICIAL / "rosbag2_tests" / "resources" / storage
    path = base / "bag_with_topics_and_service_events"
    with Bag(path) as bag:
        topics = bag.topics()
        assert topics
        assert list(bag.messages(list(topics))) == []
        with pytest.raises(BagError, match="no topic /cloud; the bag has: /"):
            bag.require("/cloud")


@needs_shared_data
def test_a_bag_of_another_serialisation_is_one_line() -> None:
    for path in OFFICIAL.rglob("wrong_rmw_test"):
        with pytest.raises(BagError, match="not a readable bag") as caught, Bag(path) as bag:
            list(bag.messages(list(bag.topics())))
        assert "\n" not in str(caught.value)


def test_a_missing_topic_is_told_with_those_that_are_there(tmp_path: Path) -> None:
    path = write_scan_bag(tmp_path / "b", POINTS, "/r1")
    with Bag(path) as bag:
        with pytest.raises(BagError) as caught:
            bag.require("/cloud_map")
        assert str(caught.value) == (
            f"{path}: no topic /cloud_map; the bag has: "
            "/r1/scan_cloud (sensor_msgs/msg/PointCloud2), /tf (tf2_msgs/msg/TFMessage), "
            "/tf_static (tf2_msgs/msg/TFMessage)"
        )
        with pytest.raises(BagError, match=r"topic /tf: expected .*got tf2_msgs/msg/TFMessage"):
            bag.require("/tf")
        assert bag.require("/tf", (TRANSFORM_TYPE,)).count == 5


@pytest.mark.parametrize("share", [0.0, 0.1, 0.5, 0.9, 0.9999])
def test_a_truncated_mcap_says_that_it_ends_early(tmp_path: Path, share: float) -> None:
    path = write_map_bag(tmp_path / "b", {"/cloud": POINTS})
    whole = (path / "b.mcap").read_bytes()
    (path / "b.mcap").write_bytes(whole[: int(len(whole) * share)])
    for target in (path, path / "b.mcap"):
        with pytest.raises(BagError, match=r"b\.mcap: .*(ends early|empty|not an MCAP)"):
            read(target, ["/cloud"])


def test_a_truncated_sqlite_file_is_one_line(tmp_path: Path) -> None:
    writer = Writer(tmp_path / "s", version=9, storage_plugin=StoragePlugin.SQLITE3)
    with writer:
        connection = writer.add_connection("/cloud", CLOUD_TYPE, typestore=typestore())
        raw = typestore().serialize_cdr(cloud(POINTS, "map", START), CLOUD_TYPE)
        writer.write(connection, START, raw)
    file = tmp_path / "s" / "s.db3"
    file.write_bytes(file.read_bytes()[:6000])
    with pytest.raises(BagError, match=r"not a readable bag|cannot be read") as caught:
        read(tmp_path / "s", ["/cloud"])
    assert "\n" not in str(caught.value)


def test_what_is_no_bag_is_one_line(tmp_path: Path) -> None:
    (tmp_path / "empty").mkdir()
    (tmp_path / "a.txt").write_text("text")
    (tmp_path / "a.mcap").write_text("no mcap at all")
    (tmp_path / "bad").mkdir()
    (tmp_path / "bad" / "metadata.yaml").write_text("rosbag2_bagfile_information: [")
    for name, text in (
        ("missing", "no such bag"),
        ("empty", r"holds no metadata\.yaml"),
        ("a.txt", "not a bag: expected a directory"),
        ("a.mcap", "not an MCAP file"),
        ("bad", "not a readable bag"),
    ):
        with pytest.raises(BagError, match=text) as caught, Bag(tmp_path / name):
            pass
        assert "\n" not in str(caught.value)


def test_metadata_of_another_kind_is_one_line(tmp_path: Path) -> None:
    path = write_map_bag(tmp_path / "b", {"/cloud": POINTS}) / "metadata.yaml"
    right = path.read_text()
    for field, text in (("name: /cloud", "name: 7"), ("message_count: 1", "message_count: a")):
        assert field in right
        path.write_text(right.replace(field, text))
        with pytest.raises(BagError, match="not a readable bag") as caught, Bag(path.parent) as bag:
            bag.topics()
        assert "\n" not in str(caught.value)


def test_a_record_larger_than_memory_is_one_line(tmp_path: Path) -> None:
    path = write_map_bag(tmp_path / "b", {"/cloud": POINTS}) / "b.mcap"
    damaged = bytearray(path.read_bytes())
    damaged[9:17] = (1 << 62).to_bytes(8, "little")  # the length of the first record
    path.write_bytes(bytes(damaged))
    with pytest.raises(BagError, match="not a readable bag"), Bag(path):
        pass


def test_damage_inside_a_message_is_one_line(tmp_path: Path) -> None:
    path = write_map_bag(tmp_path / "b", {"/cloud": POINTS})
    damaged = bytearray((path / "b.mcap").read_bytes())
    at = damaged.index(b"\x04\x00\x00\x00map\x00")
    damaged[at : at + 4] = b"\xff\xff\xff\x7f"
    (path / "b.mcap").write_bytes(bytes(damaged))
    with pytest.raises(BagError, match="a message cannot be read") as caught:
        read(path, ["/cloud"])
    assert "\n" not in str(caught.value)


def test_only_an_older_bag_is_replaced(tmp_path: Path) -> None:
    write_map_bag(tmp_path / "b", {"/cloud": POINTS})
    write_map_bag(tmp_path / "b", {"/other": POINTS})
    with Bag(tmp_path / "b") as bag:
        assert list(bag.topics()) == ["/other"]
    (tmp_path / "b" / "notes.txt").write_text("mine")
    with pytest.raises(BagError, match="holds more than a bag"):
        BagWriter(tmp_path / "b")
    assert (tmp_path / "b" / "notes.txt").exists()


def test_a_path_with_a_colon_that_exists_is_a_path(tmp_path: Path) -> None:
    odd = tmp_path / "walk:2"
    odd.mkdir()
    assert split_source(str(odd)) == (odd, None)
    assert split_source(f"{odd}:/cloud") == (odd, "/cloud")
    assert split_source(f"{odd}:cloud") == (odd, "/cloud")
