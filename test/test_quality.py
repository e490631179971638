"""Every extraction says what it found, what looks wrong and what to set; nothing fails silently."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from test.helpers import box_room
from topometric_ros.cli.main import main
from topometric_ros.configuration import with_values
from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.extraction.errors import ExtractionError
from topometric_ros.extraction.pipeline import extract
from topometric_ros.extraction.quality import Quality, findings
from topometric_ros.extraction.surfaces import fit_planes, measure_surfaces, spacing, steepest_tilt
from topometric_ros.io.clouds import UP_AXES, up_rotation
from topometric_ros.voxels.grid import thin, voxelise


def _flat() -> NDArray[np.float64]:
    """Two rooms with a door between them, and a table in each, on one floor."""
    left = box_room((0, 0, 0), (5, 4, 2.6), (("x+", 2.0),))
    right = box_room((5.12, 0, 0), (4, 4, 2.6), (("x-", 2.0),))
    x, y = np.meshgrid([5.04, 5.08], np.arange(1.56, 2.44, 0.04))
    threshold = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1)
    tables = [box_room((at, 0.5, 0.0), (1.6, 0.8, 0.72)) for at in (1.0, 6.5)]
    return np.concatenate([left, right, threshold, *tables])


def _quality(points: NDArray[np.float64], **values: object) -> Quality:
    return extract(points, with_values(ExtractionConfig(), values)).quality


def _codes(quality: Quality) -> set[str]:
    return {finding.code for finding in quality.findings}


@pytest.fixture(scope="module")
def good() -> Quality:
    return _quality(_flat())


def test_a_good_cloud_gives_numbers_and_no_findings(good: Quality) -> None:
    assert good.findings == ()
    assert (good.storeys, good.rooms, good.passages) == (1, 2, 1)
    assert good.parts == (((0, 1), pytest.approx(36.0, rel=0.1)),)
    assert good.clear_height == pytest.approx(2.6, abs=0.11)
    assert good.floor_seen > 0.9
    assert good.ceiling_seen > 0.9
    assert good.noise < 0.01
    assert good.straight > 0.7
    assert good.navigable_area == pytest.approx(30.0, rel=0.2)
    assert good.unlabelled["all"] == 0.0
    json.dumps(good.content(), allow_nan=False)


def test_feet_are_told_with_the_scale_to_use() -> None:
    finding = _quality(_flat() / 0.3048).findings[0]
    assert "feet" in finding.message
    assert "--scale 0.3048" in finding.advice


def test_a_cloud_of_half_the_size_is_too_low() -> None:
    assert "scale" in _codes(_quality(_flat() * 0.5))


def test_a_cloud_on_its_head_is_told() -> None:
    quality = _quality(_flat() * (1, -1, -1))
    assert "--up=-z" in str(next(f for f in quality.findings if f.code == "upside_down"))


def test_noise_is_measured_and_told() -> None:
    rng = np.random.default_rng(0)
    for sigma in (0.02, 0.05):
        noisy = thin(_flat() + rng.normal(0, sigma, _flat().shape), 0.05)
        assert measure_surfaces(fit_planes(noisy)).noise == pytest.approx(sigma, abs=0.012)
    quality = _quality(_flat() + rng.normal(0, 0.05, _flat().shape))
    assert "noise" in _codes(quality)


def test_a_sparse_cloud_is_told_with_a_voxel_size_to_use() -> None:
    points = _flat()
    some = points[np.random.default_rng(0).random(len(points)) < 0.06]
    (finding,) = (f for f in _quality(some).findings if f.code == "sparse")
    assert "use --voxel-size 0." in finding.advice


def test_a_cloud_of_a_2d_laser_is_told() -> None:
    x, y = np.meshgrid(np.arange(0, 5, 0.04), np.arange(0, 4, 0.04))
    outline = (x < 0.05) | (x > 4.9) | (y < 0.05) | (y > 3.9)
    scan = np.column_stack([x[outline], y[outline], np.zeros(np.count_nonzero(outline))])
    (finding,) = (f for f in _quality(scan).findings if f.code == "no_walls")
    assert "as a 2D laser's is" in finding.advice


def test_the_distance_of_points_is_measured() -> None:
    rng = np.random.default_rng(0)
    for distance in (0.1, 0.3):
        count = round(20 * 20 / distance**2)
        points = np.column_stack([rng.uniform(0, 20, (count, 2)), np.zeros(count)])
        grid, _ = voxelise(points, 0.1, np.zeros(3))
        assert spacing(grid.coords, 0.1) == pytest.approx(distance, rel=0.1)


def test_a_hole_in_the_floor_and_no_ceiling_are_told() -> None:
    points = _flat()
    floor = points[:, 2] < 0.02
    holed = points[~(floor & (points[:, 0] > 1.2) & (points[:, 1] > 0.3))]
    assert "floor_gaps" in _codes(_quality(holed))
    (note,) = (f for f in _quality(points[points[:, 2] < 2.4]).findings)
    assert (note.code, note.severity) == ("ceiling_gaps", "note")
    assert "low_view" in _codes(_quality(points[points[:, 2] < 1.6]))


def test_rooms_without_a_way_between_them_are_parts() -> None:
    apart = np.concatenate([_flat(), box_room((20, 0, 0), (4, 4, 2.6))])
    quality = _quality(apart)
    assert [rooms for rooms, _ in quality.parts] == [(0, 1), (2,)]
    (note,) = quality.findings
    assert (note.code, note.severity) == ("parts", "note")


def test_stray_points_a_few_hundred_metres_away_are_dropped() -> None:
    quality = _quality(np.concatenate([_flat(), [[300.0, 0, 0], [0, 250.0, 5]]]))
    assert quality.findings[0].code == "strays"
    assert "2 of" in quality.findings[0].message
    assert quality.rooms == 2


def test_a_plane_a_sphere_and_noise_are_no_buildings() -> None:
    rng = np.random.default_rng(0)
    x, y = np.meshgrid(np.arange(0, 5, 0.05), np.arange(0, 5, 0.05))
    assert "no_walls" in _codes(_quality(np.column_stack([x.ravel(), y.ravel(), 0 * x.ravel()])))
    ball = rng.normal(size=(80_000, 3))
    sphere = 5.0 * ball / np.linalg.norm(ball, axis=1)[:, None]
    assert "structure" in _codes(_quality(sphere))
    with pytest.raises(ExtractionError, match=r"only .* of the points lie on thin surfaces"):
        _quality(sphere * rng.random((80_000, 1)))


def test_a_tilt_beyond_the_largest_is_named() -> None:
    c, s = np.cos(np.radians(24.0)), np.sin(np.radians(24.0))
    tilted = _flat() @ np.array([[1, 0, 0], [0, c, -s], [0, s, c]])
    assert np.degrees(steepest_tilt(fit_planes(thin(tilted, 0.05)))) == pytest.approx(24.0, abs=1.0)


def test_every_warning_of_the_report_is_one_of_the_map() -> None:
    extraction = extract(_flat() / 0.3048, ExtractionConfig())
    assert extraction.map.warnings == extraction.quality.warnings() != ()


def test_findings_come_from_numbers_alone(good: Quality) -> None:
    bare = dataclasses.replace(good, rooms=0)
    assert [f.code for f in findings(bare, 0.1)] == ["no_rooms"]
    lost = dataclasses.replace(good, unlabelled={"all": 0.4, "below the floors": 0.3})
    assert [f.code for f in findings(lost, 0.1)] == ["floor_missed", "unlabelled"]


@pytest.mark.parametrize(
    ("flat", "straight", "told"),
    [(0.88, 0.48, []), (0.9, 0.3, ["structure"]), (0.3, 0.3, ["structure"])],
)
def test_sloped_roofs_and_noise_leave_a_building_one(
    good: Quality, flat: float, straight: float, told: list[str]
) -> None:
    seen = dataclasses.replace(good, flat=flat, straight=straight)
    assert [f.code for f in findings(seen, 0.1)] == told


def test_a_storey_seen_up_a_stairwell_alone_is_not_seen_too_low() -> None:
    above = _flat()[_flat()[:, 0] < 1.6]
    above = above[above[:, 2] < 1.5] + (0, 0, 2.9)
    extraction = extract(np.concatenate([_flat(), above]), ExtractionConfig())
    assert len(extraction.map.storeys) == 2
    assert "low_view" not in _codes(extraction.quality)


def test_the_command_line_writes_the_report_and_scales(tmp_path: Path) -> None:
    np.save(tmp_path / "feet.npy", _flat() / 0.3048)
    arguments = ["extract", str(tmp_path / "feet.npy"), "-o", str(tmp_path), "--scale", "0.3048"]
    assert main(arguments) == 0
    quality = json.loads((tmp_path / "map.json").read_text())["quality"]
    assert (quality["rooms"], quality["passages"], quality["findings"]) == (2, 1, [])
    assert main([*arguments[:-1], "-1"]) == 2


@pytest.mark.parametrize("up", UP_AXES)
def test_every_axis_that_points_up_becomes_z(up: str) -> None:
    T = up_rotation(up)
    axis = np.zeros(3)
    axis["xyz".index(up[-1])] = -1.0 if up[0] == "-" else 1.0
    np.testing.assert_array_equal(T[:3, :3] @ axis, [0, 0, 1])
    assert np.linalg.det(T) == 1.0
