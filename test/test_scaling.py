"""Scaling: the points are where rooms are seen from inside, a run goes on, the tables are whole."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from topometric_ros.cli.main import main
from topometric_ros.evaluation import scaling
from topometric_ros.evaluation.benchmark import BenchmarkError
from topometric_ros.evaluation.processes import ProcessError, in_own_process, peak_mb
from topometric_ros.evaluation.scaling import (
    Size,
    extract_maps,
    merge_maps,
    read_scaling,
    run_scaling,
    sample_clouds,
    seconds_of,
    sizes_of,
    write_scaling,
)
from topometric_ros.evaluation.scaling_tables import scaling_picture, scaling_tables
from topometric_ros.runtime.config import preset_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.surfaces import sampled_surfaces

MEASURES = {
    **{"true_rooms": 12.0, "points": 300000.0, "voxels": 9000.0, "map_bytes": 2048.0},
    **{"extract.thin": 0.5, "extract.rooms": 1.5, "extract.peak_mb": 300.0},
    **{"merge.search": 0.25, "merge.peak_mb": 310.0, "global_bytes": 4096.0},
    **{"rooms_found": 11.0, "true_links": 13.0, "passages_found": 10.0},
    **{"pairs": 1.0, "sharing": 1.0, "accepted": 1.0, "wrong": 0.0},
}


def test_surfaces_are_sampled_evenly_on_the_inside_of_rooms():
    building = load_building("office:seed=1,rooms=3,furniture=0,windows=false")
    points = sampled_surfaces(building, (0.0, 4.0), np.random.default_rng(0), noise=0.0)
    assert points[:, 0].min() >= 0.0
    assert points[:, 0].max() <= 4.0
    assert points[:, 2].min() == pytest.approx(0.0)
    assert points[:, 2].max() == pytest.approx(2.7)
    room = max(building.rooms, key=lambda room: (room.polygon[:, 0].max() <= 4.0, room.id))
    low, high = room.polygon.min(axis=0) + 0.2, room.polygon.max(axis=0) - 0.2
    floor = points[(points[:, 2] < 0.01) & ((points[:, :2] > low) & (points[:, :2] < high)).all(1)]
    # One point in every 5 cm square, and never a square of 10 cm without one.
    assert len(floor) == pytest.approx(np.prod(high - low) / 0.05**2, rel=0.05)
    cells = np.unique(((floor[:, :2] - low) / 0.1).astype(int), axis=0)
    assert len(cells) >= np.prod(np.floor((high - low) / 0.1))


def test_doorways_are_sampled_up_to_their_lintels_and_become_passages():
    building = load_building("office:seed=1,rooms=3,furniture=0,windows=false")
    x = building.vertices[:, 0]
    points = sampled_surfaces(building, (x.min(), x.max()), np.random.default_rng(0), noise=0.0)
    assert building.links
    for link in building.links:
        near = np.abs(points[:, :2] - link.position[:2]).max(axis=1) < 0.05
        heights = np.unique(points[near, 2].round(3))
        # Floor and lintel, and nothing of what lies hidden in the wall above.
        assert heights.tolist() == [0.0, 2.1]
    config = preset_config("default")
    found = extract_map(points, config.extraction, config.merge.matching, agent="a", session="a")
    near = [
        min(np.linalg.norm(np.subtract(p.position, link.position)[:2]) for p in found.map.passages)
        for link in building.links
    ]
    assert max(near) < 0.5


def test_no_two_agents_sample_the_same_points():
    building = load_building("office:seed=1,rooms=3")
    one, other = (
        sampled_surfaces(building, (0.0, 4.0), np.random.default_rng(seed)) for seed in (0, 1)
    )
    assert not set(map(tuple, one.round(5))) & set(map(tuple, other.round(5)))


def test_buildings_grow_with_few_agents_and_agents_in_the_middle_building():
    assert sizes_of([100, 10, 30], [5, 2]) == [Size(10, 2), Size(30, 2), Size(100, 2), Size(30, 5)]
    with pytest.raises(BenchmarkError, match="2 and more agents"):
        sizes_of([10], [1])
    with pytest.raises(BenchmarkError, match="at most 32"):
        sizes_of([10], [33])


def test_a_small_building_is_measured_step_by_step(tmp_path: Path):
    size = Size(3, 2)
    measures: dict[str, float] = {}
    for step in (sample_clouds, extract_maps, merge_maps):
        measures |= step(size, tmp_path)
    assert set(MEASURES) <= set(measures)
    assert "peak_mb" not in seconds_of(measures, "extract")
    assert measures["extract.peak_mb"] > 50
    assert measures["pairs"] == 1
    assert measures["passages_found"] >= measures["true_links"] / 2
    assert 0 < measures["map_bytes"] < 12 * measures["points"]
    assert measures["wrong"] <= measures["accepted"] <= 1


def test_a_run_goes_on_where_it_stopped_and_tries_again_what_failed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    asked = []

    def measured(size: Size, *, timeout: float) -> dict[str, float]:
        asked.append(size)
        if size.rooms == 30:
            raise ProcessError("ended after 1 s")
        return MEASURES

    monkeypatch.setattr(scaling, "measure", measured)
    sizes = [Size(10, 2), Size(30, 2)]
    known, failed = run_scaling(sizes, tmp_path)
    assert (known, failed) == ({sizes[0]: MEASURES}, {sizes[1]: "ended after 1 s"})
    asked.clear()
    assert run_scaling(sizes, tmp_path)[0] == known
    assert asked[1:] == [Size(30, 2)]
    asked.clear()
    run_scaling(sizes[:1], tmp_path)
    assert not asked
    write_scaling(tmp_path / "scaling.csv", {sizes[0]: {"points": 1.0}})
    assert run_scaling(sizes[:1], tmp_path)[0] == {sizes[0]: MEASURES}


def test_rows_come_back_and_others_are_refused(tmp_path: Path):
    write_scaling(tmp_path / "rows.csv", {Size(10, 2): MEASURES})
    assert read_scaling(tmp_path / "rows.csv") == {Size(10, 2): MEASURES}
    (tmp_path / "rows.csv").write_text("a,b\n1,2\n", encoding="utf-8")
    with pytest.raises(BenchmarkError, match="not the rows"):
        read_scaling(tmp_path / "rows.csv")


def test_the_command_writes_tables_and_a_picture(tmp_path: Path, capsys, monkeypatch):
    monkeypatch.setattr(scaling, "measure", lambda size, timeout: MEASURES)
    command = ["benchmark", "--scaling", "-o", str(tmp_path), "--rooms", "10", "--agents", "2", "5"]
    assert main(command) == 0
    said = capsys.readouterr().out
    assert said == (tmp_path / "scaling.md").read_text(encoding="utf-8")
    assert "| 10 × 2 | 12 | 11 | 13 | 10 | 300,000 | 2.0 | 0.2 |" in said
    assert "| 10 × 5 |" in said
    assert (tmp_path / "scaling.png").read_bytes().startswith(b"\x89PNG")
    assert main(["benchmark", "-o", str(tmp_path)]) == 2
    assert main(["benchmark", "pairs", *command[1:]]) == 2


def test_equal_measures_make_equal_pictures_and_failures_are_told():
    known = {Size(10, 2): MEASURES}
    assert scaling_picture(known) == scaling_picture(known)
    said = scaling_tables(known, {Size(30, 2): "ended after 1 s"})
    assert "- 30 × 2: ended after 1 s" in said


def test_work_in_its_own_process_answers_raises_or_is_ended():
    assert in_own_process(peak_mb, timeout=300.0) > 1.0
    with pytest.raises(ProcessError, match="ValueError: invalid literal"):
        in_own_process(int, "x", timeout=300.0)
