"""Passages of preset default: doors measured, stairs found, one edge for one door."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from test.helpers_passages import Solid, mapped, shell, surfaces, wall_with_door
from topometric_ros.extraction.config import extraction_preset
from topometric_ros.extraction.passages import find_links, find_passages

CONFIG = extraction_preset("default").passages


def by_x(*edges: float):
    """Return what numbers rooms by the stretch of x that they lie in."""
    return lambda centres: np.searchsorted(edges, centres[:, 0])


def turned(points: NDArray[np.float64], angle: float) -> NDArray[np.float64]:
    c, s = np.cos(angle), np.sin(angle)
    return points @ np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize("angle", [0.0, 0.4])
def test_a_door_has_its_width_its_height_and_its_kind(angle: float) -> None:
    boxes = shell(0, 0, 8, 4, 0, 2.6) + wall_with_door(4, 0, 4, (1.0, 1.9), 2.1, 2.6)
    points = turned(surfaces(boxes), angle)
    back = turned(np.array([[4.075, 1.45, 0.0]]), angle)[0]

    def room_at(centres: NDArray[np.float64]) -> NDArray[np.intp]:
        return by_x(4.07)(turned(centres, -angle))

    (door,) = find_links(mapped(points, room_at), CONFIG)
    assert door.rooms == (0, 1)
    assert door.kind == "door"
    assert door.width == pytest.approx(0.9, abs=0.1)
    assert door.height == pytest.approx(2.1, abs=0.1)
    assert door.position == pytest.approx(back, abs=0.15)
    assert door.confidence > 0.9


def test_without_a_lintel_it_is_an_opening() -> None:
    boxes = shell(0, 0, 8, 4, 0, 2.6) + wall_with_door(4, 0, 4, (1.0, 2.6), 2.6, 2.6)
    (opening,) = find_links(mapped(surfaces(boxes), by_x(4.07)), CONFIG)
    assert opening.kind == "opening"
    assert opening.width == pytest.approx(1.6, abs=0.1)
    assert opening.height is None


def test_narrow_with_the_space_above_unseen_it_is_a_door() -> None:
    boxes = shell(0, 0, 8, 4, 0, 2.6) + wall_with_door(4, 0, 4, (1.0, 1.9), 2.1, 2.6)
    points = surfaces(boxes)
    low = mapped(points[points[:, 2] < 1.95], by_x(4.07), floors=((0.0, None),))
    (door,) = find_links(low, CONFIG)
    assert door.kind == "door"
    assert door.height is None


def test_a_floor_that_rises_evenly_is_a_ramp() -> None:
    steps: list[Solid] = [(4 + k * 0.1, 0, -0.02, 4.1 + k * 0.1, 3, k * 0.01) for k in range(51)]
    boxes = [*steps, (0, 0, -0.02, 4, 3, 0.0), (9.1, 0, 0.48, 13, 3, 0.5)]
    walls: list[Solid] = [(0, -0.02, 0, 13, 0, 2.6), (0, 3, 0, 13, 3.02, 2.6)]
    (ramp,) = find_links(mapped(surfaces([*boxes, *walls]), by_x(6.5)), CONFIG)
    assert ramp.kind == "ramp"
    assert ramp.width == pytest.approx(3.0, abs=0.2)
    assert ramp.position[2] == pytest.approx(0.25, abs=0.1)


def two_storeys(steps: range = range(1, 16)) -> NDArray[np.float64]:
    """Return two rooms above each other, a hole in the ceiling and a flight through it."""
    lower = [box for box in shell(0, 0, 8, 4, 0, 2.8) if box[2] != 2.8]
    upper = [box for box in shell(0, 0, 8, 4, 3.0, 5.6) if box[5] != 3.0]
    # The slab leaves a hole of 4.5 m x 1 m over the stairs, which rise along the wall y = 4.
    slab = [(0, 0, 2.8, 8, 3, 3.0), (0, 3, 2.8, 1.4, 4, 3.0), (5.8, 3, 2.8, 8, 4, 3.0)]
    flight = [
        (1.5 + 0.28 * k, 3.0, 0.1875 * k - 0.03, 1.78 + 0.28 * k, 3.98, 0.1875 * k) for k in steps
    ]
    return surfaces([*lower, *upper, *slab, *flight])


def by_height(centres: NDArray[np.float64]) -> NDArray[np.intp]:
    return (centres[:, 2] >= 2.85).astype(int)


STOREYS = {"floors": ((0.0, 2.8), (3.0, 5.6)), "storey_of_room": {0: 0, 1: 1}}


def test_stairs_join_the_rooms_of_two_storeys() -> None:
    (stairs,) = find_links(mapped(two_storeys(), by_height, **STOREYS), CONFIG)
    assert stairs.rooms == (0, 1)
    assert stairs.kind == "stairs"
    assert stairs.width == pytest.approx(1.0, abs=0.15)
    assert stairs.position == pytest.approx((3.7, 3.5, 1.5), abs=0.5)
    assert stairs.height is not None
    assert stairs.height > 1.8


def test_stairs_of_which_a_tread_or_two_were_not_seen_still_join() -> None:
    seen = [k for k in range(1, 16) if k not in (4, 11)]
    (stairs,) = find_links(mapped(two_storeys(seen), by_height, **STOREYS), CONFIG)
    assert stairs.kind == "stairs"


def test_half_a_flight_joins_nothing() -> None:
    assert find_links(mapped(two_storeys(range(1, 8)), by_height, **STOREYS), CONFIG) == ()
    assert find_links(mapped(two_storeys(range(9, 16)), by_height, **STOREYS), CONFIG) == ()


def door_where_two_stretches_of_a_corridor_meet() -> NDArray[np.float64]:
    boxes = shell(0, 0, 8, 6, 0, 2.6)
    door = wall_with_door(4, 0, 8, (3.5, 4.5), 2.1, 2.6)
    return surfaces([*boxes, *((y0, x0, z0, y1, x1, z1) for x0, y0, z0, x1, y1, z1 in door)])


def room_and_two_stretches(centres: NDArray[np.float64]) -> NDArray[np.intp]:
    """Room 0 below the wall at y = 4; above it a corridor, cut in two at the door's middle."""
    return np.where(centres[:, 1] < 4.07, 0, np.where(centres[:, 0] < 3.96, 1, 2))


def test_a_room_and_two_pieces_of_corridor_at_one_door_make_no_triangle() -> None:
    rooms = mapped(door_where_two_stretches_of_a_corridor_meet(), room_and_two_stretches)
    plain = find_passages(rooms.grid, rooms.room, rooms.navigable, CONFIG)
    assert {p.rooms for p in plain} == {(0, 1), (0, 2), (1, 2)}
    links = find_links(rooms, CONFIG)
    assert [p.rooms for p in links] == [(0, 2), (1, 2)]
    assert links[0].kind == "door"
    assert links[0].width == pytest.approx(1.0, abs=0.1)
