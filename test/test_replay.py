"""Replay runs the nodes' code over bags: the same bytes every time, and the right transform."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from test.helpers import SHARED_DATA, moved, needs_shared_data, yaw_transform
from test.helpers_bags import flat, write_map_bag, write_scan_bag
from topometric_ros.cli.main import main
from topometric_ros.io.bags import Bag, BagError
from topometric_ros.runtime.bag_sources import SourceError, bag_sources, parse_source
from topometric_ros.runtime.message_codec import map_from_message
from topometric_ros.runtime.replay import find_agents


def test_every_first_namespace_with_clouds_is_an_agent(tmp_path: Path) -> None:
    clouds = {name: flat()[:50] for name in ("/r2/cloud_map", "/r1/cloud_map", "/r1/other")}
    path = write_map_bag(tmp_path / "b", clouds)
    found = find_agents([str(path)])
    assert [(x.agent, x.topic) for x in found] == [("r1", "/r1/cloud_map"), ("r2", "/r2/cloud_map")]


def test_bags_with_the_same_topics_are_named_apart(tmp_path: Path) -> None:
    one, two = (write_map_bag(tmp_path / name, {"/cloud": flat()[:50]}) for name in ("one", "two"))
    assert [x.agent for x in find_agents([str(one), str(two)])] == ["one", "two"]
    named = find_agents([f"a={one}", f"b={two}:/cloud"])
    assert [(x.agent, x.topic) for x in named] == [("a", "/cloud"), ("b", "/cloud")]
    with pytest.raises(SourceError, match="two sources are named 'one'"):
        find_agents([str(one), f"one={two}"])


def test_transforms_of_the_agent_s_own_namespace_count_too(tmp_path: Path) -> None:
    path = write_scan_bag(tmp_path / "b", flat()[:50], "/r1")
    (source,) = bag_sources(parse_source(str(path)))
    assert (source.agent, source.transforms) == ("r1", ("/tf", "/tf_static"))


def test_a_bag_of_several_agents_is_not_one_agent(tmp_path: Path) -> None:
    path = write_map_bag(tmp_path / "b", {"/r1/cloud": flat()[:50], "/r2/cloud": flat()[:50]})
    with pytest.raises(SourceError, match="one agent, the bag has several topics: /r1/cloud, /r2"):
        find_agents([f"me={path}"])
    with pytest.raises(BagError, match="no such bag"):
        find_agents([str(tmp_path / "nothing")])


@pytest.fixture(scope="module")
def two_bags(tmp_path_factory: pytest.TempPathFactory) -> list[str]:
    """One agent's bag of scans with /tf and another's of a map cloud; frame ids are the same."""
    folder = tmp_path_factory.mktemp("bags")
    scans = write_scan_bag(folder / "scans", flat())
    whole = moved(flat(), yaw_transform(0.8, (3, 1, 0)))
    return [f"first={scans}", f"second={write_map_bag(folder / 'whole', {'/cloud_map': whole})}"]


def test_two_replays_write_the_same_bytes(tmp_path: Path, two_bags: list[str]) -> None:
    for name in ("one", "two"):
        assert main(["replay", *two_bags, "-o", str(tmp_path / name), "--every", "3"]) == 0
    files = sorted(p.relative_to(tmp_path / "one") for p in (tmp_path / "one").rglob("*.*"))
    assert [str(name) for name in files] == [
        *("bag/bag.mcap", "bag/metadata.yaml", "global.ply", "global.tmap"),
        *("global.trajectories.json", "merge.json", "report.html", "timings.json"),
    ]
    for name in files:
        if name.name != "timings.json":
            one, two = (tmp_path / side / name for side in ("one", "two"))
            assert one.read_bytes() == two.read_bytes(), name
    check_output(tmp_path / "one")


def check_output(folder: Path) -> None:
    """The bag holds what the nodes would have published, and its maps can be replayed."""
    with Bag(folder / "bag") as bag:
        topics = bag.topics()
        assert list(topics) == [
            *("/alignments", "/first/topometric_map", "/global_cloud", "/global_map"),
            *("/second/topometric_map", "/tf"),
        ]
        assert topics["/first/topometric_map"].count > 1
        maps = [
            map_from_message(entry.message) for entry in bag.messages(["/first/topometric_map"])
        ]
    assert [entry.map.sequence for entry in maps] == list(range(1, len(maps) + 1))
    assert len({entry.map.session for entry in maps}) == 1
    again = folder / "again"
    assert main(["replay", str(folder / "bag"), "-o", str(again)]) == 0
    results = [json.loads((x / "merge.json").read_text()) for x in (folder, again)]
    assert [x["id"] for x in results[1]["agents"]] == ["first", "second"]
    assert [x["alignments"][0]["status"] for x in results] == 2 * [
        results[0]["alignments"][0]["status"]
    ]


def test_single_scans_and_a_map_cloud_give_the_same_rooms(
    tmp_path: Path, two_bags: list[str]
) -> None:
    rooms = []
    for source in two_bags:
        name, path = source.split("=")
        assert main(["extract", path, "-o", str(tmp_path / name)]) == 0
        summary = json.loads((tmp_path / name / "map.json").read_text())
        assert summary["frame_id"] == "map"
        rooms.append(len(summary["rooms"]))
    assert rooms[0] == rooms[1]


@needs_shared_data
@pytest.mark.parametrize("name", ["indoor_two_agents", "duplex_two_agents"])
def test_a_bag_that_rosbag2_recorded_aligns_as_its_truth_says(tmp_path: Path, name: str) -> None:
    bags = SHARED_DATA / "bags"
    assert main(["replay", str(bags / name), "-o", str(tmp_path)]) == 0
    (alignment,) = json.loads((tmp_path / "merge.json").read_text())["alignments"]
    assert alignment["status"] == "accepted", alignment["reason"]
    truth = np.array(json.loads((bags / f"{name}.truth.json").read_text())["T_robot1_robot2"])
    T = np.array(alignment["T_a_b"])
    points = load_points(tmp_path / "global.ply", np.linalg.inv(T))
    off = np.linalg.norm(moved(points, T) - moved(points, truth), axis=1).mean()
    cosine = (np.trace(truth[:3, :3].T @ T[:3, :3]) - 1) / 2
    assert off < 0.15
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))) < 1.0


def load_points(path: Path, T: np.ndarray) -> np.ndarray:
    """Return every hundredth point of a PLY file, moved."""
    from topometric_ros.io.ply import read_ply_points

    return moved(read_ply_points(path)[::100], T)
