"""Where agents walked: written by what knows the poses, read with every map, drawn over it."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from test.helpers import moved
from test.test_stages import two_rooms
from topometric_ros.cli.main import main
from topometric_ros.extraction.config import extraction_preset
from topometric_ros.io.map_files import save_map
from topometric_ros.io.trajectories import (
    AgentTrajectory,
    TrajectoryError,
    read_trajectories,
    trajectories_path,
    trajectory_of,
    write_trajectories,
)
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.runtime.config import load_config
from topometric_ros.runtime.extractor_session import ExtractorSession
from topometric_ros.runtime.sources import InputOptions, load_sources
from topometric_ros.visualization.trajectories import legs_of
from topometric_ros.visualization.view_sources import load_view

WAY = np.array([[0.5, 0.5, 1.2], [3.0, 1.5, 1.2], [6.0, 1.5, 1.2]])


def a_trajectory(agent: str = "anna", places: np.ndarray = WAY) -> AgentTrajectory:
    return AgentTrajectory(agent, "map", np.arange(len(places), dtype=np.int64), places)


def turned() -> np.ndarray:
    """Return a transform of a quarter turn and a shift."""
    T = np.eye(4)
    T[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]
    T[:3, 3] = 5.0, -2.0, 0.3
    return T


def test_a_session_notes_where_its_scans_were_made_and_not_how_often():
    session = ExtractorSession("anna", extraction_preset("default"), MatchingConfig(), lambda: "s")
    assert session.trajectory is None
    for stamp, x in enumerate([0.0, 0.01, 0.02, 1.0, 1.05, 2.0]):
        T = np.eye(4)
        T[0, 3] = x
        session.add_scan(np.ones((1, 3)), "map", stamp, T)
    way = session.trajectory
    assert way is not None
    assert way.positions[:, 0].tolist() == [0.0, 1.0, 2.0]
    assert way.stamps.tolist() == [0, 3, 5]
    session.reset()
    assert session.trajectory is None


def test_a_file_is_read_as_it_was_written_and_goes_with_the_last_trajectory(tmp_path: Path):
    write_trajectories(tmp_path / "map.tmap", [a_trajectory(), a_trajectory("bob", WAY[:0])])
    anna, bob = read_trajectories(tmp_path / "map.tmap")
    assert (anna.agent, anna.frame_id, len(bob.positions)) == ("anna", "map", 0)
    np.testing.assert_array_equal(anna.positions, WAY)
    assert trajectory_of(tmp_path / "map.tmap", "carl") is None
    write_trajectories(tmp_path / "map.tmap", [])
    assert not trajectories_path(tmp_path / "map.tmap").exists()


@pytest.mark.parametrize(
    "text",
    [
        "[",
        "[" * 100_000,
        '{"schema": "other/1", "agents": []}',
        '{"schema": "topometric-trajectories/1", "agents": '
        '[{"id": "a", "frame_id": "", "stamps": [1], "positions": []}]}',
    ],
)
def test_a_damaged_file_costs_one_line(tmp_path: Path, text: str):
    trajectories_path(tmp_path / "a.ply").write_text(text, encoding="utf-8")
    with pytest.raises(TrajectoryError, match=r"a.trajectories.json: not a file of traj"):
        read_trajectories(tmp_path / "a.ply")


def test_a_trajectory_comes_with_its_map_under_the_agents_new_name(tmp_path: Path):
    save_map(tmp_path / "x.tmap", two_rooms())
    write_trajectories(tmp_path / "x.tmap", [a_trajectory()])
    (loaded,) = load_sources([f"bob={tmp_path / 'x.tmap'}"], load_config("default"))
    assert loaded.trajectory is not None
    assert loaded.trajectory.agent == loaded.map.agent == "bob"


def test_a_view_has_trajectories_in_the_global_frame(tmp_path: Path):
    m = replace(two_rooms(), agent="global")
    everybody = np.full(len(m.voxels), 3, np.uint32)
    save_map(tmp_path / "global.tmap", m, everybody, ("anna", "bob", "carl"))
    ways = [a_trajectory(), a_trajectory("bob", moved(WAY, np.linalg.inv(turned())))]
    write_trajectories(tmp_path / "global.tmap", [*ways, a_trajectory("carl")])
    transforms = {"anna": np.eye(4).tolist(), "bob": turned().tolist(), "carl": None}
    agents = [{"id": name, "T_global_agent": T} for name, T in transforms.items()]
    summary = {"agents": agents, "alignments": []}
    (tmp_path / "merge.json").write_text(json.dumps(summary), encoding="utf-8")
    view = load_view(str(tmp_path), load_config("default"), InputOptions(), lambda _: None)
    assert [way.agent for way in view.trajectories] == ["anna", "bob"]
    for way in view.trajectories:
        np.testing.assert_allclose(way.positions, moved(WAY, m.T_level_input), atol=1e-3)
    pictures = ["--stage", "trajectories", "--save", str(tmp_path / "pictures")]
    assert main(["view", str(tmp_path), *pictures]) == 0
    picture = tmp_path / "pictures" / "stage_trajectories.png"
    assert picture.read_bytes().startswith(b"\x89PNG")


def test_no_trajectory_is_told_with_what_would_tell_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    save_map(tmp_path / "map.tmap", two_rooms())
    assert main(["view", str(tmp_path), "--stage", "trajectories", "--save", str(tmp_path)]) == 2
    assert "stage trajectories: nothing says where the agents were" in capsys.readouterr().err


def test_a_way_over_stairs_has_no_gap():
    m = two_rooms()
    upper = replace(m.storeys[0], id=1, floor_z=3.0, ceiling_z=None)
    m = replace(m, storeys=(*m.storeys, upper))
    places = np.array([[0, 0, 1.2], [1, 0, 2.0], [2, 0, 4.2], [3, 0, 4.2]])
    legs = list(legs_of(m, a_trajectory(places=places)))
    assert [storey for storey, _ in legs] == [0, 1]
    np.testing.assert_array_equal(legs[0][1][-1], legs[1][1][0])
