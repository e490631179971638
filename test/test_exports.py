"""Exports say what the map says: clouds, Nav2 grids and route graphs, GraphML."""

import dataclasses
import json
from pathlib import Path

import networkx
import numpy as np
import pytest
import yaml

from test.helpers_io import random_map
from topometric_ros.cli.main import main
from topometric_ros.io.clouds import read_cloud
from topometric_ros.io.exports import FORMATS, ExportError, export_map
from topometric_ros.io.map_files import save_map
from topometric_ros.io.occupancy import FREE, OCCUPIED, UNKNOWN, occupancy_grid
from topometric_ros.io.route_graph import route_graph
from topometric_ros.topometric_map import Passage, Room, Storey, StoreyLayers, TopometricMap

TURN = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0, 0, 0, 1.0]])
DOOR = 3.5
"""y of the middle of the door between the rooms of :func:`two_rooms`, m."""


def two_rooms(T_level_input: np.ndarray | None = None) -> TopometricMap:
    """Return rooms of 4 m x 4 m side by side, a door at one end of their wall, a desk between."""
    cells = np.zeros((82, 42), dtype=bool)
    wall = cells.copy()
    wall[[0, 41, 81]] = True
    wall[:, [0, 41]] = True
    wall[41, 31:40] = False
    furniture = cells.copy()
    furniture[55:60, 10:30] = True
    free = ~wall & ~furniture
    layers = StoreyLayers(0.1, (0.0, 0.0), wall, furniture, free, free.copy())
    bounds = (((0.0, 0.0, 0.0), (4.1, 4.1, 2.5)), ((4.1, 0.0, 0.0), (8.1, 4.1, 2.5)))
    return dataclasses.replace(
        random_map(),
        rooms=(
            Room(3, 0, (2.0, 2.0, 1.0), bounds[0], 10, 16.0, False),
            Room(7, 0, (6.5, 1.0, 1.0), bounds[1], 10, 16.0, False),
        ),
        passages=(Passage((3, 7), (4.1, DOOR, 0.1), 0.9),),
        storeys=(Storey(0, 0.0, 2.5, layers),),
        T_level_input=np.eye(4) if T_level_input is None else T_level_input,
        frame_id="robot1/map",
    )


def test_a_grid_tells_free_occupied_and_unknown() -> None:
    m = two_rooms()
    layers = m.storeys[0].layers
    layers.bare[10, 10] = False
    layers.free[20, 20] = layers.bare[20, 20] = False
    values = occupancy_grid(m, m.storeys[0]).values
    assert values.shape == (42, 82)
    assert values[20, 41] == OCCUPIED, "wall"
    assert values[20, 57] == OCCUPIED, "furniture"
    assert values[10, 10] == OCCUPIED, "something low on the floor"
    assert values[20, 20] == UNKNOWN
    assert values[35, 41] == FREE, "the door"


@pytest.mark.parametrize("turned", [False, True])
def test_the_yaml_puts_the_image_where_the_building_is(tmp_path: Path, turned: bool) -> None:
    m = two_rooms(TURN if turned else None)
    export_map(tmp_path, m, ["pgm"])
    header = yaml.safe_load((tmp_path / "storey_0.yaml").read_text())
    magic, size, most, pixels = (tmp_path / "storey_0.pgm").read_bytes().split(b"\n", 3)
    assert (magic, size, most) == (b"P5", b"82 42", b"255")
    image = np.frombuffer(pixels, np.uint8).reshape(42, 82)
    # The door's cell by the rules of the map server, against its place in the level frame.
    row, column = 35, 41
    assert image[41 - row, column] == 254
    assert image[41 - 5, column] == 0
    x, y, yaw = header["origin"]
    along, across = (np.array([column, row]) + 0.5) * header["resolution"]
    found = (
        x + np.cos(yaw) * along - np.sin(yaw) * across,
        y + np.sin(yaw) * along + np.cos(yaw) * across,
    )
    place = np.linalg.inv(m.T_level_input) @ (4.1, DOOR, 0.0, 1.0)
    assert found == pytest.approx(place[:2], abs=1e-6)


@pytest.mark.parametrize("turned", [False, True])
def test_routes_lead_through_the_door_and_through_no_wall(turned: bool) -> None:
    m = two_rooms(TURN if turned else None)
    graph = route_graph(m, m.storeys[0])
    nodes = {
        f["properties"]["id"]: f for f in graph["features"] if f["geometry"]["type"] == "Point"
    }
    edges = [f for f in graph["features"] if f["geometry"]["type"] == "MultiLineString"]
    ids = [f["properties"]["id"] for f in graph["features"]]
    assert len(set(ids)) == len(ids)
    assert all(f["properties"]["metadata"]["seen"] for f in edges)
    assert {f["properties"]["frame"] for f in nodes.values()} == {"robot1/map"}
    net = networkx.DiGraph((f["properties"]["startid"], f["properties"]["endid"]) for f in edges)
    kinds = {i: f["properties"]["metadata"]["kind"] for i, f in nodes.items()}
    a, b = (i for i, kind in kinds.items() if kind == "room")
    for start, end in ((a, b), (b, a)):
        assert "passage" in {kinds[node] for node in networkx.shortest_path(net, start, end)}
    wall = m.storeys[0].layers.wall | m.storeys[0].layers.furniture
    for edge in edges:
        ((start, end),) = (np.array(line) for line in edge["geometry"]["coordinates"])
        line = start + (end - start) * np.linspace(0.0, 1.0, 200)[:, None]
        level = np.column_stack([line, np.zeros(200), np.ones(200)]) @ m.T_level_input.T
        cells = np.rint(level[:, :2] / 0.1).astype(int)
        assert not wall[cells[:, 0], cells[:, 1]].any()


def test_a_room_whose_floor_was_not_seen_keeps_its_edge_and_says_so() -> None:
    m = two_rooms()
    layers = m.storeys[0].layers
    layers.free[42:] = layers.bare[42:] = False
    graph = route_graph(m, m.storeys[0])
    seen = {
        f["properties"]["metadata"]["room"]: f["properties"]["metadata"]["seen"]
        for f in graph["features"]
        if f["geometry"]["type"] == "MultiLineString"
    }
    assert seen == {3: True, 7: False}


@pytest.mark.parametrize("name", ["ply", "pcd", "laz"])
def test_clouds_read_back_as_the_surface_in_the_input_frame(tmp_path: Path, name: str) -> None:
    m = random_map()
    seen = np.arange(len(m.voxels), dtype=np.uint32) % 3 + 1
    (path,) = export_map(tmp_path, m, [name], seen)
    T = np.linalg.inv(m.T_level_input)
    expected = m.surface() @ T[:3, :3].T + T[:3, 3]
    tolerance = {"ply": 0.0, "pcd": 1e-6, "laz": 1e-4}[name]
    np.testing.assert_allclose(read_cloud(path).points, expected, rtol=0, atol=tolerance)
    assert path.read_bytes() == export_map(tmp_path, m, [name], seen)[0].read_bytes()


def test_laz_holds_rooms_storeys_and_agents(tmp_path: Path) -> None:
    import laspy

    m = random_map()
    seen = np.arange(len(m.voxels), dtype=np.uint32) % 3 + 1
    (path,) = export_map(tmp_path, m, ["laz"], seen)
    las = laspy.read(path)
    np.testing.assert_array_equal(np.asarray(las["room"]), m.room)
    np.testing.assert_array_equal(np.asarray(las["agent"]), seen)
    assert set(np.asarray(las["storey"])[m.room >= 0]) == {0}
    assert las.header.creation_date.isoformat() == "2026-01-01"


def test_graphml_is_the_topological_graph(tmp_path: Path) -> None:
    m = random_map()
    (path,) = export_map(tmp_path, m, ["graphml"])
    graph = networkx.read_graphml(path, node_type=int, force_multigraph=True)
    assert set(graph.nodes) == {3, 7}
    assert graph.nodes[3]["area"] == 12.34
    assert graph.nodes[3]["centroid_y"] == 0.1
    assert [data["width"] for _, _, data in graph.edges(data=True)] == [0.9]


def test_the_command_writes_every_format(tmp_path: Path) -> None:
    folder = tmp_path / "out"
    folder.mkdir()
    m = two_rooms()
    save_map(folder / "map.tmap", m)
    assert main(["export", str(folder), "-o", str(tmp_path / "all")]) == 0
    suffixes = {path.suffix[1:] for path in (tmp_path / "all").iterdir()}
    assert suffixes == {*FORMATS, "yaml"}
    assert json.loads((tmp_path / "all" / "storey_0.geojson").read_text())["features"]


def test_bad_input_is_one_line(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["export", str(tmp_path), "-o", str(tmp_path / "all")]) == 2
    assert "expected global.tmap or map.tmap" in capsys.readouterr().err
    with pytest.raises(ExportError, match="expected one of ply"):
        export_map(tmp_path, random_map(), ["obj"])
