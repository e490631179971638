"""A scene's own maps as agents: the truth is where the data set puts them."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from test.helpers import box_room
from topometric_ros.cli.main import main
from topometric_ros.evaluation.benchmark_pairs import find_pairs
from topometric_ros.evaluation.evaluate_case import load_case
from topometric_ros.evaluation.suite import RELEASED, parse_suite
from topometric_ros.io.ply import write_ply
from topometric_ros.simulation.case import CaseError
from topometric_ros.simulation.released import released_case

ROOMS = {
    "hall": ((0, 0, 0), (7, 3, 2.6), (("y+", 1.5), ("y+", 5.5))),
    "west": ((0, 3.1, 0), (3.4, 4, 2.6), (("y-", 1.5),)),
    "east": ((3.6, 3.1, 0), (3.4, 5, 2.6), (("y-", 1.9),)),
}
T_BUILDING_MESHES = np.array(
    [[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 1.5], [0.0, 0.0, 0.0, 1.0]]
)
"""As a camera's frame is: z ahead, y down."""


def write_cloud(path: Path, points: np.ndarray, labels: np.ndarray | None = None) -> None:
    fields = [(axis, "f4") for axis in "xyz"] + ([] if labels is None else [("label", "i4")])
    table = np.empty(len(points), fields)
    for axis, values in zip("xyz", points.T, strict=True):
        table[axis] = values
    if labels is not None:
        table["label"] = labels
    write_ply(path, table)


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two meshes in the layout of the release: the hall with the west, and with the east."""
    folder = tmp_path_factory.mktemp("cslamd") / "House"
    (folder / "meshes").mkdir(parents=True)
    clouds = {name: box_room(*room) for name, room in ROOMS.items()}
    labels = np.repeat(np.arange(3), [len(cloud) for cloud in clouds.values()])
    write_cloud(folder / "annotation.ply", np.concatenate(list(clouds.values())), labels)
    np.savetxt(folder / "meshes.txt", T_BUILDING_MESHES)
    back = np.linalg.inv(T_BUILDING_MESHES)
    for name in ("west", "east"):
        points = np.concatenate([clouds["hall"], clouds[name]])
        write_cloud(folder / "meshes" / f"{name}.ply", points @ back[:3, :3].T + back[:3, 3])
    return folder


def test_the_maps_of_a_scene_are_agents_in_frames_of_their_own(scene: Path) -> None:
    suite = parse_suite({"released": ["{data}/House"], "data": str(scene.parent)})
    (spec,) = suite.cases
    assert (spec.group, spec.agents) == ("released maps", RELEASED)
    case = load_case(spec)
    east, west = case.agents
    assert [agent.rooms_walked for agent in case.agents] == [(0, 2), (0, 1)]
    halls = [agent.points[agent.room == 0] for agent in case.agents]
    (pair,) = case.pairs
    assert pair.T_a_b is not None
    moved = halls[1] @ pair.T_a_b[:3, :3].T + pair.T_a_b[:3, 3]
    np.testing.assert_allclose(moved, halls[0], atol=1e-4)
    assert 0.3 < pair.overlap < 0.7
    # Level, with the floor below the ceiling, and nowhere near each other.
    for agent in case.agents:
        np.testing.assert_allclose(agent.T_agent_building[2, :3], [0.0, 0.0, 1.0], atol=1e-12)
    assert np.linalg.norm(east.points.mean(axis=0) - west.points.mean(axis=0)) > 1.0


def test_a_scene_is_evaluated_like_any_case_and_is_no_pair(scene: Path, tmp_path: Path) -> None:
    suite = tmp_path / "suite.yaml"
    suite.write_text(json.dumps({"released": [str(scene)], "presets": ["default"]}))
    assert not find_pairs([str(suite)], tmp_path).pairs
    assert main(["evaluate", str(suite), "-o", str(tmp_path), "--jobs", "1"]) == 0
    with (tmp_path / "rows.csv").open(newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert row["case"] == "House released maps"
    assert not row["failed"]
    assert row["rooms_walked"]


def test_a_scene_of_one_map_is_refused(scene: Path, tmp_path: Path) -> None:
    for name in ("annotation.ply", "meshes/west.ply"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes((scene / name).read_bytes())
    with pytest.raises(CaseError, match="expected 2 to 26 maps as agents, got 1"):
        released_case(tmp_path, 0)
