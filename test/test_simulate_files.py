"""Simulated cases on disk: equal bytes, the shared layout, bags that align, and the command."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from test.helpers_simulation import ONE_WALK, SPEC, configured
from topometric_ros.cli.main import main
from topometric_ros.errors import ConfigurationError
from topometric_ros.fusion.merge import merge
from topometric_ros.runtime.config import load_config
from topometric_ros.runtime.sources import load_sources
from topometric_ros.simulation import buildings
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.case import CaseError
from topometric_ros.simulation.cases import prepare, read_case, simulate, write_case
from topometric_ros.simulation.labelled import Trajectory
from topometric_ros.simulation.recording import RecordingError
from topometric_ros.simulation.simulation_config import load_simulation_config, parse_walk
from topometric_ros.simulation.trajectories import TrajectoryError

DATA = Path(__file__).resolve().parents[2] / "shared" / "data" / "pairs"


@pytest.fixture(scope="module")
def building():
    return load_building(SPEC)


@pytest.fixture(scope="module")
def ready(building):
    return prepare(building, configured())


def contents(folder):
    return {p.relative_to(folder): p.read_bytes() for p in folder.rglob("*") if p.is_file()}


@pytest.mark.parametrize("bag", ["scans", "maps"])
def test_the_same_seed_gives_the_same_bytes(building, ready, tmp_path, bag):
    config = configured(degrade__drift=0.01, degrade__dropout=0.1, degrade__moved=0.5)
    write_case(simulate(ready, config, 5), tmp_path / "one", bag)
    # From the building itself, with nothing remembered of other cases.
    simulate(ready, config, 6)
    write_case(simulate(building, config, 5), tmp_path / "two", bag)
    one, two = contents(tmp_path / "one"), contents(tmp_path / "two")
    assert one == two
    assert {"a.ply", "b.ply", "truth.json", "truth.npz"} <= {p.name for p in one}


def test_what_is_written_is_read_again(ready, tmp_path):
    case = simulate(ready, configured(agents=3), 1)
    write_case(case, tmp_path / "case")
    again = read_case(tmp_path / "case")
    assert (again.plan, again.seed, again.edges) == (case.plan, case.seed, case.edges)
    np.testing.assert_array_equal(again.overlap, case.overlap)
    assert len(case.pairs()) == len(case.overlap) == 3
    for one, two in zip(case.agents, again.agents, strict=True):
        assert (one.id, one.rooms_walked) == (two.id, two.rooms_walked)
        for name in ("points", "room", "poses", "scan_of_point", "T_agent_building"):
            np.testing.assert_array_equal(getattr(one, name), getattr(two, name))


def test_the_folder_has_the_layout_of_the_shared_pairs(ready, tmp_path):
    if not DATA.is_dir():
        pytest.skip("../shared/data/pairs is not here")
    shared = DATA / "duplex_101"
    write_case(simulate(ready, configured(), 1), tmp_path / "case")
    theirs, ours = (json.loads((f / "truth.json").read_text()) for f in (shared, tmp_path / "case"))
    assert set(theirs) | {"room_names"} == set(ours)
    assert np.shape(theirs["a_from_b"]) == np.shape(ours["a_from_b"])
    np.testing.assert_allclose(
        np.array(ours["a_from_world"]), ours["a_from_b"] @ np.array(ours["b_from_world"])
    )
    with np.load(shared / "truth.npz") as a, np.load(tmp_path / "case" / "truth.npz") as b:
        assert {name: a[name].dtype for name in "ab"} == {name: b[name].dtype for name in "ab"}
    case = read_case(shared)
    assert case.overlap[0] == pytest.approx(theirs["overlap"])
    assert len(case.agents[0].points) == theirs["points"]["a"]


def test_a_damaged_case_is_refused(ready, tmp_path):
    write_case(simulate(ready, configured(), 1, ONE_WALK), tmp_path)
    (tmp_path / "truth.json").write_text("{}")
    with pytest.raises(CaseError, match="not a simulated case"):
        read_case(tmp_path)


@pytest.mark.parametrize(
    ("kind", "topic"), [("scans", "scan_cloud"), ("maps", "cloud_map")], ids=["scans", "maps"]
)
def test_the_bag_replays_to_the_maps_and_they_align(ready, tmp_path, kind, topic):
    case = simulate(ready, configured(overlap=0.8), 4)
    write_case(case, tmp_path, kind)
    config = load_config("default")
    bag = tmp_path / "bag"
    maps = [
        loaded.map for loaded in load_sources([f"{k}={bag}:/{k}/{topic}" for k in "ab"], config)
    ]
    (alignment,) = merge(maps, config.merge).alignments
    assert alignment.status == "accepted", alignment.reason
    T, truth = alignment.T_a_b, case.T_a_b(0, 1)
    points = case.agents[1].points[::50]
    moved = points @ (T - truth)[:3, :3].T + (T - truth)[:3, 3]
    assert np.linalg.norm(moved, axis=1).mean() < 0.05


def test_the_command_writes_cases_and_says_what_they_share(tmp_path, capsys):
    file = tmp_path / "f.yaml"
    file.write_text("sensor: {lidar: {rings: 16, azimuths: 120}}\nwalk: {spacing: 2.0}\n")
    arguments = ["simulate", SPEC, "-o", str(tmp_path / "out"), "--config", str(file)]
    assert main([*arguments, "--count", "2", "--seed", "7", "--json"]) == 0
    cases = json.loads(capsys.readouterr().out)["cases"]
    assert [case["name"][-2:] for case in cases] == ["_7", "_8"]
    for case in cases:
        read = read_case(tmp_path / "out" / case["name"])
        assert case["overlap"] == [pytest.approx(read.overlap[0], abs=1e-4)]


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--agents", "0"], "agents: expected 1..26, got 0"),
        (["--overlap", "1.5"], "overlap: expected 0.0..1.0, got 1.5"),
        (["--walk", "99,1"], "nobody can stand in room 99"),
        (["--walk", "here"], "walk: expected room ids"),
        (["--walk", "1,2", "--agents", "2"], "expected a walk for each of 2 agents, got 1"),
        (["--walk", "500 500; 501 500"], "within 1 m of the waypoint (500, 500) m; the nearest"),
        (["--seed", "-1"], "--seed: expected at least 0, got -1"),
        (["--count", "0"], "--count: expected at least 1, got 0"),
    ],
)
def test_what_cannot_be_simulated_is_told_in_one_line(tmp_path, capsys, arguments, message):
    assert main(["simulate", SPEC, "-o", str(tmp_path), *arguments]) == 2
    error = capsys.readouterr().err
    assert message in error
    assert error.count("\n") == 1


@pytest.mark.parametrize("listed", [1, 3])
def test_walks_beside_a_building_make_the_agents(tmp_path, capsys, monkeypatch, listed):
    walks = [Trajectory(f"robot{k}", (1,), np.zeros((0, 3))) for k in range(listed)]
    walked = replace(load_building(SPEC), trajectories=tuple(walks))
    monkeypatch.setattr(buildings, "load_building", lambda spec: walked)
    file = tmp_path / "f.yaml"
    file.write_text("sensor: {lidar: {rings: 8, azimuths: 60}}\n")
    command = ["simulate", SPEC, "-o", str(tmp_path), "--config", str(file)]
    assert main([*command, "--overlap", "0.5"]) == 0
    said = capsys.readouterr().out
    assert said.count("points in 1 rooms") == listed
    assert ("a–c" in said) == (listed == 3)
    assert "warning: overlap: not sought" in said
    assert main([*command, "--agents", "2"]) == 2
    assert f"expected a walk for each of 2 agents, got {listed}" in capsys.readouterr().err


def test_a_case_leaves_nothing_of_the_one_before_it(ready, tmp_path):
    write_case(simulate(ready, configured(agents=3), 1), tmp_path, "maps")
    (tmp_path / "notes.txt").write_text("kept")
    write_case(simulate(ready, configured(agents=1), 1, ONE_WALK[:1]), tmp_path)
    names = {path.name for path in tmp_path.iterdir()}
    own = {"a.ply", "a.trajectories.json", "truth.json", "truth.npz"}
    assert names == {*own, "notes.txt"}
    truth = json.loads((tmp_path / "truth.json").read_text())
    assert truth["room_names"] == [room.name for room in ready.building.rooms]
    write_case(simulate(ready, configured(agents=1), 1, ONE_WALK[:1]), tmp_path, "maps")
    (tmp_path / "bag" / "mine.mcap.txt").write_text("kept")
    with pytest.raises(RecordingError, match="exists"):
        write_case(simulate(ready, configured(agents=1), 1, ONE_WALK[:1]), tmp_path, "maps")


@pytest.mark.parametrize(
    ("cells", "told"),
    [([0.1, 0.2, 0.3], "at most 2.*0.3"), (["fine"], "each 0.0..1.0 m, got.*fine")],
)
def test_resolutions_are_checked_before_anything_is_scanned(ready, cells, told):
    with pytest.raises(ConfigurationError, match=rf"degrade\.resolutions: expected .*{told}"):
        simulate(ready, configured(degrade__resolutions=cells), 1, ONE_WALK)


def test_a_parameter_file_is_checked(tmp_path):
    file = tmp_path / "f.yaml"
    file.write_text("degrade: {dropuot: 0.1}")
    with pytest.raises(ConfigurationError, match=r"degrade.dropuot"):
        load_simulation_config(file)
    with pytest.raises(TrajectoryError, match="expected room ids"):
        parse_walk("1 2 3 4; 5 6")
