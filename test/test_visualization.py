"""The report and its pictures: complete, self-contained and the same every time."""

import os
import re
import shutil
import subprocess
from dataclasses import replace

import numpy as np
import pytest

from test.helpers_visualization import demo_maps, demo_truth, merged_result, unmerged_result
from topometric_ros.alignment import AlignmentStatus, GlobalMap, MergeResult
from topometric_ros.extraction.quality import Finding, Quality
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.agreement import AGREES, CONFLICTS, OWN, compare
from topometric_ros.visualization.figures import global_figure, map_figure
from topometric_ros.visualization.page import number
from topometric_ros.visualization.pair_figures import matches_figure, overlay_figure
from topometric_ros.visualization.plan import main_direction, storey_plans
from topometric_ros.visualization.report import report_html, write_report
from topometric_ros.voxels.palette import agent_colour, room_colours

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("chrome")


@pytest.fixture(scope="module")
def merged_page():
    return report_html(merged_result(), demo_maps())


@pytest.fixture(scope="module")
def unmerged_page():
    return report_html(unmerged_result(), demo_maps())


def empty_map(agent="robot1"):
    """A map of nothing, as of a cloud in which no room was found."""
    none = np.empty((0, 3))
    return TopometricMap(
        agent=agent,
        session="test",
        sequence=1,
        frame_id="map",
        stamp=0,
        voxel_size=0.1,
        origin=(0.0, 0.0, 0.0),
        voxels=none.astype(np.int32),
        offsets=none.astype(np.int8),
        room=np.empty(0, np.int32),
        navigable=none.astype(np.int32),
        viewpoints=none.astype(np.float32),
        warnings=("no rooms were found",),
    )


def test_the_verdict_comes_first_and_carries_the_transform(merged_page):
    body = merged_page[merged_page.index("<main>") :]
    assert body.index("robot1 and robot2 are aligned") < body.index("Global map")
    for value in (
        "14.7°",
        "11.48\u00a0m",
        "13.74\u00a0m",
        "−0.36\u00a0m",
        "97\u00a0%",
        "1.1\u00a0cm",
    ):
        assert value in body


def test_reasons_warnings_and_advice_are_told(unmerged_page):
    assert "robot2 could not be aligned with robot1" in unmerged_page
    assert "two poses fit nearly as well" in unmerged_page
    assert "Walking one more room" in unmerged_page
    assert "the cloud is tilted by 2.1°" in unmerged_page
    assert "It was not accepted." in unmerged_page


def test_text_from_outside_is_escaped(unmerged_page):
    assert "no alignment &lt;accepted&gt;" in unmerged_page
    assert "<accepted>" not in unmerged_page


@pytest.mark.parametrize("page", ["merged_page", "unmerged_page"])
def test_the_page_fetches_nothing(page, request):
    html = request.getfixturevalue(page)
    assert not re.search(r"https?://|@import|<link|url\(", html)
    sources = re.findall(r'src="([^"]*)"', html)
    assert sources
    assert all(source.startswith("data:image/png;base64,") for source in sources)


def test_the_same_result_gives_the_same_bytes(merged_page, tmp_path):
    write_report(merged_result(), demo_maps(), tmp_path / "again.html")
    assert (tmp_path / "again.html").read_bytes() == merged_page.encode()


def alone():
    """What a merger says of one agent that found nothing."""
    return MergeResult(
        global_frame="map",
        agents=merged_result().agents[:1],
        alignments=(),
        global_map=GlobalMap(empty_map(), np.empty(0, np.uint32)),
    )


def test_an_extraction_s_quality_appears_with_what_to_do(merged_page):
    quality = Quality(
        *(100, 50, 1, 2, 1, 20.0, {"all": 0.1}, 0.9, 0.8, (((0, 1), 20.0),)),
        *(0.01, 0.95, 0.9, 0.5, 1.0, 0.07, None, 2.5),
        findings=(Finding("sparse", "warning", "points lie apart", "use --voxel-size 0.2"),),
    )
    html = report_html(merged_result(), demo_maps(), qualities={"robot1": quality})
    assert "quality of the extraction" not in merged_page
    assert html.count("quality of the extraction") == 1
    assert "use --voxel-size 0.2" in html


@pytest.mark.parametrize("status", list(AlignmentStatus))
def test_every_outcome_has_a_page(status):
    pair = unmerged_result().alignments[0]
    T = np.eye(4) if status is AlignmentStatus.ACCEPTED else None
    result = replace(
        alone(),
        agents=merged_result().agents,
        alignments=(replace(pair, status=status, reason="because", T_a_b=T),),
    )
    assert "because." in report_html(result, [empty_map("robot1"), empty_map("robot2")])


def test_maps_without_rooms_and_a_single_agent_have_a_page():
    html = report_html(alone(), [empty_map()])
    assert "nothing to align" in html
    assert "no rooms were found" in html
    assert map_figure(empty_map()) is None


def test_at_the_true_pose_walls_agree_and_hardly_any_conflict():
    a, b = demo_maps()
    (storey,) = compare(a, b, demo_truth())
    for judged in (storey.a, storey.b):
        assert (judged.verdict == AGREES).sum() > 500
        assert (judged.verdict == CONFLICTS).sum() < 0.01 * (judged.verdict >= OWN).sum()


def test_at_a_wrong_pose_walls_conflict():
    a, b = demo_maps()
    wrong = demo_truth()
    wrong[:2, 3] += 1.5
    (storey,) = compare(a, b, wrong)
    conflict = sum((judged.verdict == CONFLICTS).sum() for judged in (storey.a, storey.b))
    assert conflict > 200


def test_a_map_on_another_storey_neither_agrees_nor_conflicts():
    a, b = demo_maps()
    above = demo_truth()
    above[2, 3] += 3.0
    storeys = compare(a, b, above)
    assert [s.floor_z for s in storeys] == sorted(s.floor_z for s in storeys)
    assert len(storeys) == 2
    for storey in storeys:
        judged = storey.a or storey.b
        assert judged.verdict.max() == OWN
    assert overlay_figure(a, b, above, ("#0077bb", "#ee9911"))


def test_matches_are_drawn_with_and_without_a_transform():
    a, b = demo_maps()
    accepted = merged_result().alignments[0]
    assert matches_figure(a, b, accepted) != matches_figure(a, b, replace(accepted, T_a_b=None))
    assert matches_figure(a, empty_map("robot2"), accepted) is None


def test_a_plan_shows_each_room_where_its_voxels_are():
    m, _ = demo_maps()
    (plan,) = storey_plans(m)
    assert set(plan.labels) == {room.id for room in m.rooms}
    for room in m.rooms:
        x, y = plan.labels[room.id]
        (low, high) = room.bounds
        assert low[0] < x < high[0]
        assert low[1] < y < high[1]
        shown = (plan.rooms == room.id).sum() * plan.cell**2
        assert shown == pytest.approx(room.area, rel=0.1)


def test_the_main_direction_is_that_of_the_walls():
    for m, degrees in zip(demo_maps(), (17.15, 2.42), strict=True):
        assert np.degrees(main_direction(m)) == pytest.approx(degrees, abs=0.75)


def test_room_colours_last_and_differ():
    colours = room_colours(np.arange(27))
    assert len(np.unique(colours, axis=0)) == 27
    np.testing.assert_array_equal(room_colours([5, 3, 5])[0], colours[5])
    assert agent_colour(0) != agent_colour(1)


def test_numbers_have_a_true_minus_sign_and_no_negative_zero():
    assert number(-0.36, 2, "m") == "−0.36\u00a0m"
    assert number(-0.001, 2) == "0.00"


def test_the_global_picture_is_a_png_that_says_nothing_of_when_or_by_what():
    png = global_figure(merged_result().global_map, ["robot1", "robot2"], ["robot1", "robot2"])
    assert png.startswith(b"\x89PNG")
    assert b"tEXt" not in png
    assert b"tIME" not in png


@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_a_browser_shows_every_picture_and_opens_one_large(merged_page, tmp_path):
    # A script on the page writes what the browser made of it into the title, which is read back.
    probe = (
        "<script>addEventListener('load',()=>{const b=document.querySelectorAll('figure button');"
        "b[0].click();const g=[...document.querySelectorAll('figure img')];"
        "document.title=JSON.stringify([g.length,g.every(i=>i.complete&&i.naturalWidth>300),"
        "document.querySelector('dialog').open,"
        "document.documentElement.scrollWidth<=innerWidth])})</script></body>"
    )
    page = tmp_path / "report.html"
    page.write_text(merged_page.replace("</body>", probe), encoding="utf-8")
    command = [CHROMIUM, "--headless", "--disable-gpu", "--disable-background-networking"]
    command += [f"--user-data-dir={tmp_path / 'profile'}", "--dump-dom", page.as_uri()]
    if hasattr(os, "geteuid") and os.geteuid() == 0:
        command.insert(1, "--no-sandbox")
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, check=True)
    assert "<title>[5,true,true,true]</title>" in done.stdout
