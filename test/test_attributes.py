"""Attributes of rooms, measured on tiny made buildings."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from test.helpers_passages import mapped, shell, surfaces, wall_with_door
from test.test_links import by_x
from topometric_ros.extraction.assemble import assemble_rooms
from topometric_ros.extraction.attributes import room_attributes

HALL = shell(0, 0, 8, 4, 0, 2.6)
DOOR = wall_with_door(4, 0, 4, (1.0, 1.9), 2.1, 2.6)


def test_a_closed_room_has_its_area_its_volume_and_no_frontier() -> None:
    found = room_attributes(mapped(surfaces(HALL + DOOR), by_x(4.07)))
    assert sorted(found) == [0, 1]
    room = found[0]
    assert room.floor_area == pytest.approx(4 * 4, rel=0.05)
    assert room.volume == pytest.approx(4 * 4 * 2.6, rel=0.06)
    assert room.completeness == 1.0
    assert room.frontier == 0.0


def test_where_half_a_room_was_not_seen_it_has_a_frontier() -> None:
    points = surfaces(HALL)
    seen = points[points[:, 0] < 3.0]
    room = room_attributes(mapped(seen, by_x(20.0)))[0]
    # The rim opposite the wall at x = 0 is open.
    assert room.frontier == pytest.approx(4.0, abs=0.5)
    assert room.completeness == pytest.approx(1 - 4 / 14, abs=0.05)


def test_the_centre_can_be_stood_on_where_the_centroid_cannot() -> None:
    points = surfaces([*HALL, (2.5, 1.0, 0.0, 5.5, 3.0, 2.6)])
    x, y, _ = points.T
    pillar = (x > 2.51) & (x < 5.49) & (y > 1.01) & (y < 2.99)
    rooms = mapped(points[~pillar], by_x(20.0))
    centre = room_attributes(rooms)[0].centre
    assert centre is not None
    x, y, z = centre
    assert not (2.5 <= x <= 5.5 and 1.0 <= y <= 3.0)
    assert z == pytest.approx(0.0)
    standing = rooms.grid.origin + rooms.navigable * rooms.grid.voxel_size
    assert np.linalg.norm(standing - centre, axis=1).min() < 1e-9


def test_without_ceiling_there_is_no_volume_and_without_floor_no_centre() -> None:
    points = surfaces(HALL)
    low = mapped(points[points[:, 2] < 1.5], by_x(20.0), floors=((0.0, None),))
    assert room_attributes(low)[0].volume is None
    high = mapped(points[points[:, 2] > 0.5], by_x(20.0))
    assert room_attributes(high)[0].centre is None


def test_a_room_that_has_most_voxels_of_no_column_has_nothing_to_measure() -> None:
    def shelf(centres: NDArray[np.float64]) -> NDArray[np.intp]:
        on_wall = (centres[:, 0] < 0.04) & (centres[:, 1] > 3.0)
        return (on_wall & (abs(centres[:, 2] - 1.5) < 0.25)).astype(int)

    rooms = mapped(surfaces(HALL), shelf)
    found = room_attributes(rooms)
    assert found[1].floor_area == 0.0
    assert found[1].centre is None
    assert [room.kind for room in assemble_rooms(rooms, ())] == ["room", "unknown"]
