"""Buildings made from a seed: the same from the same seed, and true to their rooms."""

from __future__ import annotations

import re

import numpy as np
import pytest

from test.helpers_buildings import first_hits, is_one_piece, places_in
from topometric_ros.errors import ConfigurationError
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.labelled import STRUCTURE, LabelledBuilding, TrueRoom, signed_area

SPECS = (
    "office:seed=1,rooms=14",
    "home:seed=2,storeys=2",
    "hospital:seed=3,rooms=24,corridor=comb",
    "office:seed=4,rooms=30,corridor=ring,wings=2,angle=-40",
    "office:seed=5,rooms=48,corridor=L,wings=2,angle=35,storeys=2",
)


@pytest.fixture(scope="module", params=SPECS)
def made(request):
    return load_building(request.param)


def test_the_same_seed_makes_the_same_bytes():
    first, second = (load_building(SPECS[3]) for _ in range(2))
    assert first.vertices.tobytes() == second.vertices.tobytes()
    assert first.faces.tobytes() == second.faces.tobytes()
    assert [r.polygon.tobytes() for r in first.rooms] == [r.polygon.tobytes() for r in second.rooms]
    other = load_building(SPECS[3].replace("seed=4", "seed=5"))
    assert first.vertices.tobytes() != other.vertices.tobytes()


def test_every_room_of_a_made_building_is_reachable(made):
    assert is_one_piece(made)


def test_a_made_building_has_a_hole_in_the_wall_at_every_link(made):
    level = [link for link in made.links if link.kind != "stair"]
    origins, directions = [], []
    for link in level:
        centre = link.position + (0.0, 0.0, 1.2)
        for angle in np.arange(0.0, np.pi, np.pi / 36):
            direction = np.array([np.cos(angle), np.sin(angle), 0.0])
            origins += [centre, centre]
            directions += [direction, -direction]
    free = first_hits(made, np.array(origins), np.array(directions)).reshape(len(level), -1, 2)
    assert (free.min(axis=2).max(axis=1) > 0.45).all()
    before = np.array(origins) + 0.3 * np.array(directions)
    sides = made.room_of(before, np.array(directions)).reshape(len(level), -1)
    for link, rooms in zip(level, sides, strict=True):
        assert set(link.rooms) <= set(rooms.tolist())


def test_no_two_rooms_of_a_made_building_overlap(made):
    for room in made.rooms:
        inner = places_in(room, made)
        assert len(inner) > 0
        alone = LabelledBuilding(
            "others",
            np.empty((0, 3)),
            np.empty((0, 3), dtype=np.int32),
            tuple(
                TrueRoom(i, r.name, r.kind, r.storey, r.polygon, r.z_low, r.z_high)
                for i, r in enumerate(r for r in made.rooms if r.id != room.id)
            ),
            (),
        )
        still = np.zeros_like(inner)
        assert (alone.room_of(inner, still) == -1).all()


def test_walls_stand_between_rooms_and_floors_below_and_above_them(made):
    room = max(made.rooms, key=lambda r: abs(signed_area(r.polygon)) * (r.kind != "stairs"))
    places = places_in(room, made, 1.0)
    down = first_hits(made, places, np.tile([0.0, 0.0, -1.0], (len(places), 1)))
    up = first_hits(made, places, np.tile([0.0, 0.0, 1.0], (len(places), 1)))
    assert (down <= 1.2 + 1e-5).all()
    assert np.allclose(up, room.z_high - room.z_low - 1.2, atol=1e-4)


def test_stairs_lead_from_storey_to_storey():
    building = load_building("office:rooms=24,storeys=3")
    stairs = [link for link in building.links if link.kind == "stair"]
    storeys = [tuple(building.rooms[r].storey for r in link.rooms) for link in stairs]
    assert storeys == [(0, 1), (1, 2)]
    above = np.array([link.position + (0.0, 0.0, 1.0) for link in stairs])
    down = first_hits(building, above, np.tile([0.0, 0.0, -1.0], (2, 1)))
    assert np.allclose(down, 1.0, atol=1e-5)


def test_twins_are_identical_but_for_their_place():
    building = load_building("office:seed=6,rooms=12,twins=2,furniture=1,cut=0")
    shapes = {}
    for room in building.rooms[1:]:
        corner = room.polygon.min(axis=0)
        inside = building.room_of(building.vertices, np.zeros_like(building.vertices)) == room.id
        outline = np.round(room.polygon - corner, 3)
        things = np.round(building.vertices[inside] - (*corner, 0.0), 3)
        key = (room.kind, outline[np.lexsort(outline.T)].tobytes(), things.tobytes())
        shapes[key] = shapes.get(key, 0) + 1
    assert sorted(shapes.values())[-2:] == [2, 2]


def test_rooms_may_be_no_rectangles_and_wings_turned():
    building = load_building(SPECS[4])
    corners = [len(room.polygon) for room in building.rooms if room.kind == "office"]
    assert {4, 6} <= set(corners)
    lobby = next(room for room in building.rooms if room.kind == "lobby")
    edges = np.roll(lobby.polygon, -1, axis=0) - lobby.polygon
    turned = np.degrees(np.arctan2(*edges.T)) % 90
    assert np.ptp(turned) > 10


def test_furniture_can_be_told_from_the_structure_piece_by_piece():
    building = load_building("office:rooms=8,furniture=1")
    assert (np.unique(building.face_tag) == np.arange(building.face_tag.max() + 1)).all()
    bare = load_building("office:rooms=8,furniture=0")
    assert (bare.face_tag == STRUCTURE).all()
    kept = building.faces[building.face_tag == STRUCTURE]
    assert building.vertices[kept].tobytes() == bare.vertices[bare.faces].tobytes()


@pytest.mark.parametrize(
    "spec", ["office:rooms=-1", "office:roms=3", "office:corridor=ring,rooms=3"]
)
def test_a_building_that_cannot_be_made_is_refused(spec):
    with pytest.raises(ConfigurationError):
        load_building(spec)


@pytest.mark.parametrize("shape", ["corridor=comb,storeys=2", "corridor=ring,wings=2,storeys=3"])
def test_too_few_rooms_are_refused_with_the_smallest_number(shape):
    with pytest.raises(ConfigurationError, match="at least") as caught:
        load_building(f"office:{shape},rooms=5")
    fewest = int(re.search(r"at least (\d+)", str(caught.value))[1])
    assert is_one_piece(load_building(f"office:{shape},rooms={fewest}"))
    with pytest.raises(ConfigurationError, match=f"at least {fewest}, got {fewest - 1}"):
        load_building(f"office:{shape},rooms={fewest - 1}")


def test_buildings_that_differ_have_names_that_differ():
    specs = ("office:seed=3", "office:seed=3,rooms=20", "office:seed=3,rooms=20,windows=false")
    names = [load_building(spec).name for spec in specs]
    last = "office_straight_3_rooms20_windowsFalse"
    assert names == ["office_straight_3", "office_straight_3_rooms20", last]


@pytest.mark.parametrize("kind", ["office", "home", "hospital"])
@pytest.mark.parametrize("corridor", ["straight", "L", "ring", "comb"])
def test_every_shape_can_be_made_of_every_kind_with_wings_and_storeys(kind, corridor):
    building = load_building(f"{kind}:corridor={corridor},wings=2,storeys=2,twins=2")
    assert is_one_piece(building)
    assert {room.storey for room in building.rooms} == {0, 1}


def test_other_furniture_leaves_the_structure_as_it_is():
    spec = "office:seed=6,rooms=12,twins=2"
    one, other = (load_building(f"{spec},furnished={k}") for k in (1, 2))
    for building in (one, other):
        assert np.array_equal(_structure(building), _structure(load_building(spec)))
    assert one.vertices.shape != other.vertices.shape or (one.vertices != other.vertices).any()


def test_alike_rooms_stand_in_every_row_and_on_every_storey():
    building = load_building("hospital:rooms=12,alike=1,cut=0,storeys=2,stacked=true")
    areas = {
        storey: sorted(
            round(abs(signed_area(room.polygon)))
            for room in building.rooms
            if room.storey == storey
        )
        for storey in (0, 1)
    }
    assert areas[0] == areas[1]
    # A corridor, the stairs and two rows of rooms; the ends of a row lack half a wall.
    assert len(set(areas[0])) <= 4


def test_a_mirrored_building_is_the_same_but_for_its_hand():
    plain, turned = (
        load_building(f"office:seed=4,rooms=9,mirrored={m}") for m in ("false", "true")
    )
    assert is_one_piece(turned)
    assert np.allclose(plain.vertices * (-1.0, 1.0, 1.0), turned.vertices)
    for before, after in zip(plain.rooms, turned.rooms, strict=True):
        assert np.isclose(signed_area(before.polygon), signed_area(after.polygon))
    inside = np.array([link.position + (0.0, 0.0, 1.0) for link in turned.links])
    directions = np.tile([0.0, 0.0, -1.0], (len(inside), 1))
    assert np.allclose(first_hits(turned, inside, directions), 1.0, atol=1e-5)


def _structure(building: LabelledBuilding) -> np.ndarray:
    return building.vertices[building.faces[building.face_tag == STRUCTURE]]
