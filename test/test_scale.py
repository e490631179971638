"""Maps of unlike resolution meet at the coarser one; maps of unlike scale are told apart."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from test.helpers_matching import A_ROOMS, B_ROOMS, T_A_B, T_BUILDING_A, T_BUILDING_B, agent_map
from topometric_ros.alignment import AlignmentStatus
from topometric_ros.fusion.align import align
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.fusion.registration import RegistrationConfig
from topometric_ros.fusion.resolution import coarsened
from topometric_ros.fusion.scale import stretch, unlike_scale
from topometric_ros.fusion.surface import Surface, surface_of
from topometric_ros.topometric_map import TopometricMap


def larger(m: TopometricMap, factor: float) -> TopometricMap:
    """Return a map as an agent would make it that measures too long: all lengths grown."""
    storeys = tuple(
        dataclasses.replace(
            s,
            floor_z=s.floor_z * factor,
            ceiling_z=None if s.ceiling_z is None else s.ceiling_z * factor,
        )
        for s in m.storeys
    )
    passages = tuple(dataclasses.replace(p, height=2.0 * factor, kind="door") for p in m.passages)
    x, y, z = (value * factor for value in m.origin)
    return dataclasses.replace(
        m,
        voxel_size=m.voxel_size * factor,
        origin=(x, y, z),
        storeys=storeys,
        passages=passages,
    )


def test_a_coarsened_map_holds_the_same_surface_in_fewer_voxels() -> None:
    fine = agent_map("a", A_ROOMS, T_BUILDING_A)
    coarse = coarsened(fine, 0.2)
    assert coarse.voxel_size == 0.2
    assert len(coarse.voxels) < len(fine.voxels) / 2
    assert sum(r.voxels for r in coarse.rooms) == np.count_nonzero(coarse.room >= 0)
    assert [r.id for r in coarse.rooms] == [r.id for r in fine.rooms]
    low, high = fine.surface().min(axis=0), fine.surface().max(axis=0)
    assert np.all(coarse.surface() > low - 0.1)
    assert np.all(coarse.surface() < high + 0.1)
    assert coarsened(fine, 0.1) is fine


def test_a_map_is_coarsened_once_however_many_it_is_aligned_with() -> None:
    config = MergeConfig()
    fine = Prepared(agent_map("a", A_ROOMS, T_BUILDING_A), config.search.scoring, config.matching)
    assert fine.at(0.2) is fine.at(0.2)
    assert fine.at(0.1) is fine


@pytest.mark.parametrize("factor", [1.0, 1.06, 0.95])
def test_registration_tells_by_how_much_one_map_is_larger(factor: float) -> None:
    a = Prepared(agent_map("a", A_ROOMS, T_BUILDING_A, noise=0.01), *_parts())
    b = surface_of(agent_map("b", B_ROOMS, T_BUILDING_B, noise=0.01, seed=1))
    small = Surface(b.points / factor, b.normals, b.sided, b.spacing)
    T = T_A_B.copy()
    middle = b.points.mean(axis=0)
    T[:3, 3] += T[:3, :3] @ (middle - middle / factor)
    found, spread = stretch(small, a.surface, T, RegistrationConfig(), a.tree)
    assert found == pytest.approx(factor, abs=0.005)
    assert spread < 0.01


def test_a_pair_that_fits_but_for_its_size_is_refused_with_the_factor() -> None:
    a = agent_map("a", A_ROOMS, T_BUILDING_A, noise=0.01)
    b = agent_map("b", B_ROOMS, T_BUILDING_B, noise=0.01, seed=1)
    found = align(a, larger(b, 1.05), MergeConfig())
    assert found.status is not AlignmentStatus.ACCEPTED


def test_a_cloud_in_feet_is_told_by_its_storeys_and_doors() -> None:
    a = larger(agent_map("a", A_ROOMS, T_BUILDING_A), 1.0)
    b = larger(agent_map("b", B_ROOMS, T_BUILDING_B), 1 / 0.3048)
    told = unlike_scale(a, b)
    assert told is not None
    assert "b seems to be in feet; use --scale 0.3048" in told
    assert unlike_scale(b, a) is not None
    assert "b seems to be in feet" in str(unlike_scale(b, a))
    assert unlike_scale(a, a) is None


def test_a_hall_beside_an_office_is_no_other_scale() -> None:
    a = larger(agent_map("a", A_ROOMS, T_BUILDING_A), 1.0)
    b = larger(agent_map("b", B_ROOMS, T_BUILDING_B), 1 / 0.3048)
    doors = tuple(dataclasses.replace(p, height=2.1) for p in b.passages)
    assert unlike_scale(a, dataclasses.replace(b, passages=doors)) is None


def _parts():  # type: ignore[no-untyped-def]
    config = MergeConfig()
    return config.search.scoring, config.matching
