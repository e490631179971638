"""Simulated agents: the truth about them holds, and what is asked to go wrong does, no more."""

from dataclasses import replace

import numpy as np
import pytest

from test.helpers_simulation import ONE_WALK, SPEC, configured, in_building
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.case import overlaps_of
from topometric_ros.simulation.cases import Walk, prepare, simulate
from topometric_ros.simulation.degrade import (
    DegradeConfig,
    drifted,
    move_furniture,
    random_frame,
    thinned,
)
from topometric_ros.simulation.sensors import CameraConfig, camera_directions
from topometric_ros.simulation.simulation_config import parse_walk
from topometric_ros.simulation.world import make_world


@pytest.fixture(scope="module")
def building():
    return load_building(SPEC)


@pytest.fixture(scope="module")
def ready(building):
    return prepare(building, configured())


def test_another_seed_gives_other_walks_and_frames(ready):
    one, two = (simulate(ready, configured(), seed) for seed in (1, 2))
    assert not np.allclose(one.T_a_b(0, 1), two.T_a_b(0, 1))
    assert one.agents[0].rooms_walked != two.agents[0].rooms_walked


def test_points_put_into_the_building_lie_on_its_surfaces(ready):
    case = simulate(ready, configured(sensor__lidar__noise=0.0), 1)
    for agent in case.agents:
        assert ready.world.clearance(in_building(agent)).max() < 1e-3


def test_range_noise_is_as_wide_as_asked(ready):
    exact, noisy = (
        simulate(
            ready, configured(sensor__lidar__noise=noise, degrade__resolution=0.0), 1, ONE_WALK
        ).agents[0]
        for noise in (0.0, 0.02)
    )
    away = np.linalg.norm(noisy.points - exact.points, axis=1)
    assert np.sqrt(np.mean(away**2)) == pytest.approx(0.02, rel=0.03)
    # Along the ray alone: the sensor, the surface and the point are on one line.
    sensors = exact.poses[exact.scan_of_point][:, :3, 3]
    ray, error = exact.points - sensors, noisy.points - exact.points
    sideways = np.linalg.norm(np.cross(ray, error), axis=1) / np.linalg.norm(ray, axis=1)
    assert sideways.max() < 1e-4


@pytest.mark.parametrize("wanted", [0.0, 0.2, 0.5, 0.8])
def test_the_overlap_comes_near_the_wanted_one(ready, wanted):
    got = [float(simulate(ready, configured(overlap=wanted), seed).overlap[0]) for seed in (1, 2)]
    if wanted == 0.0:
        assert max(got) < 0.02
    else:
        assert np.mean(got) == pytest.approx(wanted, abs=0.12)


def test_the_overlap_is_that_of_the_maps(ready):
    case = simulate(ready, configured(sensor__lidar__noise=0.0), 1)
    measured = overlaps_of([in_building(agent) for agent in case.agents])
    np.testing.assert_allclose(measured, case.overlap, atol=0.02)


def test_every_room_walked_is_seen_and_every_label_is_a_room(ready, building):
    for agent in simulate(ready, configured(), 1).agents:
        count = np.bincount(agent.room + 1, minlength=len(building.rooms) + 1)
        assert (count[1:][list(agent.rooms_walked)] > 500).all()
        assert count[0] < 0.05 * count.sum()
        # Rooms keep to themselves: their points lie within reach of their polygons' boxes.
        points = in_building(agent)
        for room in agent.rooms_walked:
            polygon, own = building.rooms[room].polygon, points[agent.room == room, :2]
            assert (own > polygon.min(axis=0) - 0.5).all()
            assert (own < polygon.max(axis=0) + 0.5).all()


def test_agents_keep_clear_of_everything_that_stands_there(ready):
    walked = ready.walkable.places[ready.walkable.component == ready.walkable.component[0]]
    assert ready.world.clearance(walked + [0.0, 0.0, 1.2]).min() >= 0.25


def test_dropout_loses_its_share_and_moves_no_point(ready):
    full, sparse = (
        simulate(
            ready, configured(degrade__dropout=share, degrade__resolution=0.0), 1, ONE_WALK
        ).agents[0]
        for share in (0.0, 0.3)
    )
    assert len(sparse.points) / len(full.points) == pytest.approx(0.7, abs=0.01)
    assert set(map(bytes, sparse.points)) <= set(map(bytes, full.points))


def test_drift_grows_with_the_root_of_the_way_and_leaves_the_truth_in_its_middle():
    poses = np.tile(np.eye(4), (101, 1, 1))
    poses[:, 0, 3] = np.arange(101.0)
    config = DegradeConfig(drift=0.02)
    ends = []
    for seed in range(200):
        believed = drifted(poses, config, np.random.default_rng(seed))
        steps = np.diff(believed[:, :3, 3], axis=0)
        ends.append(np.std(np.linalg.norm(steps, axis=1)))
        away = believed[:, :3, 3] - poses[:, :3, 3]
        np.testing.assert_allclose(away.mean(axis=0), 0.0, atol=1e-9)
    assert np.mean(ends) == pytest.approx(0.02, rel=0.05)
    still = drifted(poses, DegradeConfig(), np.random.default_rng(0))
    np.testing.assert_array_equal(still, poses)


def test_drift_bends_the_map_and_nothing_else_changes(ready):
    straight, bent = (
        simulate(ready, configured(degrade__drift=d, degrade__resolution=0.0), 1).agents[0]
        for d in (0.0, 0.02)
    )
    np.testing.assert_array_equal(straight.room, bent.room)
    np.testing.assert_array_equal(straight.T_agent_building, bent.T_agent_building)
    away = np.linalg.norm(straight.points - bent.points, axis=1)
    assert 0.01 < away.mean() < 0.5


def test_moved_furniture_stays_in_its_room_and_walls_stay_where_they_are(building):
    config = DegradeConfig(moved=1.0, moved_by=1.5)
    vertices = move_furniture(building, config, np.random.default_rng(0))
    moved = np.linalg.norm(vertices - building.vertices, axis=1) > 0
    assert moved.sum() > 0
    assert np.linalg.norm(vertices - building.vertices, axis=1).max() <= 1.5
    assert not moved[np.unique(building.faces[building.face_tag == 0])].any()
    strict = np.zeros_like(vertices[moved])
    assert (building.room_of(vertices[moved], strict) >= 0).all()


def test_the_first_agent_sees_the_furniture_where_it_was(ready):
    kept, moved = (
        simulate(ready, configured(degrade__moved=share), 1, ONE_WALK).agents
        for share in (0.0, 1.0)
    )
    np.testing.assert_array_equal(kept[0].points, moved[0].points)
    assert len(kept[1].points) != len(moved[1].points)


def test_ceilings_are_seen_by_whom_the_configuration_says(ready, building):
    highest = {
        who: [in_building(a)[:, 2].max() for a in simulate(ready, config, 1, ONE_WALK).agents]
        for who in ("seen", "first", "none")
        for config in [configured(degrade__ceiling=who)]
    }
    ceiling = building.rooms[0].z_high
    seen = {who: [z > ceiling - 0.2 for z in heights] for who, heights in highest.items()}
    assert seen == {"seen": [True, True], "first": [True, False], "none": [False, False]}


def test_each_agent_has_its_resolution(ready):
    config = configured(degrade__resolution=0.1, degrade__resolutions=[0.05])
    for agent, cell in zip(simulate(ready, config, 1, ONE_WALK).agents, (0.05, 0.1), strict=True):
        assert len(thinned(agent.points, cell)) == len(agent.points)
        assert len(thinned(agent.points, 2 * cell)) < len(agent.points)


def test_frames_have_any_yaw_and_keep_to_their_limits():
    rng = np.random.default_rng(0)
    config = DegradeConfig(frame_offset=3.0, frame_height=0.2)
    frames = np.array([random_frame(config, rng) for _ in range(300)])
    yaw = np.arctan2(frames[:, 1, 0], frames[:, 0, 0])
    assert yaw.min() < -2.9
    assert yaw.max() > 2.9
    assert (np.abs(frames[:, :3, 3]) <= [3.0, 3.0, 0.2]).all()
    np.testing.assert_allclose(frames[:, 2, :3], [[0.0, 0.0, 1.0]] * 300)


def test_a_camera_looks_ahead_within_its_field_of_view():
    config = CameraConfig(width=41, height=31, field_of_view=90.0)
    rays = camera_directions(config)
    across = np.degrees(np.arctan2(rays[:, 1], rays[:, 0]))
    assert across.min() == pytest.approx(-45.0)
    assert across.max() == pytest.approx(45.0)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=1), 1.0)


def test_a_camera_makes_a_map_on_the_surfaces_too(ready):
    config = configured(
        sensor__pattern="camera", sensor__camera__noise=0.0, sensor__camera__views=2
    )
    agent = simulate(ready, config, 1, ONE_WALK).agents[0]
    assert len(agent.poses) % 2 == 0
    assert ready.world.clearance(in_building(agent)).max() < 1e-3
    sensors = agent.poses[agent.scan_of_point][:, :3, 3]
    assert np.linalg.norm(agent.points - sensors, axis=1).max() <= 6.0 + 1e-3


def test_walks_lead_over_stairs():
    building = load_building("office:seed=1,rooms=6,storeys=2")
    lower, upper = (
        next(r.id for r in building.rooms if r.storey == s and "stair" not in r.kind)
        for s in (0, 1)
    )
    case = simulate(building, configured(agents=1), 1, [Walk(rooms=(lower, upper))])
    (agent,) = case.agents
    assert {building.rooms[room].storey for room in agent.rooms_walked} == {0, 1}
    assert np.ptp(agent.poses[:, 2, 3]) > 2.0


def test_walks_by_hand_visit_their_rooms_and_waypoints(ready):
    x, y, z = ready.walkable.places[ready.walkable.anchors[4]]
    stops = parse_walk(f"{x} {y} {z}; {x + 0.5} {y} {z}").waypoints
    walks = (Walk(rooms=(1, 4)), Walk(waypoints=stops))
    case = simulate(ready, configured(), 1, walks)
    assert case.agents[0].rooms_walked[0] == 1
    assert case.agents[0].rooms_walked[-1] == 4
    assert case.agents[1].rooms_walked == (4,)


def test_a_labelled_cloud_is_scanned_by_its_voxels(ready, building):
    seen = simulate(ready, configured(agents=1), 1, [Walk(rooms=tuple(ready.walkable.anchors))])
    agent = seen.agents[0]
    cloud = replace(
        building,
        vertices=np.zeros((0, 3)),
        faces=np.zeros((0, 3), np.int32),
        face_tag=None,
        points=in_building(agent),
        labels=agent.room,
    )
    config = configured(sensor__lidar__noise=0.0)
    case = simulate(cloud, config, 1, ONE_WALK)
    for again in case.agents:
        assert make_world(building).clearance(in_building(again)).max() < 0.05
        assert {1, 2} <= set(np.unique(again.room))
