"""The view shows every room in any browser without a network, and as pictures without a display."""

from __future__ import annotations

import json
import re
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from test.helpers import box_room
from test.helpers_browser import CHROMIUM, FLAGS, BrowserPage
from topometric_ros.cli.main import main
from topometric_ros.io.map_files import save_map
from topometric_ros.topometric_map import (
    NO_ROOM,
    Passage,
    Room,
    Storey,
    StoreyLayers,
    TopometricMap,
)
from topometric_ros.visualization.view import (
    View,
    point_storeys,
    room_shares,
    single_view,
    view_points,
)
from topometric_ros.visualization.view_page import view_html
from topometric_ros.voxels.grid import surface_offsets, voxelise

HOSTILE = "</script><!--<script><b>bob"


def two_rooms() -> TopometricMap:
    """Return a map of a room below another, joined by a passage."""
    low, high = (box_room((0.0, 0.0, z), (4.0, 3.0, 2.6), (), 0.1) for z in (0.0, 3.0))
    points, origin = np.concatenate([low, high]) + 0.05, np.zeros(3)
    grid, cell = voxelise(points, 0.2, origin)
    coords = grid.coords
    room = np.where(coords[:, 2] * 0.2 < 2.8, 4, 7).astype(np.int32)
    empty = np.zeros((1, 1), bool)
    layers = StoreyLayers(0.1, (0.0, 0.0), empty, empty, empty, empty)
    rooms = tuple(
        Room(i, s, (2.0, 1.5, z), ((0.0, 0.0, z), (4.0, 3.0, z + 2.6)), 9, 12.0, False)
        for s, (i, z) in enumerate(((4, 0.0), (7, 3.0)))
    )
    return TopometricMap(
        **{"agent": "anna", "session": "s", "sequence": 1, "frame_id": "map", "stamp": 0},
        voxel_size=0.2,
        origin=(0.0, 0.0, 0.0),
        voxels=coords,
        offsets=surface_offsets(points, grid, cell),
        room=room,
        navigable=np.empty((0, 3), np.int32),
        viewpoints=np.empty((0, 3), np.float32),
        rooms=rooms,
        passages=(Passage((4, 7), (1.0, 1.0, 1.5), 0.9),),
        storeys=(Storey(0, 0.0, 2.6, layers), Storey(1, 3.0, 5.6, layers)),
    )


def two_agents() -> View:
    """Return a view in which one agent saw all and the other the upper room only."""
    m = two_rooms()
    return View("both", m, np.where(m.room == 7, 3, 1).astype(np.uint32), ("anna", HOSTILE))


def page_data(html: str) -> dict:
    found = re.search(r'<script type="application/json" id="data">(.*?)</script>', html, re.DOTALL)
    assert found is not None
    return json.loads(found[1])


def opened_in_browser(page: Path, address: str) -> str:
    """Return what a browser makes of a page; `address` is what follows the #."""
    flags = [f"--user-data-dir={page.with_name('profile')}", "--virtual-time-budget=10000"]
    opened = subprocess.run(
        [str(CHROMIUM), *FLAGS, *flags, "--dump-dom", f"{page.as_uri()}#{address}"],
        capture_output=True,
        text=True,
        timeout=240,
        check=True,
    )
    return opened.stdout


def test_a_page_fetches_nothing():
    html = view_html(single_view(two_rooms()))
    assert "default-src 'none'" in html
    assert not re.search(r"""<(script|img|iframe)[^>]*\bsrc=|<link\b|@import""", html)


def test_a_page_holds_every_room_with_its_attributes():
    data = page_data(view_html(single_view(two_rooms())))
    assert [room["name"] for room in data["rooms"]] == ["room 4", "room 7"]
    attributes = dict(data["rooms"][0]["attributes"])
    assert attributes["area"] == "12.0\u00a0m²"
    assert attributes["passages to"] == "7"
    assert "seen by" not in attributes
    assert data["edges"][0]["storeys"] == [0, 1]


def test_who_saw_a_room_is_told_and_cannot_break_the_page():
    view = two_agents()
    assert room_shares(view, 7) == {"anna": 1.0, HOSTILE: 1.0}
    html = view_html(view)
    data = page_data(html)
    assert [entry["name"] for entry in data["classes"]] == ["anna", f"anna + {HOSTILE}"]
    assert dict(data["rooms"][1]["attributes"])["seen by"] == f"anna (100 %), {HOSTILE} (100 %)"
    assert HOSTILE not in html


def write_merged(folder: Path) -> None:
    """Write a merge of two agents: the upper room is anna's 7 and bob's 2, matched."""
    view = two_agents()
    save_map(folder / "global.tmap", view.map, view.observed_by, ("anna", "bob"))
    alignment = {"agents": ["anna", "bob"], "status": "accepted", "reason": "they fit"}
    alignment |= {"T_a_b": np.eye(4).tolist(), "matches": [[7, 2, 0.1]]}
    rooms = [{"id": 4, "of": [["anna", 4]]}, {"id": 7, "of": [["anna", 7], ["bob", 2]]}]
    agents = [{"id": name, "source": "", "T_global_agent": None} for name in ("anna", "bob")]
    summary = {"agents": agents, "alignments": [alignment], "rooms": rooms}
    (folder / "merge.json").write_text(json.dumps(summary), encoding="utf-8")


def test_a_room_of_a_merged_folder_has_its_match(tmp_path: Path):
    write_merged(tmp_path)
    assert main(["view", str(tmp_path), "-o", str(tmp_path / "page.html")]) == 0
    lower, upper = page_data((tmp_path / "page.html").read_text(encoding="utf-8"))["rooms"]
    assert ["agents' rooms", "anna 4"] in lower["attributes"]
    assert "match" not in dict(lower["attributes"])
    assert ["match", "anna room 7 = bob room 2"] in upper["attributes"]


def test_points_are_thinned_and_keep_their_storey():
    points = view_points(single_view(two_rooms()), most=500)
    assert 250 <= len(points.xyz) <= 500
    assert set(points.storey[points.room == 4]) == {0}
    assert set(points.storey[points.room == 7]) == {1}
    assert points.upper.any()
    assert not points.upper.all()


def test_points_of_no_room_belong_to_the_storey_at_their_height():
    z = np.array([-1.0, 0.5, 2.6, 2.8, 9.0])
    storeys = point_storeys(two_rooms(), z, np.full(5, NO_ROOM, np.int32))
    assert storeys.tolist() == [0, 0, 0, 1, 1]


def test_an_empty_map_has_a_page_too():
    m = two_rooms()
    nothing = np.empty((0, 3), np.int32)
    empty = replace(
        m,
        **{"voxels": nothing, "offsets": nothing.astype(np.int8), "room": np.empty(0, np.int32)},
        **{"rooms": (), "passages": (), "storeys": ()},
    )
    assert "0 rooms" in view_html(single_view(empty))


def test_the_command_writes_the_page_and_the_pictures(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    save_map(tmp_path / "map.tmap", two_rooms())
    page, pictures = tmp_path / "page.html", tmp_path / "pictures"
    assert main(["view", str(tmp_path), "-o", str(page), "--save", str(pictures)]) == 0
    assert page.stat().st_size > 1_000_000
    written = {path.name for path in pictures.iterdir()}
    assert {"rooms.png", "storeys.png"} <= written <= {"rooms.png", "storeys.png", "plan.png"}
    assert all(p.read_bytes().startswith(b"\x89PNG") for p in pictures.iterdir())
    assert f"written: {page}" in capsys.readouterr().out


def test_folders_without_a_map_are_named_with_what_to_open(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
):
    (tmp_path / "sim" / "office_0").mkdir(parents=True)
    (tmp_path / "sim" / "office_0" / "truth.json").write_text("{}")
    (tmp_path / "eval" / "cases").mkdir(parents=True)
    (tmp_path / "eval" / "rows.csv").write_text("")
    for folder, said in (
        ("sim", "simulated cases; view an agent's cloud, as "),
        ("sim/office_0", "a simulated case; view an agent's cloud, as "),
        ("eval", "an evaluation; open "),
    ):
        assert main(["view", str(tmp_path / folder), "-o", str(tmp_path / "page.html")]) == 2
        error = capsys.readouterr().err
        assert said in error
        assert error.count("\n") == 1


def test_a_folder_with_nothing_to_show_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]):
    assert main(["view", str(tmp_path), "-o", str(tmp_path / "page.html")]) == 2
    assert str(tmp_path) in capsys.readouterr().err


@pytest.mark.skipif(CHROMIUM is None, reason="no chromium on the PATH to open the page with")
def test_a_browser_shows_the_room_that_is_asked_for_and_then_the_one_clicked_on(tmp_path: Path):
    write_merged(tmp_path)
    path = tmp_path / "page.html"
    assert main(["view", str(tmp_path), "-o", str(path)]) == 0
    node = page_data(path.read_text(encoding="utf-8"))["rooms"][1]["node"]
    with BrowserPage(path, "room=4&storey=2&colour=agent") as page:
        assert page.value("document.querySelector('#room b').textContent") == "room 4"
        storey = page.value("document.getElementById('storeyname').textContent")
        assert storey.startswith("1, floor at 3.00")
        x, y = page.pixel(node)
        page.press(x, y)
        page.wait_for("document.querySelector('#room b').textContent === 'room 7'")
        page.release(x, y)
        text = page.value("document.getElementById('room').textContent")
        pressed = page.value("document.querySelectorAll('[aria-pressed=true]').length")
    assert "anna room 7 = bob room 2" in text
    assert pressed == 1
