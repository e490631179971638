"""A cloud becomes a topometric map: rooms, passages and storeys, the same every time."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from test.helpers import SHARED_DATA, box_room, moved, needs_shared_data, yaw_transform
from topometric_ros.configuration import flatten, with_values
from topometric_ros.errors import ConfigurationError
from topometric_ros.extraction.config import PRESETS, ExtractionConfig, extraction_preset
from topometric_ros.extraction.errors import ExtractionError
from topometric_ros.extraction.pipeline import extract
from topometric_ros.topometric_map import NO_ROOM, TopometricMap


def _two_rooms() -> NDArray[np.float64]:
    """Two rooms of different size with a door between them, 0.12 m of wall."""
    left = box_room((0, 0, 0), (5, 4, 2.6), (("x+", 2.0),))
    right = box_room((5.12, 0, 0), (4, 4, 2.6), (("x-", 2.0),))
    x, y = np.meshgrid([5.04, 5.08], np.arange(1.56, 2.44, 0.04))
    threshold = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1)
    return np.concatenate([left, right, threshold])


def _map(points: NDArray[np.float64], **values: object) -> TopometricMap:
    return extract(points, with_values(ExtractionConfig(), values)).map


def _identical(a: TopometricMap, b: TopometricMap) -> bool:
    for field in dataclasses.fields(TopometricMap):
        one, other = getattr(a, field.name), getattr(b, field.name)
        if isinstance(one, np.ndarray):
            if one.dtype != other.dtype or one.tobytes() != other.tobytes():
                return False
        elif field.name != "storeys" and one != other:
            return False
    return all(
        getattr(s.layers, n).tobytes() == getattr(t.layers, n).tobytes()
        for s, t in zip(a.storeys, b.storeys, strict=True)
        for n in ("wall", "furniture", "free", "bare")
    )


@pytest.mark.parametrize("voxel_size", [0.05, 0.1, 0.2])
def test_two_rooms_with_a_door_are_two_rooms_and_a_passage(voxel_size: float) -> None:
    m = _map(_two_rooms(), voxel_size=voxel_size)
    assert len(m.rooms) == 2
    assert [r.area for r in m.rooms] == pytest.approx([5 * 4, 4 * 4], rel=0.15)
    assert not any(r.isolated for r in m.rooms)
    assert [p.rooms for p in m.passages] == [(0, 1)]
    assert m.passages[0].position[:2] == pytest.approx([5.06, 2.0], abs=0.25)
    assert (m.room != NO_ROOM).all()
    assert m.warnings == ()
    (storey,) = m.storeys
    assert storey.floor_z == pytest.approx(0.0, abs=0.02)
    assert storey.ceiling_z == pytest.approx(2.6, abs=0.05)


def test_a_layer_of_cell_centres_lies_on_the_lowest_floor() -> None:
    m = _map(moved(_two_rooms(), yaw_transform(0.3, (3.21, -1.07, 0.537))))
    heights = m.centres()[:, 2]
    assert np.abs(heights - 0.537).min() < 0.02
    assert m.origin[:2] == (0.0, 0.0)


def test_the_same_cloud_gives_the_same_bytes() -> None:
    points = _two_rooms()
    assert _identical(_map(points), _map(points.copy()))


def test_a_later_map_of_a_session_keeps_the_lattice_of_the_first() -> None:
    points = _two_rooms()
    first = _map(points)
    T = first.T_level_input
    grown = np.concatenate([points, box_room((0, 4.12, -0.03), (3, 3, 2.6))])
    later = extract(grown, ExtractionConfig(), origin=first.origin, T_level_input=T).map
    assert later.origin == first.origin
    kept = {tuple(v) for v in later.voxels.tolist()}
    assert np.mean([tuple(v) in kept for v in first.voxels.tolist()]) > 0.95


def test_a_tilted_cloud_is_levelled_with_a_warning() -> None:
    tilt = np.radians(3.0)
    T = np.eye(4)
    T[1:3, 1:3] = [[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]]
    m = _map(moved(_two_rooms(), T))
    assert np.degrees(np.arccos((m.T_level_input @ T)[2, 2])) < 0.1
    assert len(m.rooms) == 2
    assert "3.0°" in m.warnings[0]
    assert "level.enabled" in m.warnings[0]


def test_a_cloud_on_its_side_is_told_the_right_axis() -> None:
    m = _map(_two_rooms()[:, [1, 2, 0]])
    assert "--up y" in m.warnings[0]
    hall = box_room((0, 0, 0), (14, 9, 2.6), step=0.08)
    with pytest.raises(ExtractionError, match=r"no floor found with z up.*use --up y"):
        _map(hall[:, [1, 2, 0]])
    with pytest.raises(ExtractionError, match=r"no floor found with z up.*use --up x"):
        _map(hall[:, [2, 0, 1]])


def test_a_wall_alone_has_no_floor() -> None:
    y, z = np.meshgrid(np.arange(0, 5, 0.04), np.arange(0, 3, 0.04))
    with pytest.raises(ExtractionError, match=r"no floor found with z up.*--up"):
        _map(np.stack([np.zeros(y.size), y.ravel(), z.ravel()], -1))


def test_no_points_are_refused() -> None:
    with pytest.raises(ExtractionError, match="no points"):
        _map(np.zeros((0, 3)))


def test_a_floor_without_walls_extracts() -> None:
    x, y = np.meshgrid(np.arange(0, 5, 0.04), np.arange(0, 5, 0.04))
    m = _map(np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], -1))
    assert len(m.rooms) == 1


def test_both_presets_extract_rooms_with_times_by_stage() -> None:
    for name in PRESETS:
        extraction = extract(_two_rooms(), extraction_preset(name))
        assert len(extraction.map.rooms) >= 2
        assert {"thin", "level", "storeys", "rooms", "passages"} <= set(extraction.timings)


def test_presets_are_named() -> None:
    assert "voxel_size" in flatten(extraction_preset("default"))
    with pytest.raises(ConfigurationError, match="known: default, thesis"):
        extraction_preset("best")


@needs_shared_data
def test_the_rooms_of_a_scanned_flat_are_found() -> None:
    header, _, body = (
        (SHARED_DATA / "pairs" / "lab_ipa_low_21" / "b.ply").read_bytes().partition(b"end_header\n")
    )
    assert b"binary_little_endian" in header
    points = np.frombuffer(body, "<f4").reshape(-1, 3).astype(np.float64)
    m = _map(points)
    assert m.T_level_input.tolist() == np.eye(4).tolist()
    assert 5 <= len(m.rooms) <= 9
    assert len(m.passages) >= 4


def test_a_cloud_in_projected_coordinates_gives_the_same_map_in_a_moved_frame() -> None:
    away = np.array([500_000.0, 5_000_000.0, 3000.0])
    near, far = _map(_two_rooms()), _map(_two_rooms() + away)
    assert len(far.rooms) == len(near.rooms) == 2
    np.testing.assert_array_equal(far.T_level_input[:3, 3], -away)
    assert "T_level_input" in far.warnings[0]
    T_input_level = np.linalg.inv(far.T_level_input)
    np.testing.assert_allclose(
        moved(far.surface(), T_input_level).mean(0), near.surface().mean(0) + away, atol=0.01
    )


def test_a_later_map_of_a_session_keeps_the_moved_frame() -> None:
    far = _two_rooms() + (500_400.0, 0.0, 0.0)
    first = _map(far)
    grown = np.concatenate([far, box_room((500_409.3, 0, 0), (200, 4, 2.6), step=0.2)])
    later = extract(
        grown, ExtractionConfig(), origin=first.origin, T_level_input=first.T_level_input
    ).map
    np.testing.assert_array_equal(later.T_level_input, first.T_level_input)
    known = set(map(tuple, later.voxels.tolist()))
    assert np.mean([tuple(v) in known for v in first.voxels.tolist()]) > 0.99
