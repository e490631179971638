"""The command line's contract: files, JSON, exit statuses and one line for every bad input."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from test.helpers import box_room, moved, yaw_transform
from test.helpers_bags import flat, write_map_bag, write_scan_bag
from topometric_ros.cli import run
from topometric_ros.cli.main import main
from topometric_ros.io.map_files import load_map
from topometric_ros.io.ply import read_ply_points
from topometric_ros.runtime.bag_sources import readable

LIMIT_S = 120.0


@pytest.fixture(scope="module")
def clouds(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the same flat seen by two agents: a.npy and b.npy, some points not finite."""
    folder = tmp_path_factory.mktemp("clouds")
    np.save(folder / "a.npy", np.vstack([flat(), np.full((3, 3), np.nan)]))
    np.save(folder / "b.npy", moved(flat(), yaw_transform(1.0, (2, 3, 0))))
    return folder


@pytest.fixture(scope="module")
def extracted(clouds: Path) -> Path:
    """The output folder of `extract` on the flat of agent a."""
    assert main(["extract", str(clouds / "a.npy"), "-o", str(clouds / "A")]) == 0
    return clouds / "A"


def fails(arguments: Sequence[object], capsys: pytest.CaptureFixture[str]) -> str:
    """Assert that a command ends with status 2 and one line on stderr; return the line."""
    assert main([str(argument) for argument in arguments]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.count("\n") == 1
    assert captured.err.startswith("topometric: error: ")
    return captured.err.strip()


@pytest.mark.parametrize("command", ["extract", "merge", "replay", "run"])
def test_a_command_is_read_before_the_stages_are_imported(command: str) -> None:
    code = (
        "import argparse, sys\n"
        f"from topometric_ros.cli import {command}\n"
        f"{command}.add_parser(argparse.ArgumentParser().add_subparsers())\n"
        "heavy = {'numpy', 'numba', 'scipy', 'networkx', 'rosbags', 'matplotlib', 'rclpy'}\n"
        "print(sorted(heavy & {*sys.modules}))\n"
    )
    told = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert told.stdout.strip() == "[]"


def test_extract_writes_the_contract_s_files(extracted: Path) -> None:
    assert {p.name for p in extracted.iterdir()} == {
        *("map.json", "rooms.ply", "map.tmap", "timings.json")
    }
    summary = json.loads((extracted / "map.json").read_text())
    assert (summary["schema"], summary["agent"]) == ("topometric-map/1", "a")
    assert "3 of" in summary["warnings"][0]
    m = load_map(extracted / "map.tmap")
    assert len(m.rooms) == len(summary["rooms"]) >= 2
    assert len(read_ply_points(extracted / "rooms.ply")) == len(m.voxels)


def test_extract_prints_the_map_as_json(
    clouds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["extract", str(clouds / "b.npy"), "-o", str(tmp_path / "o"), "--json"]
    assert main([*arguments, "--agent", "lift", "--voxel-size", "0.2"]) == 0
    captured = capsys.readouterr()
    printed = json.loads(captured.out)
    timings = printed.pop("timings")
    assert printed == json.loads((tmp_path / "o" / "map.json").read_text())
    assert timings == json.loads((tmp_path / "o" / "timings.json").read_text())
    assert (printed["agent"], printed["voxel_size"]) == ("lift", 0.2)
    assert captured.err == ""


def test_merge_takes_maps_and_clouds_alike(
    clouds: Path, extracted: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    capsys.readouterr()
    sources = [str(extracted / "map.tmap"), f"second={clouds / 'b.npy'}"]
    assert main(["merge", *sources, "-o", str(tmp_path), "--json"]) == 0
    printed = json.loads(capsys.readouterr().out)
    assert printed.pop("timings")
    assert printed == json.loads((tmp_path / "merge.json").read_text())
    assert [agent["id"] for agent in printed["agents"]] == ["a", "second"]
    assert printed["agents"][1]["source"] == str(clouds / "b.npy")
    keys = ["schema", "global_frame", "warnings", "agents", "alignments", "rooms"]
    assert list(printed) == keys
    assert list(printed["alignments"][0]) == [
        *("agents", "status", "reason", "T_a_b", "alternatives"),
        *("score", "confidence", "overlap", "rmse", "inliers", "covariance", "matches"),
    ]
    assert {p.name for p in tmp_path.iterdir()} == {
        *("merge.json", "global.ply", "global.tmap", "report.html", "timings.json")
    }
    header = (tmp_path / "global.ply").read_bytes().split(b"end_header")[0]
    assert b"property int agent\n" in header


def test_maps_that_share_nothing_are_an_answer(extracted: Path, tmp_path: Path) -> None:
    np.save(tmp_path / "c.npy", box_room((0, 0, 0), (3, 3, 2.5), (("x+", 1.0),)))
    out = tmp_path / "out"
    sources = [str(extracted / "map.tmap"), str(tmp_path / "c.npy")]
    assert main(["merge", *sources, "-o", str(out)]) == 0
    result = json.loads((out / "merge.json").read_text())
    assert result["alignments"][0]["status"] != "accepted"
    assert result["agents"][1]["T_global_agent"] is None


def test_bad_clouds_end_with_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["-o", tmp_path / "out"]
    np.save(tmp_path / "empty.npy", np.empty((0, 3)))
    np.save(tmp_path / "nan.npy", np.full((4, 3), np.inf))
    (tmp_path / "cut.ply").write_bytes(
        b"ply\nformat binary_little_endian 1.0\nelement vertex 9\nproperty float x\n"
        b"property float y\nproperty float z\nend_header\n" + bytes(50)
    )
    for name, text in (
        ("empty.npy", r"empty\.npy: the cloud is empty"),
        ("nan.npy", r"none of the cloud's 4 points is finite"),
        ("missing.ply", r"missing\.ply: no such file"),
        ("cut.ply", r"cut\.ply: the PLY file ends early: expected \d+ bytes .*got \d+"),
    ):
        assert re.search(text, fails(["extract", tmp_path / name, *out], capsys))
        assert re.search(text, fails(["merge", tmp_path / name, tmp_path / "x.ply", *out], capsys))
    assert not (tmp_path / "out").exists()


def test_a_cloud_without_a_floor_names_the_option(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    y, z = np.meshgrid(np.arange(0, 4, 0.05), np.arange(0, 30, 0.05), indexing="ij")
    np.save(tmp_path / "wall.npy", np.stack([0 * y.ravel(), y.ravel(), z.ravel()], 1))
    line = fails(["extract", tmp_path / "wall.npy", "-o", tmp_path / "out"], capsys)
    assert "--up" in line


def test_a_tilted_cloud_works_with_a_warning(tmp_path: Path) -> None:
    tilt = np.eye(4)
    tilt[1:3, 1:3] = [[np.cos(0.06), -np.sin(0.06)], [np.sin(0.06), np.cos(0.06)]]
    np.save(tmp_path / "tilted.npy", moved(flat(), tilt))
    assert main(["extract", str(tmp_path / "tilted.npy"), "-o", str(tmp_path / "o")]) == 0
    summary = json.loads((tmp_path / "o" / "map.json").read_text())
    assert any("tilt" in warning for warning in summary["warnings"])
    assert len(summary["rooms"]) >= 2


def test_bad_bags_end_with_status_2(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = ["-o", tmp_path / "out"]
    good = write_scan_bag(tmp_path / "good", flat()[:500], "/r1")
    broken = write_map_bag(tmp_path / "broken", {"/cloud_map": flat()[:500]}, point_step=8)
    cut = write_map_bag(tmp_path / "cut", {"/cloud_map": flat()[:500]})
    whole = (cut / "cut.mcap").read_bytes()
    (cut / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    (tmp_path / "void").mkdir()
    for source, text in (
        (f"{good}:/cloud_map", r"no topic /cloud_map; the bag has: /r1/scan_cloud \(sensor_msgs"),
        (broken, "no message could be used: PointCloud2 point_step: expected at least 12 bytes"),
        (cut, r"cut\.mcap: the MCAP file ends early"),
        (tmp_path / "void", "not a bag: the directory holds no"),
    ):
        for command in ("extract", "replay"):
            assert re.search(text, fails([command, source, *out], capsys))
    assert "no such bag" in fails(["replay", tmp_path / "none", *out], capsys)
    np.save(tmp_path / "a.npy", flat())
    assert "not a bag" in fails(["replay", tmp_path / "a.npy", *out], capsys)


def test_two_agents_of_one_name_are_refused(
    clouds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    sources = [clouds / "a.npy", f"a={clouds / 'b.npy'}"]
    assert "two sources are named 'a'" in fails(["merge", *sources, "-o", tmp_path], capsys)
    line = fails(["merge", clouds / "a.npy", "-o", tmp_path], capsys)
    assert "at least two sources, got 1" in line


def test_wrong_settings_end_with_status_2(
    clouds: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    base = ["extract", clouds / "a.npy", "-o", tmp_path / "o"]
    assert "expected 0.02..1.0 m, got 7.0" in fails([*base, "--voxel-size", "7"], capsys)
    assert "neither a preset" in fails([*base, "--config", "nowhere.yaml"], capsys)
    (tmp_path / "file").write_text("")
    line = fails(["extract", clouds / "a.npy", "-o", tmp_path / "file" / "o"], capsys)
    assert "file" in line
    (tmp_path / "bad.tmap").write_bytes(b"TMAP\x07\x00" + bytes(20))
    line = fails(["merge", tmp_path / "bad.tmap", clouds / "a.npy", "-o", tmp_path], capsys)
    assert "version 7 is not known" in line
    with pytest.raises(SystemExit) as caught:
        main(["extract", str(clouds / "a.npy")])
    assert caught.value.code == 2
    told = capsys.readouterr().err.splitlines()
    assert told == [
        "topometric: error: the following arguments are required: -o/--output "
        "(see topometric extract --help)"
    ]
    line = fails(["extract", f"my robot={clouds / 'a.npy'}", "-o", tmp_path], capsys)
    assert "agent 'my robot': expected letters" in line
    prior = "between: [a, bob], position: [0, 0, 0], yaw: 0"
    both = [f"a={clouds / 'a.npy'}", f"b={clouds / 'b.npy'}"]
    line = fails(["merge", *both, "-o", tmp_path / "m", "--prior", prior], capsys)
    assert "--prior: the prior of a and bob names bob; agents are a, b" in line
    line = fails(["extract", clouds / "a.npy", "-o", tmp_path, "--agent", "../a"], capsys)
    assert "agent '../a': expected letters" in line
    (tmp_path / "loop.yaml").write_text("extraction: &a {level: *a}")
    line = fails([*base, "--config", tmp_path / "loop.yaml"], capsys)
    assert "refers to what holds it" in line
    with pytest.raises(SystemExit):
        main(["replay", "a.bag", "-o", str(tmp_path / "o"), "--every", "-1"])
    assert "--every: expected a number of seconds from 0 on, got '-1'" in capsys.readouterr().err


def test_a_file_whose_name_is_no_utf8_gets_a_name_that_can_be_written() -> None:
    assert readable("caf\udce9") == "caf?"


def test_run_ends_its_processes_with_a_signal_and_says_which_one_ended(tmp_path: Path) -> None:
    (tmp_path / "agents.yaml").write_text("agents: [{id: a}, {id: b}]\n")
    script = (
        "import sys, time\n"
        "from topometric_ros.cli import run\n"
        "run._executable = lambda name: [sys.executable, '-c', {child!r}]\n"
        "from topometric_ros.cli.main import main\n"
        "sys.exit(main(['run', sys.argv[1]]))\n"
    )
    lasting = "import time, signal; time.sleep(60)"
    ending = "import sys; sys.exit(3)"
    command = [sys.executable, "-c", script.format(child=lasting), str(tmp_path / "agents.yaml")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    assert process.stderr is not None
    lines = [process.stderr.readline() for _ in range(3)]
    assert [line.split(":")[1].strip() for line in lines] == [
        *("extractor of a", "extractor of b", "merger")
    ]
    process.send_signal(signal.SIGTERM)
    assert process.wait(LIMIT_S) == 0
    process.stderr.close()
    command[2] = script.format(child=ending)
    ended = subprocess.run(command, stderr=subprocess.PIPE, text=True, timeout=LIMIT_S, check=False)
    assert ended.returncode == 1
    assert re.search(r"ended with status 3; the others were ended", ended.stderr)


@pytest.mark.parametrize(("status", "left"), [(9, True), (2, False)])
def test_run_starts_again_what_ended_but_not_what_refused_its_parameters(
    status: int,
    left: bool,
    tmp_path: Path,
    capfd: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setattr(run, "RESPAWN_S", 0.1)
    mark = tmp_path / "mark"
    child = (
        "import pathlib, signal, sys, time\n"
        f"mark = pathlib.Path({str(mark)!r})\n"
        "signal.signal(signal.SIGTERM, lambda *_: sys.exit(0))\n"
        f"mark.exists() or (mark.touch(), sys.exit({status}))\n"
        "mark.with_suffix('.again').touch()\n"
        "time.sleep(60)\n"
    )
    fleet = run._Fleet({"node": [sys.executable, "-c", child]}, os.environ, respawn=True)

    def stop() -> None:
        limit = time.monotonic() + LIMIT_S
        while not mark.with_suffix(".again").exists() and time.monotonic() < limit:
            time.sleep(0.05)
        fleet._stop(signal.SIGTERM, None)

    if left:
        threading.Thread(target=stop, daemon=True).start()
    assert fleet.run() == (0 if left else 1)
    told = capfd.readouterr().err
    assert told.count("topometric: node: process") == (2 if left else 1)
    assert (f"ended with status {status}; it is started again" in told) == left


def test_a_wrong_agents_file_ends_with_status_2(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "cannot read agents file" in fails(["run", tmp_path / "none.yaml"], capsys)
    assert "expected either AGENTS.yaml or --simulate" in fails(["run"], capsys)
    assert "--agents: expected 1 to 26" in fails(["run", "--simulate", "x", "--agents", 0], capsys)
    simulated = ["run", "--simulate", "office:rooms=4"]
    for option in ("--params-file", "--fastdds-profile"):
        assert "no file nowhere" in fails([*simulated, option, "nowhere"], capsys)


def test_run_tells_its_nodes_what_the_launch_file_tells_them(tmp_path: Path) -> None:
    (tmp_path / "agents.yaml").write_text("agents: [{id: a}]\n")
    (tmp_path / "params.yaml").write_text("/**: {ros__parameters: {voxel_size: 0.2}}\n")
    say = (  # in one write: both nodes share this pipe
        "import os, sys\n"
        "told = [os.environ['FASTRTPS_DEFAULT_PROFILES_FILE'], *sys.argv[1:]]\n"
        "os.write(1, (' '.join(told) + os.linesep).encode())"
    )
    script = (
        "import sys\n"
        "from topometric_ros.cli import run\n"
        f"run._executable = lambda name: [sys.executable, '-c', {say!r}, name]\n"
        "from topometric_ros.cli.main import main\n"
        "sys.exit(main(['run', *sys.argv[1:]]))\n"
    )
    options = ["--params-file", tmp_path / "params.yaml", "--use-sim-time", "--managed", "-v"]
    told = subprocess.run(
        [sys.executable, "-c", script, tmp_path / "agents.yaml", *map(str, options)],
        env={k: v for k, v in os.environ.items() if k != "FASTRTPS_DEFAULT_PROFILES_FILE"},
        capture_output=True,
        text=True,
        timeout=LIMIT_S,
        check=False,
    )
    lines = sorted(line.split() for line in told.stdout.splitlines())
    assert lines, told.stderr
    assert {line[1] for line in lines} <= {"managed_extractor", "managed_merger"}
    for profile, _, *arguments in lines:
        assert Path(profile).name == "fastdds_large_clouds.xml"
        assert arguments[:3] == ["--ros-args", "--log-level", "debug"]
        assert "use_sim_time:=true" in arguments
        assert arguments[arguments.index("--params-file") + 1] == str(tmp_path / "params.yaml")
