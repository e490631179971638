"""Buildings that are loaded, and which room their points belong to."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imsave

from test.helpers_buildings import first_hits, is_one_piece, square
from topometric_ros.io.ply import read_ply_points, write_ply
from topometric_ros.simulation.building import BuildingError
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.labelled import LabelledBuilding, TrueRoom, join_rings, signed_area
from topometric_ros.simulation.outlines import trace_outlines
from topometric_ros.simulation.sidecars import graph_path, trajectory_path, write_graph

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
needs_data = pytest.mark.skipif(not DATA.exists(), reason="the shared data are not here")


def test_a_wall_belongs_to_the_room_that_it_was_seen_from():
    rooms = (
        TrueRoom(0, "west", "office", 0, square(0.0, 0.0, 4.0, 4.0), 0.0, 2.7),
        TrueRoom(1, "east", "office", 0, square(4.2, 0.0, 8.0, 4.0), 0.0, 2.7),
        TrueRoom(2, "upstairs", "office", 1, square(0.0, 0.0, 8.0, 4.0), 2.9, 5.6),
    )
    none = np.empty((0, 3))
    building = LabelledBuilding("two", none, none.astype(np.int32), rooms, ())
    wall = np.array([[4.1, 2.0, 1.0]] * 2 + [[2.0, 2.0, 2.8]] * 2 + [[20.0, 0.0, 1.0]])
    towards = np.array([[-1, 0, 0], [1, 0, 0], [0, 0, -1], [0, 0, 1], [1, 0, 0]], dtype=np.float64)
    assert building.room_of(wall, towards).tolist() == [0, 1, 0, 2, -1]


def test_a_ceiling_far_above_its_room_is_none_of_the_room_upstairs():
    rooms = (
        TrueRoom(0, "low", "office", 0, square(0.0, 0.0, 4.0, 4.0), 0.0, 2.4),
        TrueRoom(1, "upstairs", "office", 1, square(0.0, 0.0, 4.0, 4.0), 3.2, 5.6),
    )
    none = np.empty((0, 3))
    building = LabelledBuilding("two", none, none.astype(np.int32), rooms, ())
    places = np.array([[2.0, 2.0, 3.1], [2.0, 2.0, 3.1], [2.0, 2.0, 2.9]])
    towards = np.array([[0.8, 0.0, -0.6], [0.8, 0.0, 0.6], [0.0, 0.0, -1.0]])
    assert building.room_of(places, towards).tolist() == [-1, 1, 0]


def test_a_hole_in_a_room_is_not_the_room():
    outline = join_rings([square(0, 0, 9, 9), square(3, 3, 6, 6), square(20, 0, 22, 2)])
    none = np.empty((0, 3))
    ring = TrueRoom(0, "ring", "corridor", 0, outline, 0.0, 2.7)
    building = LabelledBuilding("ring", none, none.astype(np.int32), (ring,), ())
    places = np.array([[1.0, 4.0, 1.0], [4.5, 4.5, 1.0], [21.0, 1.0, 1.0], [15.0, 1.0, 1.0]])
    assert building.room_of(places).tolist() == [0, -1, 0, -1]


def test_an_outline_runs_round_its_cells():
    cells = np.zeros((6, 5), dtype=bool)
    cells[1:5, 1:4] = True
    cells[2, 2] = False
    outer, hole = trace_outlines(cells)
    assert signed_area(outer) == 12
    assert signed_area(hole) == -1
    assert len(outer) == len(hole) == 4


def write_bim(folder):
    """Write a model of two rooms with a door between them and one to the outside."""
    quad = np.array([[0, 0, 0], [6, 0, 0], [6, 3, 0], [0, 3, 0]], dtype=np.float32)
    faces = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
    types = np.array(["IfcSlab", "IfcSpace", "IfcDoor", "IfcFurnishingElement"])
    np.savez(
        folder / "model.npz",
        V=np.concatenate([quad] * 4),
        F=np.concatenate([faces + 4 * k for k in range(4)]),
        face_element=np.repeat(np.arange(4, dtype=np.int32), 2),
        element_type=types,
    )
    rooms = [
        {
            "id": name,
            "name": name,
            "long": long,
            "storey": "Ground",
            "z0": 0.0,
            "z1": 2.5,
            "polygon": [{"ext": [*square(x, 0, x + 2.9, 3).tolist(), [x, 0.0]], "holes": []}],
        }
        for name, long, x in (("1", "Flur", 0.0), ("2", "Buero", 3.1))
    ]
    door = {"kind": "door", "center": [3.0, 1.5, 0.0], "width": 0.9}
    links = [{**door, "a": 0, "b": 1}, {**door, "a": 0, "b": None}]
    links.append({"kind": "virtual", "a": 1, "b": 0, "length": 3.0})
    truth = {"storeys": [["Ground", 0.0]], "rooms": rooms, "links": links}
    (folder / "model.json").write_text(json.dumps(truth))
    return folder / "model.npz"


def test_a_bim_model_loses_its_doors_and_spaces(tmp_path):
    building = load_building(str(write_bim(tmp_path)))
    assert building.face_tag.tolist() == [0, 0, 1, 1]
    assert [room.kind for room in building.rooms] == ["corridor", "office"]
    assert [(link.rooms, link.kind) for link in building.links] == [
        ((0, 1), "door"),
        ((1, 0), "virtual"),
    ]
    assert building.links[1].position[0] == pytest.approx(3.1, abs=0.01)


def write_plan(folder):
    """Write a plan of two rooms with a door of 1 m between them, and its furniture and rooms."""
    plan = np.zeros((80, 120))
    plan[10:70, 10:58] = plan[10:70, 62:110] = plan[30:50, 58:62] = 1.0
    segmented = plan.copy()
    segmented[:, 59:61] = 0.0
    furnished = plan.copy()
    furnished[12:22, 12:32] = 0.0
    pictures = {"": plan, "_gt_segmentation": segmented, "_furnitures": furnished}
    for name, picture in pictures.items():
        imsave(folder / f"plan{name}.png", picture, cmap="gray", vmin=0, vmax=1)
    return folder / "plan.png"


def test_a_floor_plan_becomes_walls_rooms_and_a_door(tmp_path):
    building = load_building(str(write_plan(tmp_path)))
    (link,) = building.links
    assert (link.rooms, link.kind, link.width) == ((0, 1), "door", pytest.approx(1.0))
    assert link.position == pytest.approx([3.0, 2.0, 0.0], abs=0.06)
    places = np.array([[2.0, 2.0, 1.0], [4.0, 2.0, 1.0], [2.0, 6.0, 1.0]])
    assert building.room_of(places).tolist() == [0, 1, -1]
    sides = np.array([[1.0, 0.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])
    free = first_hits(building, np.tile([2.0, 1.0, 1.0], (4, 1)), sides)
    assert free == pytest.approx([0.9, 1.5, 2.5, 1.7], abs=1e-4)


def test_the_furniture_of_a_floor_plan_stands_on_its_floor(tmp_path):
    plan = write_plan(tmp_path)
    building = load_building(str(plan.with_name("plan_furnitures.png")))
    assert building.face_tag.max() == 1
    down = np.array([[0.0, 0.0, -1.0]])
    assert first_hits(building, np.array([[1.0, 0.8, 2.0]]), down) == pytest.approx(1.1, abs=1e-4)


def room_cloud(x0, y0, x1, y1, floor=0.0):
    """Points on the floor and on the walls of a room."""
    x, y = np.meshgrid(np.arange(x0, x1, 0.05), np.arange(y0, y1, 0.05))
    flat = np.column_stack([x.ravel(), y.ravel()])
    edge = (flat[:, 0] < x0 + 0.05) | (flat[:, 1] < y0 + 0.05)
    points = [np.column_stack([flat, np.full(len(flat), floor)])]
    points += [np.column_stack([flat[edge], np.full(edge.sum(), floor + z)]) for z in (1.0, 2.5)]
    return np.concatenate(points)


CLOUDS = {
    "hallway_1": np.concatenate([room_cloud(0, 0, 8, 2), room_cloud(1, 2, 2, 2.2)]),
    "office_1": room_cloud(0, 2.2, 3.9, 6),
    "office_2": room_cloud(4.2, 2.3, 8, 6),
}


def write_s3dis(folder):
    area = folder / "Area_9"
    for name, points in CLOUDS.items():
        (area / name / "Annotations").mkdir(parents=True)
        rows = np.column_stack([points, np.full((len(points), 3), 128)])
        np.savetxt(area / name / f"{name}.txt", rows, fmt=["%.3f"] * 3 + ["%d"] * 3)
    with (area / "office_2" / "office_2.txt").open("ab") as file:
        file.write(b"5.0 5.\x10 0.0 1 2 3\n")
    return area


def test_an_area_of_s3dis_keeps_its_rooms_and_proposes_its_links(tmp_path):
    building = load_building(str(write_s3dis(tmp_path)))
    assert building.is_cloud
    assert [room.name for room in building.rooms] == list(CLOUDS)
    assert [room.kind for room in building.rooms] == ["corridor", "office", "office"]
    assert [link.rooms for link in building.links] == [(0, 1)]
    assert building.links[0].position[:2] == pytest.approx([1.5, 2.2], abs=0.3)
    assert building.room_of(np.array([[2.0, 4.0, 0.0], [6.0, 4.0, 0.1]])).tolist() == [1, 2]


def test_a_room_of_s3dis_keeps_its_folders_name(tmp_path):
    area = write_s3dis(tmp_path)
    (area / "Area_9_alignmentAngle.txt").write_text("## Global alignment angle ##\noffice_1 90\n")
    (area / "office_1" / "office_1.txt").rename(area / "office_1" / "off_ice_1.txt")
    assert [room.name for room in load_building(str(area)).rooms] == list(CLOUDS)
    (area / "office_1" / "off_ice_1.txt").unlink()
    with pytest.raises(BuildingError, match=r"office_1.txt: no such file"):
        load_building(str(area))


def test_the_aligned_version_of_s3dis_is_refused(tmp_path):
    area = write_s3dis(tmp_path / "Stanford3dDataset_v1.2_Aligned_Version")
    with pytest.raises(BuildingError, match="turned by itself"):
        load_building(str(area))


def labelled_ply(path, clouds, name="label"):
    points = np.concatenate(list(clouds))
    table = np.empty(len(points), [("x", "f4"), ("y", "f4"), ("z", "f4"), (name, "i4")])
    for axis, values in zip("xyz", points.T, strict=True):
        table[axis] = values
    table[name] = np.repeat(3 * np.arange(len(clouds)), [len(cloud) for cloud in clouds])
    write_ply(path, table if name else table[["x", "y", "z"]])


@pytest.mark.parametrize("name", ["label", "room"])
def test_a_labelled_ply_is_a_building(tmp_path, name):
    labelled_ply(tmp_path / "house.ply", CLOUDS.values(), name)
    building = load_building(str(tmp_path / "house.ply"))
    assert [room.name for room in building.rooms] == ["room 0", "room 3", "room 6"]
    assert len(building.points) == sum(len(cloud) for cloud in CLOUDS.values())
    assert [link.rooms for link in building.links] == [(0, 1)]


def test_the_maps_of_cslamd_are_moved_into_one_frame_and_labelled(tmp_path):
    scene = tmp_path / "house"
    scene.mkdir()
    labelled_ply(scene / "annotation.ply", CLOUDS.values())
    turn = np.array([[0.0, -1.0, 0.0, 3.0], [1.0, 0.0, 0.0, 1.0], [0, 0, 1, 0.5], [0, 0, 0, 1.0]])
    for name, parts in (("a", ("hallway_1", "office_1")), ("b", ("hallway_1", "office_2"))):
        points = np.concatenate([CLOUDS[part] for part in parts])
        points = (points - turn[:3, 3]) @ turn[:3, :3]
        vertices = [tuple(point) for point in points.astype(np.float32)]
        write_ply(scene / f"{name}.ply", np.array(vertices, [(axis, "f4") for axis in "xyz"]))
        np.savetxt(scene / f"{name}.txt", turn)
    building = load_building(str(scene))
    assert len(building.rooms) == 3
    assert building.room_of(np.array([[6.0, 4.0, 0.0]])).tolist() == [2]
    assert (building.labels >= 0).all()


def test_the_meshes_of_cslamd_share_a_frame_and_take_labels(tmp_path):
    scene = tmp_path / "House"
    (scene / "meshes").mkdir(parents=True)
    labelled_ply(scene / "annotation.ply", CLOUDS.values())
    # As a camera's frame is: z ahead, y down.
    T_building_meshes = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 1.5], [0, 0, 0, 1]])
    np.savetxt(scene / "meshes.txt", T_building_meshes)
    for name in ("hallway_1", "office_1"):
        points = (CLOUDS[name] - T_building_meshes[:3, 3]) @ T_building_meshes[:3, :3]
        vertices = [tuple(point) for point in points.astype(np.float32)]
        write_ply(scene / "meshes" / f"{name}.ply", np.array(vertices, [(k, "f4") for k in "xyz"]))
    building = load_building(str(scene))
    assert len(building.rooms) == 2
    assert building.room_of(np.array([[2.0, 4.0, 0.0], [4.0, 1.0, 0.0]])).tolist() == [1, 0]


def test_sidecars_replace_the_links_and_bring_walks(tmp_path):
    labelled_ply(tmp_path / "house.ply", CLOUDS.values())
    path = tmp_path / "house.ply"
    building = load_building(str(path))
    write_graph(building, graph_path(path))
    again = load_building(str(path))
    assert [link.rooms for link in again.links] == [(0, 1)]
    text = graph_path(path).read_text()
    graph_path(path).write_text(
        text + "- rooms: [room 0, room 6]\n  kind: opening\n  position: [5, 2.1, 0]\n"
    )
    trajectory_path(path).write_text(
        "agents:\n- agent: a\n  rooms: [room 0, 2]\n- agent: b\n  waypoints: [[1, 1, 0], [7, 1]]\n"
    )
    corrected = load_building(str(path))
    assert [link.kind for link in corrected.links] == ["door", "opening"]
    assert corrected.links[1].rooms == (0, 2)
    assert corrected.trajectories[0].rooms == (0, 2)
    np.testing.assert_array_equal(corrected.trajectories[1].waypoints, [[1, 1, 0], [7, 1, np.nan]])
    trajectory_path(path).write_text("agents:\n- agent: b\n  waypoints: [1, 2, 3]\n")
    with pytest.raises(BuildingError, match=r"agent b: waypoints: expected \[x, y\]"):
        load_building(str(path))


def test_damaged_buildings_are_refused_in_one_line(tmp_path):
    (tmp_path / "empty").mkdir()
    (tmp_path / "broken.png").write_bytes(b"no picture")
    (tmp_path / "broken.npz").write_bytes(b"no archive")
    labelled_ply(tmp_path / "plain.ply", CLOUDS.values(), "colour")
    labelled_ply(tmp_path / "house.ply", CLOUDS.values())
    (tmp_path / "house.graph.yaml").write_text("links:\n- rooms: [room 0, cellar]\n")
    names = ("none.png", "empty", "broken.png", "broken.npz", "plain.ply", "house.ply")
    for name in names:
        with pytest.raises(BuildingError) as caught:
            load_building(str(tmp_path / name))
        assert "\n" not in str(caught.value)


@needs_data
@pytest.mark.parametrize("name", ["duplex", "institute_var2", "office_cv2"])
def test_the_rooms_of_the_shared_models_hold_what_their_doors_join(name):
    building = load_building(str(DATA / "buildings" / f"{name}.npz"))
    truth = json.loads((DATA / "buildings" / f"{name}.json").read_text())
    assert len(building.rooms) == len(truth["rooms"])
    doors = [link for link in building.links if link.kind == "door"]
    angles = np.arange(0, 2 * np.pi, np.pi / 8)
    around = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles])
    for link in doors:
        seen = building.room_of(link.position + (0, 0, 1) + 0.1 * around, around)
        assert set(link.rooms) & set(seen.tolist())


@needs_data
@pytest.mark.parametrize("name", ["office_b", "lab_ipa"])
def test_the_shared_floor_plans_are_of_one_piece(name):
    building = load_building(str(DATA / "floorplans" / f"{name}.png"))
    assert len(building.rooms) >= 10
    assert is_one_piece(building)


@needs_data
@pytest.mark.parametrize(
    ("pair", "building", "first_id"),
    [("duplex_101", "buildings/duplex.npz", 0), ("office_f_apart", "floorplans/office_f.png", 1)],
)
def test_rooms_are_those_of_the_ready_made_pairs(pair, building, first_id):
    truth = json.loads((DATA / "pairs" / pair / "truth.json").read_text())
    points = read_ply_points(DATA / "pairs" / pair / "a.ply")[::20]
    expected = np.load(DATA / "pairs" / pair / "truth.npz")["a"][::20]
    T = np.linalg.inv(truth["a_from_world"])
    found = load_building(str(DATA / building)).room_of(points @ T[:3, :3].T + T[:3, 3])
    labelled = (found >= 0) & (expected >= 0)
    assert labelled.mean() > 0.99
    assert (found + first_id == expected)[labelled].mean() > 0.97
