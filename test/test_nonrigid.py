"""Non-rigid fusion: rooms of a drifted map move onto the other map's, and no map without drift."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from test import helpers_matching
from test.helpers_matching import A_ROOMS, B_ROOMS, T_A_B, T_BUILDING_A, T_BUILDING_B, agent_map
from topometric_ros.fusion.fuse import FuseConfig, fuse
from topometric_ros.fusion.nonrigid import NonRigidConfig, bends, gap
from topometric_ros.fusion.poses import apply
from topometric_ros.fusion.smooth_bend import net_of, smooth_states
from topometric_ros.fusion.surface import surface_of
from topometric_ros.topometric_map import TopometricMap

SHIFTS = {0: (0.0, 0.0, 0.0), 2: (0.0, 0.09, 0.0), 3: (0.08, 0.05, 0.0), 4: (-0.1, -0.06, 0.0)}
"""How far each room of the drifted map stands from its place, m, building frame."""


def drifted(monkeypatch: pytest.MonkeyPatch) -> TopometricMap:
    whole = helpers_matching.room_points
    monkeypatch.setattr(helpers_matching, "room_points", lambda n: whole(n) + SHIFTS[n])
    return agent_map("b", B_ROOMS, T_BUILDING_B, noise=0.005, seed=1)


def test_rooms_of_a_drifted_map_move_onto_the_others(monkeypatch: pytest.MonkeyPatch) -> None:
    a = agent_map("a", A_ROOMS, T_BUILDING_A, noise=0.005)
    b = drifted(monkeypatch)
    found = bends([(a, np.eye(4)), (b, T_A_B)], NonRigidConfig())
    assert found is not None
    surfaces = [surface_of(a), surface_of(b)]
    before = gap(surfaces, [surfaces[0].points, apply(T_A_B, surfaces[1].points)])
    after = gap(surfaces, [x.apply(s.points) for x, s in zip(found, surfaces, strict=True)])
    assert before > 0.03
    assert after < 0.5 * before
    config = dataclasses.replace(FuseConfig(), nonrigid=NonRigidConfig(enabled=True))
    thick = fuse([a, b], [np.eye(4), T_A_B], FuseConfig()).map
    thin = fuse([a, b], [np.eye(4), T_A_B], config).map
    assert len(thin.voxels) < 0.95 * len(thick.voxels)


def test_drift_within_a_room_is_bent_away(monkeypatch: pytest.MonkeyPatch) -> None:
    """A room that swells is no rigid part; the nodes of the smooth bend take it."""
    a = agent_map("a", (2,), T_BUILDING_A, noise=0.005)
    whole = helpers_matching.room_points

    def swollen(number: int) -> np.ndarray:
        points = whole(number)
        return points + 0.03 * (points - points.mean(axis=0)) * (1.0, 1.0, 0.0)

    monkeypatch.setattr(helpers_matching, "room_points", swollen)
    b = agent_map("b", (2,), T_BUILDING_B, noise=0.005, seed=1)
    nets = []
    for m, T in ((a, np.eye(4)), (b, T_A_B)):
        surface = surface_of(m)
        floor = apply(T, np.asarray(m.origin) + m.navigable * m.voxel_size)
        there, normals = apply(T, surface.points), surface.normals @ T[:3, :3].T
        nets.append(net_of(surface, there, normals, floor, 1.2))
    states = smooth_states(nets, drift=0.03, yaw_drift=np.radians(0.3))
    surfaces = [surface_of(a), surface_of(b)]
    before = gap(surfaces, [net.points for net in nets])
    bent = [net.moved(state) for net, state in zip(nets, states, strict=True)]
    assert before > 0.03
    assert gap(surfaces, bent) < 0.5 * before
    # A point of its own goes as the surface next to it.
    carried = nets[1].carried(nets[1].points[:5], states[1])
    np.testing.assert_allclose(carried, bent[1][:5], atol=1e-12)


def test_maps_without_drift_stay_as_they_are() -> None:
    a = agent_map("a", A_ROOMS, T_BUILDING_A, noise=0.01)
    b = agent_map("b", B_ROOMS, T_BUILDING_B, noise=0.01, seed=1)
    assert bends([(a, np.eye(4)), (b, T_A_B)], NonRigidConfig()) is None


def test_maps_that_share_no_room_are_not_bent() -> None:
    a = agent_map("a", (1,), T_BUILDING_A)
    b = agent_map("b", (5,), T_BUILDING_B)
    assert bends([(a, np.eye(4)), (b, T_A_B)], NonRigidConfig()) is None
    bare = agent_map("b", (5,), T_BUILDING_B, bare=True)
    assert bends([(a, np.eye(4)), (bare, T_A_B)], NonRigidConfig()) is None
