"""The simulated building, its agents and sensor, and the bag that they leave behind."""

import json
from pathlib import Path

import numpy as np
import pytest
from rosbags.interfaces import QosDurability, QosReliability
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from topometric_ros.simulation.agents import (
    WalkConfig,
    path_through,
    rotation,
    sensor_poses,
    translation,
)
from topometric_ros.simulation.building import (
    Area,
    BuildingConfig,
    BuildingError,
    Opening,
    make_building,
)
from topometric_ros.simulation.demo import ROOMS_WALKED, DemoConfig, main, make_demo
from topometric_ros.simulation.office import office
from topometric_ros.simulation.scanner import LidarConfig, Scanner, ray_directions

BAGS = Path(__file__).parent.parent / "bags"
EXACT = LidarConfig(rings=3, azimuths=4, lowest=-45.0, highest=45.0, noise=0.0, step=0.0)


def one_room(openings=()):
    """A room of 6 m by 4 m between the walls' middle lines."""
    areas = (Area(0, (0.0, 0.0, 6.0, 4.0)),)
    return make_building(("room",), areas, tuple(openings), (), BuildingConfig(wall=0.2))


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """A freshly made demo bag."""
    directory = tmp_path_factory.mktemp("bags") / "demo"
    make_demo(directory)
    return directory


def read(directory):
    """Return {topic: [(stamp, message)]} and the connections of a bag."""
    store = get_typestore(Stores.ROS2_JAZZY)
    messages = {}
    with Reader(directory) as reader:
        for connection, stamp, raw in reader.messages():
            message = store.deserialize_cdr(raw, connection.msgtype)
            messages.setdefault(connection.topic, []).append((stamp, message))
        return messages, {c.topic: c for c in reader.connections}


def matrix(transform):
    """Return a geometry_msgs Transform as 4 x 4."""
    from scipy.spatial.transform import Rotation

    q, t = transform.rotation, transform.translation
    T = translation(t.x, t.y, t.z)
    T[:3, :3] = Rotation.from_quat((q.x, q.y, q.z, q.w)).as_matrix()
    return T


def distance_to_surfaces(points):
    """Return how far points (n, 3), m, building frame, lie from the office's solids: (n,), m."""
    import open3d as o3d

    vertices, triangles = office().mesh()
    scene = o3d.t.geometry.RaycastingScene()
    scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(triangles))
    return scene.compute_distance(o3d.core.Tensor(points.astype(np.float32))).numpy()


def test_a_ray_ends_on_the_wall_it_points_at():
    scanner = Scanner(one_room(), EXACT)
    points = scanner.scan(translation(2.0, 1.5, 1.0), np.random.default_rng(0))
    level = points[np.abs(points[:, 2]) < 1e-6]
    # Faces are half a wall's thickness inside the middle lines: x from 0.1 to 5.9, y 0.1 to 3.9.
    expected = [(3.9, 0), (0, 2.4), (-1.9, 0), (0, -1.4)]
    np.testing.assert_allclose(level[:, :2], expected, atol=1e-5)


def test_a_turned_sensor_sees_the_same_walls_in_its_own_frame():
    scanner = Scanner(one_room(), EXACT)
    T = translation(2.0, 1.5, 1.0) @ rotation(0.0, 0.0, np.pi / 2)
    points = scanner.scan(T, np.random.default_rng(0))
    level = points[np.abs(points[:, 2]) < 1e-6]
    np.testing.assert_allclose(level[:, :2], [(2.4, 0), (0, 1.9), (-1.4, 0), (0, -3.9)], atol=1e-5)


def test_floor_and_ceiling_lie_at_their_heights():
    scanner = Scanner(one_room(), LidarConfig(noise=0.0, step=0.0))
    points = scanner.scan(translation(3.0, 2.0, 1.1), np.random.default_rng(0))
    assert points[:, 2].min() == pytest.approx(-1.1, abs=1e-4)
    assert points[:, 2].max() == pytest.approx(1.6, abs=1e-4)


def test_glass_returns_nothing_and_a_lintel_does():
    window = Opening("window", (3.0, 0.0), 2.0)
    scanner = Scanner(one_room([window]), EXACT)
    assert len(scanner.scan(translation(3.0, 2.0, 1.5), np.random.default_rng(0))) == 11
    above = scanner.scan(translation(3.0, 2.0, 2.4), np.random.default_rng(0))
    assert (np.abs(above[:, 2]) < 1e-6).sum() == 4


def test_range_noise_is_as_wide_as_asked_and_seeded():
    config = LidarConfig(noise=0.01, step=0.0)
    scanner = Scanner(one_room(), config)
    pose = translation(3.0, 2.0, 1.1)
    clean = Scanner(one_room(), LidarConfig(noise=0.0, step=0.0)).scan(
        pose, np.random.default_rng(0)
    )
    noisy = scanner.scan(pose, np.random.default_rng(1))
    error = np.linalg.norm(noisy, axis=1) - np.linalg.norm(clean, axis=1)
    assert error.std() == pytest.approx(0.01, rel=0.05)
    assert abs(error.mean()) < 0.001
    np.testing.assert_array_equal(noisy, scanner.scan(pose, np.random.default_rng(1)))


def test_ray_directions_are_unit_vectors_between_the_lowest_and_highest_ring():
    directions = ray_directions(LidarConfig())
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1.0)
    assert np.degrees(np.arcsin(directions[:, 2].max())) == pytest.approx(55.0)


def test_areas_of_one_room_have_no_wall_between_them():
    areas = (Area(0, (0.0, 0.0, 4.0, 2.0)), Area(0, (4.0, 0.0, 6.0, 5.0)))
    building = make_building(("corridor",), areas, (), (), BuildingConfig())
    scanner = Scanner(building, EXACT)
    points = scanner.scan(translation(1.0, 1.0, 1.2), np.random.default_rng(0))
    assert points[:, 0].max() == pytest.approx(6.0 - 0.08 - 1.0, abs=1e-5)


def test_an_opening_off_every_wall_is_refused():
    with pytest.raises(BuildingError, match=r"door at \(3.0, 1.0\) m lies on no wall"):
        one_room([Opening("door", (3.0, 1.0), 0.9)])


def test_agents_keep_clear_of_walls_and_furniture():
    building = office()
    solid = [b for b in building.structure + building.furniture if b.upper[2] > 0 < 2 - b.lower[2]]
    lower = np.array([b.lower[:2] for b in solid])
    upper = np.array([b.upper[:2] for b in solid])
    for rooms in ROOMS_WALKED.values():
        path = path_through(building, rooms)
        poses = sensor_poses(path, WalkConfig(spacing=0.1), np.random.default_rng(0))
        xy = np.array([pose[:2, 3] for pose in poses])[:, None]
        gap = np.linalg.norm(np.maximum(0, np.maximum(lower - xy, xy - upper)), axis=2)
        assert gap.min() > 0.4
        assert {building.room_at(*p) for p in xy[:, 0]} == {0, *rooms}


def test_no_way_leads_into_a_room_without_a_door():
    areas = (Area(0, (0.0, 0.0, 3.0, 3.0)), Area(1, (3.0, 0.0, 6.0, 3.0)))
    building = make_building(("hall", "vault"), areas, (), (), BuildingConfig())
    with pytest.raises(BuildingError, match="no way leads from hall to vault"):
        path_through(building, (0, 1))


def test_the_demo_is_byte_identical_when_made_again(demo, tmp_path):
    again = tmp_path / "demo"
    make_demo(again)
    for name in ("demo/demo.mcap", "demo/metadata.yaml", "demo.truth.json"):
        assert (demo.parent / name).read_bytes() == (tmp_path / name).read_bytes()


def test_the_committed_bag_is_what_the_script_makes(demo):
    # Compared as messages: another release of the compressor may pack them differently.
    fresh, _ = read(demo)
    committed, _ = read(BAGS / "demo")
    assert {t: len(m) for t, m in fresh.items()} == {t: len(m) for t, m in committed.items()}
    for topic in ("/robot1/scan_cloud", "/robot2/scan_cloud"):
        for (t0, a), (t1, b) in zip(fresh[topic], committed[topic], strict=True):
            assert t0 == t1
            assert abs(a.width - b.width) <= 5
    assert json.loads((BAGS / "demo.truth.json").read_text()) == json.loads(
        (demo.parent / "demo.truth.json").read_text()
    )


def test_the_committed_bag_is_small_enough_to_carry():
    files = [BAGS / "demo.truth.json", *(BAGS / "demo").iterdir()]
    assert sum(f.stat().st_size for f in files) <= 5_000_000


def test_topics_and_qos_are_those_of_a_recording():
    messages, connections = read(BAGS / "demo")
    assert set(messages) == {"/robot1/scan_cloud", "/robot2/scan_cloud", "/tf", "/tf_static"}
    scans = len(messages["/robot1/scan_cloud"]) + len(messages["/robot2/scan_cloud"])
    assert len(messages["/tf"]) == scans
    for topic, connection in connections.items():
        (qos,) = connection.ext.offered_qos_profiles
        latched = topic == "/tf_static"
        assert qos.reliability is QosReliability.RELIABLE
        assert qos.durability is (
            QosDurability.TRANSIENT_LOCAL if latched else QosDurability.VOLATILE
        )


def test_scans_put_into_the_building_by_tf_and_truth_lie_on_its_surfaces():
    messages, _ = read(BAGS / "demo")
    truth = json.loads((BAGS / "demo.truth.json").read_text())
    static = {
        t.child_frame_id: matrix(t.transform) for t in messages["/tf_static"][0][1].transforms
    }
    moving = {}
    for _, message in messages["/tf"]:
        odom, base = message.transforms
        T = matrix(odom.transform) @ matrix(base.transform)
        moving[base.child_frame_id, base.header.stamp.sec, base.header.stamp.nanosec] = T
    for agent in ("robot1", "robot2"):
        T_building_map = np.linalg.inv(truth[f"T_{agent}_building"])
        for _, cloud in messages[f"/{agent}/scan_cloud"][::10]:
            stamp = cloud.header.stamp
            T = T_building_map @ moving[f"{agent}/base_link", stamp.sec, stamp.nanosec]
            T = T @ static[f"{agent}/lidar"]
            points = cloud.data.view("<f4").reshape(-1, 3) @ T[:3, :3].T + T[:3, 3]
            assert np.quantile(distance_to_surfaces(points), 0.99) < 0.04


def test_the_truth_joins_the_two_map_frames():
    truth = json.loads((BAGS / "demo.truth.json").read_text())
    T1, T2 = (np.array(truth[f"T_robot{k}_building"]) for k in (1, 2))
    np.testing.assert_allclose(T1 @ np.linalg.inv(T2), truth["T_robot1_robot2"], atol=1e-9)
    assert truth["rooms_walked"] == {k: [0, *v] for k, v in ROOMS_WALKED.items()}


def test_the_script_refuses_to_overwrite_a_bag(tmp_path, capsys):
    assert main([str(tmp_path)]) == 2
    assert "exists already" in capsys.readouterr().err


def test_another_seed_gives_other_frames(tmp_path):
    make_demo(tmp_path / "other", DemoConfig(seed=8))
    other = json.loads((tmp_path / "other.truth.json").read_text())
    assert other != json.loads((BAGS / "demo.truth.json").read_text())
