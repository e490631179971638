"""The trained networks: what they were trained for holds on rooms that they have not seen."""

from __future__ import annotations

import builtins
import importlib.util
import sys
from pathlib import Path

import numpy as np
import pytest

from test.helpers import yaw_transform
from test.helpers_matching import A_ROOMS, T_A_B, T_BUILDING_A, T_BUILDING_B, agent_map, error_of
from topometric_ros.errors import ConfigurationError
from topometric_ros.fusion.deep_closest_point import deep_closest_point, network_poses
from topometric_ros.fusion.registration_config import RegistrationConfig
from topometric_ros.fusion.surface import surface_of
from topometric_ros.matching import onnx_network as networks
from topometric_ros.matching.assignment import cost_matrix
from topometric_ros.matching.config import DescriptorConfig, MatchingConfig
from topometric_ros.matching.context import embed_pair
from topometric_ros.matching.descriptors import LearnedDescriptor, describe
from topometric_ros.matching.descriptors.learned import turned_copies, wall_direction

LEARNED = MatchingConfig(descriptors=DescriptorConfig(names=("learned",)))
needs_onnxruntime = pytest.mark.skipif(
    importlib.util.find_spec("onnxruntime") is None,
    reason="onnxruntime is not installed (extra learned)",
)


@pytest.fixture(scope="module")
def held_rooms():
    """Views of the rooms of a generated building whose seed nothing was trained on."""
    sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "training"))
    try:
        from room_views import room_views
    finally:
        sys.path.pop(0)
    return room_views(["home:seed=60001,rooms=6"], seed=1)


def voxels(points: np.ndarray, yaw: float) -> np.ndarray:
    """Return the cell centres of points that are turned."""
    moved = points @ yaw_transform(yaw, (0, 0, 0))[:3, :3].T
    return np.unique(np.round(moved / 0.1).astype(np.int64), axis=0) * 0.1


@needs_onnxruntime
def test_two_views_of_a_room_are_nearer_than_views_of_other_rooms(held_rooms):
    code = LearnedDescriptor().code
    one = np.array([code(voxels(views[0], 0.3)) for views in held_rooms.views])
    two = np.array([code(voxels(views[1], 2.0)) for views in held_rooms.views])
    cost = cost_matrix(one, two)
    own, other = np.diag(cost), cost[~np.eye(len(cost), dtype=bool)]
    assert len(cost) >= 6
    assert np.mean(own < np.median(other)) >= 0.8
    assert np.mean(np.argmin(cost, axis=1) == np.arange(len(cost))) >= 0.5
    assert own.mean() < 0.7 * other.mean()


@needs_onnxruntime
def test_the_code_knows_no_order_of_points_and_no_quarter_turn():
    points = np.random.default_rng(2).uniform((0, 0, 0), (5, 3, 2.5), (300, 3))
    turned = turned_copies(points).astype(np.float32)
    run = networks.onnx_network(
        Path(networks.__file__).parent / "descriptors" / "learned.onnx", "test"
    )
    codes = run({"points": turned})[0]
    mixed = run({"points": turned[::-1, np.random.default_rng(3).permutation(300)]})[0]
    np.testing.assert_allclose(mixed[::-1], codes, atol=1e-5)
    code = LearnedDescriptor().code(points)
    np.testing.assert_allclose(code, codes.mean(axis=0), atol=1e-5)
    assert code.tobytes() == LearnedDescriptor().code(points).tobytes()


@needs_onnxruntime
def test_rooms_keep_their_codes_when_the_agent_stands_elsewhere():
    here = agent_map("a", A_ROOMS, T_BUILDING_A)
    there = agent_map("b", A_ROOMS, yaw_transform(2.2, (3, 1, 1.0)))
    cost = cost_matrix(*embed_pair(here, there, LEARNED))
    assert np.argmin(cost, axis=1).tolist() == list(range(len(A_ROOMS)))
    entry = describe(here, LEARNED).descriptor("learned")
    assert entry is not None
    assert entry.values.shape == (len(A_ROOMS), LearnedDescriptor().dimension)


@pytest.mark.parametrize("yaw", [0.0, 0.4, 1.2])
def test_the_direction_of_a_room_is_that_of_its_walls(held_rooms, yaw: float):
    for views in held_rooms.views:
        off = (wall_direction(voxels(views[0], yaw)) - yaw) % (np.pi / 2)
        assert min(off, np.pi / 2 - off) < np.radians(4.0)


@needs_onnxruntime
def test_deep_closest_point_reaches_farther_than_the_gates_of_icp():
    a = surface_of(agent_map("a", (2,), T_BUILDING_A))
    b = surface_of(agent_map("b", (2,), T_BUILDING_B))
    turn = yaw_transform(np.radians(20.0), (0.5, -0.4, 0.1))
    middle = np.eye(4)
    middle[:3, 3] = b.points.mean(axis=0)
    wrong = T_A_B @ middle @ turn @ np.linalg.inv(middle)
    config = RegistrationConfig()
    coarse = network_poses(b, a, wrong, config)[-1]
    assert error_of(coarse, T_A_B, b.points)[0] < 0.4 * error_of(wrong, T_A_B, b.points)[0]
    np.testing.assert_allclose(coarse[2, :3], [0, 0, 1], atol=1e-12)
    found = deep_closest_point(b, a, wrong, config)
    assert error_of(found.T_target_source, T_A_B, b.points)[0] < 0.05


def test_without_onnxruntime_one_line_says_what_to_install(monkeypatch: pytest.MonkeyPatch):
    real = builtins.__import__

    def without(name: str, *args, **kwargs):  # type: ignore[no-untyped-def]
        if name == "onnxruntime":
            raise ImportError(name)
        return real(name, *args, **kwargs)

    monkeypatch.setattr(builtins, "__import__", without)
    networks.onnx_network.cache_clear()
    with pytest.raises(ConfigurationError, match=r"pip install 'topometric_ros\[learned\]'"):
        describe(agent_map("a", (2,), T_BUILDING_A), LEARNED)
