"""Stages of the extraction are drawn from a map; what cannot be drawn is told in a line."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

from test.helpers import box_room
from topometric_ros.cli.main import main
from topometric_ros.extraction.config import extraction_preset
from topometric_ros.extraction.pipeline import extract
from topometric_ros.io.map_files import save_map
from topometric_ros.io.trajectories import AgentTrajectory, write_trajectories
from topometric_ros.topometric_map import NO_ROOM, TopometricMap
from topometric_ros.visualization.stage_files import stage_names
from topometric_ros.visualization.stages import STAGES, Stages
from topometric_ros.visualization.view import ViewError

CONFIG = replace(extraction_preset("default"), voxel_size=0.2)
NOTHING = np.empty((0, 3), np.int32)


@lru_cache(maxsize=1)
def two_rooms() -> TopometricMap:
    """Return the map of two rooms with a door between them."""
    left = box_room((0.0, 0.0, 0.0), (4.0, 3.0, 2.6), (("x+", 1.5),), 0.05)
    right = box_room((4.1, 0.0, 0.0), (3.0, 3.0, 2.6), (("x-", 1.5),), 0.05)
    return extract(np.concatenate([left, right]), CONFIG, agent="anna").map


def write_merge(folder: Path, source: str, rooms: tuple[int, int]) -> None:
    """Write what stage `matches` reads of a merge of a map with itself."""
    alignment = {"agents": ["anna", "bob"], "status": "accepted", "reason": "they fit"}
    alignment |= {"T_a_b": np.eye(4).tolist(), "matches": [[*rooms, 0.1]]}
    agents = [{"id": name, "source": source} for name in ("anna", "bob")]
    summary = {"agents": agents, "alignments": [alignment]}
    (folder / "merge.json").write_text(json.dumps(summary), encoding="utf-8")


def test_every_stage_is_drawn_without_a_display(tmp_path: Path):
    m = two_rooms()
    save_map(tmp_path / "map.tmap", m)
    write_merge(tmp_path, "map.tmap", (m.rooms[0].id, m.rooms[1].id))
    places = np.array([[1.0, 1.5, 1.2], [6.0, 1.5, 1.2]])
    way = AgentTrajectory("anna", "map", np.arange(2, dtype=np.int64), places)
    write_trajectories(tmp_path / "map.tmap", [way])
    pictures = tmp_path / "pictures"
    assert main(["view", str(tmp_path), "--stage", "all", "--save", str(pictures)]) == 0
    names = {f"stage_{stage}.png" for stage in (*STAGES, "similarity_graph")}
    assert {path.name for path in pictures.iterdir()} == names
    assert all(path.read_bytes().startswith(b"\x89PNG") for path in pictures.iterdir())


@pytest.mark.parametrize("stage", ["navigable", "distance"])
def test_a_gap_of_one_voxel_shows(stage: str):
    m = two_rooms()
    middle = int(np.argmax(Stages(m, CONFIG).distance))
    gap = replace(m, navigable=np.delete(m.navigable, middle, axis=0))
    assert Stages(m, CONFIG).pictures(stage) != Stages(gap, CONFIG).pictures(stage)


@pytest.mark.parametrize("stage", ["distance", "isovist"])
def test_the_same_map_gives_the_same_picture(stage: str):
    assert Stages(two_rooms(), CONFIG).pictures(stage) == Stages(two_rooms(), CONFIG).pictures(
        stage
    )


@pytest.mark.parametrize(
    ("stage", "lacking"),
    [
        ("navigable", {"navigable": NOTHING}),
        ("distance", {"navigable": NOTHING}),
        ("isovist", {"viewpoints": NOTHING.astype(np.float32)}),
        ("similarity", {"viewpoints": NOTHING.astype(np.float32)}),
        ("rooms", {}),
    ],
)
def test_a_stage_that_a_map_cannot_show_is_told(stage: str, lacking: dict):
    m = two_rooms()
    room = np.full(len(m.room), NO_ROOM, np.int32)
    m = replace(m, rooms=(), passages=(), descriptors=(), room=room, **lacking)
    with pytest.raises(ViewError, match=f"stage {stage}: the map holds no "):
        Stages(m, CONFIG).pictures(stage)


def test_a_map_with_one_viewpoint_has_every_picture_of_its_own():
    one = replace(two_rooms(), viewpoints=two_rooms().viewpoints[:1])
    assert all(Stages(one, CONFIG).pictures(stage) for stage in STAGES[:-2])


def test_all_leaves_out_what_cannot_be_shown(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    bare = replace(two_rooms(), viewpoints=NOTHING.astype(np.float32))
    save_map(tmp_path / "map.tmap", bare)
    pictures = tmp_path / "pictures"
    assert main(["view", str(tmp_path), "--stage", "all", "--save", str(pictures)]) == 0
    assert (pictures / "stage_rooms.png").is_file()
    assert not (pictures / "stage_isovist.png").exists()
    said = capsys.readouterr().err
    assert "stage isovist: the map holds no viewpoints" in said
    assert "stage matches: only the output folder of merge or replay" in said


@pytest.mark.parametrize(
    ("source", "room", "told"),
    [("gone.tmap", 0, "gone.tmap, which agent 'anna' came from"), ("map.tmap", 77, "no room 77")],
)
def test_matches_without_their_maps_are_told(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], source: str, room: int, told: str
):
    save_map(tmp_path / "map.tmap", two_rooms())
    write_merge(tmp_path, source, (room, 0))
    assert main(["view", str(tmp_path), "--stage", "matches", "--save", str(tmp_path)]) == 2
    assert told in capsys.readouterr().err


def test_a_mistyped_stage_costs_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["view", "x.tmap", "--stage", "isovit", "--save", str(tmp_path)]) == 2
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert "unknown stage 'isovit'; known: navigable, distance" in line
    assert stage_names(["all", "rooms"]) == STAGES
