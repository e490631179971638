"""What the nodes are told that they cannot do: refused in words, and nothing is lost."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from test.helpers_io import random_map
from test.helpers_ros import Graph, graph, missing, private_context, wait_for
from topometric_ros.alignment import AgentPlacement, AgentStatus, Placed
from topometric_ros.errors import ConfigurationError
from topometric_ros.nodes.agent_names import check_agent, parse_agents

if missing():
    pytest.skip(missing(), allow_module_level=True)

import rclpy
from sensor_msgs.msg import LaserScan, PointCloud2
from topometric_msgs.msg import TopometricMap as MapMessage
from topometric_msgs.srv import SaveMap, SetAlignment

from topometric_ros.nodes import qos, services
from topometric_ros.nodes.cloud_subscription import CloudSubscription
from topometric_ros.nodes.diagnostics import Level
from topometric_ros.nodes.extractor_report import ExtractorReport
from topometric_ros.nodes.merger_report import InputReport, MergerReport
from topometric_ros.nodes.merger_state import StateKeeper
from topometric_ros.nodes.roster import Roster
from topometric_ros.nodes.running import TopometricNode

LIMIT_S = 60.0


@pytest.fixture
def node() -> Iterator[TopometricNode]:
    context = private_context()
    made = TopometricNode("refusing", context=context, use_global_arguments=False)
    yield made
    made.destroy_node()
    context.shutdown()


@pytest.mark.parametrize("entry", ["/robot 1", "a=b=c", "/1r", "=/r", "x=", "/", "a b=/r", "é"])
def test_names_that_no_agent_can_have_are_refused_in_one_line(entry: str) -> None:
    with pytest.raises(ConfigurationError, match="expected a namespace or id=namespace"):
        parse_agents([entry])
    assert parse_agents(["r2/", "floor-2.a=/fleet/b"]) == {"r2": "r2", "floor-2.a": "/fleet/b"}
    for agent in ("a b", "", "-a", "a\nb", "a/b"):
        with pytest.raises(ConfigurationError, match="agent: expected letters"):
            check_agent(agent)


def test_a_folder_is_no_state_file_and_stays_where_it_is(tmp_path: Path) -> None:
    (tmp_path / "maps").mkdir()
    os.mkfifo(tmp_path / "pipe")
    for path in (
        str(tmp_path / "maps"),
        str(tmp_path / "pipe"),
        "a\0b",
        "~nobody-of-that-name/state",
        str(tmp_path / "mpas" / "state"),
    ):
        with pytest.raises(ConfigurationError, match="state_file"):
            StateKeeper(path, rclpy.logging.get_logger("test"))
    assert {path.name for path in tmp_path.iterdir()} == {"maps", "pipe"}


def test_a_state_file_is_of_one_merger_until_that_ends(tmp_path: Path) -> None:
    logger, path = rclpy.logging.get_logger("test"), str(tmp_path / "state")
    (tmp_path / ".state.12345.partial").touch()
    first = StateKeeper(path, logger)
    assert not list(tmp_path.glob("*.partial")), "what a killed merger left half done"
    with pytest.raises(ConfigurationError, match="kept by another merger that is running"):
        StateKeeper(path, logger, patience=0.0)
    first.close()
    StateKeeper(path, logger, patience=0.0).close()


def test_every_call_of_a_service_gets_an_answer(node: TopometricNode, tmp_path: Path) -> None:
    def fail(request: Any, response: Any) -> Any:
        raise KeyError("nobody thought of this")

    response = services._answered(node, fail)(None, SetAlignment.Response())
    assert response.code == 2
    assert "nobody thought of this" in response.message
    saved: list[Path] = []

    def write(path: Path) -> None:
        path.write_bytes(b"a map")
        saved.append(path)

    os.mkfifo(tmp_path / "pipe")
    for path in (
        "",
        str(tmp_path),
        str(tmp_path / "pipe"),
        "a\0b",
        "~nobody-of-that-name/map.tmap",
    ):
        response = SaveMap.Response()
        assert not services.written(path, write, response)
        assert response.code == response.FILE_ERROR
    assert not saved
    response = SimpleNamespace(SUCCESS=0)
    assert services.written(str(tmp_path / "map.tmap"), write, response)
    assert saved == [tmp_path / "map.tmap"]


def test_why_nothing_arrives_is_told_where_the_graph_shows_it(
    node: TopometricNode, own: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    cloud = CloudSubscription(node, "auto", print)
    assert cloud.silence() == "nobody publishes /cloud"
    with graph("stranger") as stranger:
        stranger.node.create_publisher(LaserScan, "cloud", 1)
        wait_for(lambda: "LaserScan, expected" in cloud.silence(), LIMIT_S, "the wrong type")
        assert cloud.publishers == 0, "what it offers says nothing about clouds"
    right = own.node.create_publisher(PointCloud2, "cloud", 1)
    wait_for(lambda: "but nothing has arrived" in cloud.silence(), LIMIT_S, "the right type")
    cloud._lose(SimpleNamespace(total_count_change=4))
    assert cloud.silence().endswith("; 4 clouds were lost on the way")
    report = ExtractorReport()
    assert [report.lose(n, "on the way") for n in (0, 3, 2)] == [False, True, False]
    assert (report.lose(1, "their queue was full"), report.lost) == (True, 6), "told apart"

    everyone = Roster(node, {}, discover=True)
    assert "nobody publishes a `topometric_map`" in everyone.silence()
    monkeypatch.setenv("ROS_DISCOVERY_SERVER", "127.0.0.1:11811")
    assert everyone.silence().endswith("or set ROS_SUPER_CLIENT=TRUE")
    listed = Roster(node, {"robot2": "/robto2"}, discover=False)
    there = own.node.create_publisher(MapMessage, "/robot2/topometric_map", qos.SNAPSHOT)
    told = "/robto2/topometric_map; there is /robot2/topometric_map, which is not listed"
    wait_for(lambda: told in listed.silence(), LIMIT_S, "the name that was misspelt")
    # One that was killed counts as a publisher for a while beside the one that follows it.
    other = own.node.create_publisher(MapMessage, "/robot2/topometric_map", qos.SNAPSHOT)
    twice = Roster(node, {"robot2": "/robot2"}, discover=False)
    report = twice.reports["robot2"]
    wait_for(lambda: twice.look() or report.publishers == 2, LIMIT_S, "both publishers")
    assert report.rivals == 0
    monkeypatch.setattr("topometric_ros.nodes.roster._LEASE_S", -1.0)
    twice.look()
    assert report.rivals == 2
    for publisher in (right, there, other):
        own.node.destroy_publisher(publisher)


def test_two_extractors_of_one_agent_are_told_to_the_operator() -> None:
    placement = AgentPlacement("robot1", "", AgentStatus.ANCHOR, "", 0, np.eye(4), np.eye(4))
    placed = Placed("global", (placement,), ())
    newest = random_map(agent="robot1")
    for publishers, level, text in (
        (1, Level.OK, "anchor"),
        (2, Level.WARN, "2 publishers on its topic; anchor"),
    ):
        entry = InputReport("/robot1/topometric_map", rivals=publishers, newest=newest)
        status = MergerReport({"robot1": entry}, placed).statuses("/merger", now=0)[1]
        assert (status.level, status.message) == (level, text)
        assert status.values["age [s]"] == 0.0
    ahead = InputReport("/robot1/topometric_map", newest=newest, arrived=10**18)
    status = MergerReport({"robot1": ahead}, placed).statuses("/merger", now=5)[1]
    assert status.values["age [s]"] == 0.0, "the clock was set back"
