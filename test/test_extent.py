"""Stray points, far-off frames and wrong units are told before memory is taken."""

from __future__ import annotations

import numpy as np
import pytest

from test.helpers import box_room
from topometric_ros.extraction.errors import ExtractionError
from topometric_ros.extraction.extent import anchor, far_findings, without_strays
from topometric_ros.voxels.scan_grid import ScanConfig, ScanGrid

_ROOM = box_room((0, 0, 0), (5, 4, 2.6), step=0.1)


def test_an_ordinary_cloud_is_untouched() -> None:
    points, findings = without_strays(_ROOM)
    assert points is _ROOM
    assert findings == ()
    assert not anchor(_ROOM + (900, -900, 30)).any()


@pytest.mark.parametrize("place", [(500, 300, 40), (0, 0, 1e5), (1e9, 0, 0), (1.7e308, -1e308, 0)])
def test_a_stray_point_far_away_is_dropped_and_told(place: tuple[float, float, float]) -> None:
    points, findings = without_strays(np.concatenate([_ROOM, [place]]))
    np.testing.assert_array_equal(points, _ROOM)
    assert "1 of" in findings[0].message


@pytest.mark.parametrize(("scale", "unit"), [(100, "0.01$"), (1000, "0.001$")])
def test_other_units_are_named(scale: float, unit: str) -> None:
    with pytest.raises(ExtractionError, match=rf"spans .* use --scale {unit}"):
        without_strays(box_room((0, 0, 0), (9, 9, 2.6), step=0.1) * scale)


def test_two_buildings_ten_kilometres_apart_are_refused() -> None:
    with pytest.raises(ExtractionError, match="10005 m x 10004 m"):
        without_strays(np.concatenate([_ROOM, _ROOM + (10_000, 10_000, 0)]))


def test_coordinates_that_are_lengths_in_no_unit_are_refused() -> None:
    with pytest.raises(ExtractionError, match=r"in metres, got some of 5e\+300"):
        without_strays(_ROOM * 1e300)


def test_projected_coordinates_in_single_precision_are_told() -> None:
    place = np.array([500_000.0, 5_400_000.0, 0.0])
    codes = [[f.code for f in far_findings(p, anchor(p))] for p in (_ROOM, _ROOM + place)]
    assert codes == [[], ["far_frame"]]
    coarse = (_ROOM + place).astype(np.float32).astype(np.float64)
    assert "up to 0.5 m apart; write them as doubles" in str(far_findings(coarse, place)[0])


def test_far_clouds_are_anchored_at_whole_kilometres() -> None:
    place = anchor(_ROOM + (500_000, 5_000_400, 30))
    np.testing.assert_array_equal(place, [500_000, 5_000_000, 0])


def test_scans_in_a_far_off_frame_are_gathered() -> None:
    away = np.array([500_000.0, 5_000_000.0, 0.0])
    near, far = (ScanGrid(0.05, anchor(p), ScanConfig()) for p in (_ROOM, _ROOM + away))
    near.add(_ROOM)
    far.add(_ROOM + away)
    np.testing.assert_allclose(far.points() - away, near.points(), atol=1e-6)
