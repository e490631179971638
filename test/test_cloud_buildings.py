"""A scan whose points are labelled by room is a building like any other, from links to truth."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from test.helpers_simulation import SPEC, configured, in_building
from topometric_ros.cli.main import main
from topometric_ros.io.ply import write_ply
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.cases import Walk, read_case, simulate
from topometric_ros.simulation.labelled import LabelledBuilding
from topometric_ros.simulation.sidecars import graph_path


@pytest.fixture(scope="module")
def original() -> LabelledBuilding:
    return load_building(SPEC)


@pytest.fixture(scope="module")
def scan(original: LabelledBuilding, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a labelled cloud of the whole building, scanned by an agent that visits all rooms."""
    config = configured(agents=1, sensor__lidar__azimuths=400, sensor__lidar__rings=40)
    every = Walk(rooms=tuple(room.id for room in original.rooms))
    (agent,) = simulate(original, config, 0, [every]).agents
    table = np.empty(len(agent.points), [(axis, "<f4") for axis in "xyz"] + [("label", "<i4")])
    for axis, values in zip("xyz", in_building(agent).T, strict=True):
        table[axis] = values
    table["label"] = agent.room
    path = tmp_path_factory.mktemp("scan") / "house.ply"
    write_ply(path, table)
    return path


def test_the_proposed_graph_has_the_doors_and_is_never_overwritten(
    original: LabelledBuilding, scan: Path, capsys: pytest.CaptureFixture[str]
):
    propose = ["simulate", str(scan), "--propose-graph", str(graph_path(scan))]
    assert main(propose) == 0
    assert "links of 9 rooms, to correct by hand" in capsys.readouterr().out
    links = load_building(str(scan)).links
    assert {link.rooms for link in links} == {tuple(sorted(x.rooms)) for x in original.links}
    assert {link.kind for link in links} == {"door"}
    for link in links:
        near = [np.linalg.norm(x.position - link.position) for x in original.links]
        assert min(near) < 0.3
    assert main(propose) == 2
    assert "is there already" in capsys.readouterr().err
    # What a person has written does not turn up in the next proposal.
    graph_path(scan).write_text("links: []\n", encoding="utf-8")
    again = scan.with_name("again.yaml")
    assert main(["simulate", str(scan), "--propose-graph", str(again)]) == 0
    assert f"kind: {links[0].kind}" in again.read_text(encoding="utf-8")
    assert load_building(str(scan)).links == ()
    graph_path(scan).unlink()


def test_agents_see_the_scan_and_their_points_keep_its_rooms(
    original: LabelledBuilding, scan: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    parameters = tmp_path / "p.yaml"
    parameters.write_text(
        "sensor: {lidar: {rings: 24, azimuths: 200, noise: 0.0}}\ndegrade: {moved: 0.5}\n"
    )
    walks = ["--walk", "0,1", "--walk", "0,3"]
    arguments = ["simulate", str(scan), "-o", str(tmp_path), "--config", str(parameters), *walks]
    assert main([*arguments, "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["warnings"] == ["degrade.moved: house has no furniture that could be moved"]
    case = read_case(tmp_path / "house_0")
    assert {0, 1} <= set(case.agents[0].rooms_walked)
    assert (0, 1) in case.edges
    for agent in case.agents:
        truth = original.room_of(in_building(agent))
        clear = (truth >= 0) & (agent.room >= 0)
        assert clear.mean() > 0.95
        assert (truth[clear] == agent.room[clear]).mean() > 0.9


def test_a_command_that_would_do_nothing_says_what_to_add(capsys: pytest.CaptureFixture[str]):
    assert main(["simulate", SPEC]) == 2
    assert "expected -o OUT, or --propose-graph FILE" in capsys.readouterr().err
