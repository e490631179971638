"""The page shows every stage in 3D; what it cannot show it tells where it would stand."""

from __future__ import annotations

import base64
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from test.helpers_browser import CHROMIUM, BrowserPage
from test.test_stages import NOTHING, two_rooms, write_merge
from test.test_view import opened_in_browser, page_data
from topometric_ros.cli.main import main
from topometric_ros.io.map_files import save_map
from topometric_ros.io.trajectories import AgentTrajectory
from topometric_ros.runtime.config import load_config
from topometric_ros.runtime.sources import InputOptions
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.page_stages import page_stages
from topometric_ros.visualization.stage_files import FileStages
from topometric_ros.visualization.stages import STAGES
from topometric_ros.visualization.view import single_view, view_points
from topometric_ros.visualization.view_page import view_html

WAY = AgentTrajectory(
    "anna", "map", np.arange(2, dtype=np.int64), np.array([[1.0, 1.5, 1.2], [6.0, 1.5, 1.2]])
)


def stages_of(m: TopometricMap, source: str = "x.tmap") -> FileStages:
    config, view = load_config("default"), single_view(m, WAY)
    return FileStages(view, source, config, InputOptions(), lambda _: None)


def decoded(text: str, kind: str) -> np.ndarray:
    return np.frombuffer(base64.b64decode(text), kind)


def test_isovists_are_told_of_the_points_of_the_page():
    stages = stages_of(two_rooms())
    shown, missing = page_stages(stages, ("isovist",))
    assert list(shown) == ["isovist", "rooms"]
    assert not missing
    isovist, seen = shown["isovist"], stages.drawn.seen
    first = isovist["of"][0]
    assert first == np.argmax(seen.sizes())
    assert sorted(isovist["of"]) == list(range(len(seen)))
    assert len(view_points(stages.view).xyz) == len(two_rooms().voxels)
    rows = seen.rows(first)
    steps = np.diff(rows, prepend=-1) - 1
    assert isovist["sizes"][0] == len(rows) + (steps > 127).sum()
    assert sum(isovist["sizes"]) == len(decoded(isovist["rows"], "u1"))


def test_the_matrix_and_the_distances_are_those_of_the_pictures():
    stages = stages_of(two_rooms())
    shown, _ = page_stages(stages)
    matrix = decoded(shown["similarity"]["matrix"], "u1") / 255.0
    np.testing.assert_allclose(matrix, stages.drawn.similarity.ravel(), atol=0.5 / 255 + 1e-9)
    distance = decoded(shown["distance"]["distance"], "<f4")
    np.testing.assert_allclose(distance, stages.drawn.distance, rtol=1e-6)
    assert shown["trajectories"]["ways"][0]["name"] == "anna, 5\u00a0m"


def test_matched_rooms_lie_side_by_side(tmp_path: Path):
    m = two_rooms()
    save_map(tmp_path / "map.tmap", m)
    rooms = (m.rooms[0].id, m.rooms[1].id)
    write_merge(tmp_path, "map.tmap", rooms)
    shown, missing = page_stages(stages_of(m, str(tmp_path)), ("matches",))
    assert not missing
    (pair,) = shown["matches"]["pairs"]
    a, b = (decoded(side["xyz"], "<f4").reshape(-1, 3) for side in pair["sides"])
    apart = [b[:, axis].min() - a[:, axis].max() for axis in (0, 1)]
    assert max(apart) == pytest.approx(2.0, abs=1e-4)
    (link,) = pair["links"]
    assert tuple(link["rooms"]) == rooms
    np.testing.assert_allclose(link["path"][0], m.rooms[0].centroid, atol=0.01)


def test_what_cannot_be_shown_is_told_in_the_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    bare = replace(two_rooms(), viewpoints=NOTHING.astype(np.float32))
    save_map(tmp_path / "map.tmap", bare)
    page = tmp_path / "page.html"
    assert main(["view", str(tmp_path), "-o", str(page)]) == 0
    assert not capsys.readouterr().err
    shown = page_data(page.read_text(encoding="utf-8"))["stages"]
    assert set(shown) == set(STAGES)
    assert shown["isovist"]["missing"] == "the map holds no viewpoints"
    assert shown["trajectories"]["missing"].startswith("nothing says where the agents were")
    assert "--stage all" in shown["matches"]["missing"]
    assert main(["view", str(tmp_path), "-o", str(page), "--stage", "isovist"]) == 2
    assert "stage isovist: the map holds no viewpoints" in capsys.readouterr().err


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the PATH to open the page with")
def test_a_browser_draws_the_stages_that_are_asked_for(tmp_path: Path):
    stages = stages_of(two_rooms())
    shown, _ = page_stages(stages)
    page = tmp_path / "page.html"
    page.write_text(view_html(stages.view, shown), encoding="utf-8")
    dom = opened_in_browser(page, "stage=similarity")
    assert 'data-state="drawn"' in dom
    assert 'data-stage="similarity"' in dom
    assert f"Jaccard index of every two of {len(stages.drawn.seen)} views" in dom
    assert "views by cluster</text>" in dom
    assert "matches side by side (not here)" in dom
    last = shown["isovist"]["of"][-1]
    dom = opened_in_browser(page, f"stage=isovist&view={last}")
    assert 'data-state="drawn"' in dom
    # Counted by the page from what it unpacked.
    assert f'data-seen="{len(stages.drawn.seen.rows(last))}"' in dom
    assert f"seen: {stages.drawn.seen.sizes()[last]:,} voxels" in dom


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the PATH to open the page with")
def test_both_maps_of_a_pair_are_in_the_first_view(tmp_path: Path):
    m = two_rooms()
    save_map(tmp_path / "map.tmap", m)
    write_merge(tmp_path, "map.tmap", (m.rooms[0].id, m.rooms[1].id))
    stages = stages_of(m, str(tmp_path))
    shown, _ = page_stages(stages, ("matches",))
    page = tmp_path / "page.html"
    page.write_text(view_html(stages.view, shown), encoding="utf-8")
    (pair,) = shown["matches"]["pairs"]
    points = [decoded(side["xyz"], "<f4").reshape(-1, 3) for side in pair["sides"]]
    corners = [end(side, axis=0).tolist() for side in points for end in (np.min, np.max)]
    with BrowserPage(page, "stage=matches") as browser:
        canvas = "document.getElementById('plot').getBoundingClientRect()"
        size = browser.value(f"[{canvas}.width, {canvas}.height]")
        pixels = [browser.pixel(place) for place in corners]
    assert ((np.array(pixels) > 0) & (np.array(pixels) < size)).all()
