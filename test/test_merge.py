"""From agents' maps to one global map: aligning, grouping, fusing, refusing."""

from __future__ import annotations

import dataclasses
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from test.helpers import SHARED_DATA, needs_shared_data, yaw_transform
from test.helpers_matching import (
    A_ROOMS,
    B_ROOMS,
    C_ROOMS,
    T_A_B,
    T_BUILDING_A,
    T_BUILDING_B,
    T_BUILDING_C,
    agent_map,
    error_of,
    room_points,
)
from topometric_ros.alignment import AgentStatus, Alignment, AlignmentStatus, MergeResult
from topometric_ros.errors import ConfigurationError
from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.fusion.align import align
from topometric_ros.fusion.config import merge_preset
from topometric_ros.fusion.fuse import FuseConfig, fuse
from topometric_ros.fusion.merge import MergeError, merge, reversed_alignment
from topometric_ros.fusion.poses import apply, inverse, level_frames
from topometric_ros.matching.descriptors import describe
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.topometric_map import NO_ROOM, TopometricMap
from topometric_ros.voxels.grid import lattice_coordinates
from topometric_ros.voxels.morton import morton_encode

DEFAULT = merge_preset("default")


@cache
def maps() -> tuple[TopometricMap, TopometricMap, TopometricMap]:
    """Return three agents' maps of one floor."""
    plain = (
        agent_map("a", A_ROOMS, T_BUILDING_A, noise=0.01),
        agent_map("b", B_ROOMS, T_BUILDING_B, noise=0.01, seed=1),
        agent_map("c", C_ROOMS, T_BUILDING_C, noise=0.01, seed=2),
    )
    a, b, c = (describe(m, DEFAULT.matching) for m in plain)
    return a, b, c


@cache
def merged() -> MergeResult:
    """Return the merge of the three."""
    return merge(maps(), DEFAULT)


def test_three_agents_become_one_map() -> None:
    result = merged()
    assert [x.agents for x in result.alignments] == [("a", "b"), ("a", "c"), ("b", "c")]
    assert all(x.accepted for x in result.alignments)
    statuses = [place.status for place in result.agents]
    assert statuses == [AgentStatus.ANCHOR, AgentStatus.ALIGNED, AgentStatus.ALIGNED]
    places = (T_BUILDING_A, T_BUILDING_B, T_BUILDING_C)
    for place, m, T in zip(result.agents, maps(), places, strict=True):
        assert place.T_global_agent is not None
        shift, turn = error_of(place.T_global_agent, inverse(T_BUILDING_A) @ T, m.centres())
        assert shift < 0.005
        assert turn < 0.05


def test_the_global_graph_has_each_room_once() -> None:
    fused = merged().global_map.map
    assert [room.id for room in fused.rooms] == [0, 1, 2, 4, 10003, 20005]
    assert {passage.rooms for passage in fused.passages} == {
        (0, i) for i in (1, 2, 4, 10003, 20005)
    }
    assert len(fused.passages) == 5
    assert not any(room.isolated for room in fused.rooms)
    assert len(fused.storeys) == 1
    assert len(fused.viewpoints) == 12
    assert fused.frame_id == "global"


def test_a_new_snapshot_of_any_agent_is_a_new_version_of_the_global_map() -> None:
    a, b, c = maps()
    poses = [place.T_global_agent for place in merged().agents]

    def version(*members: TopometricMap) -> tuple[str, int]:
        fused = fuse(members, poses[: len(members)], FuseConfig()).map
        return fused.session, fused.sequence

    before = version(a, b)
    later = version(a, replace(b, sequence=b.sequence + 1))
    assert later[0] == before[0]
    assert later[1] == before[1] + 1
    assert version(a, replace(b, session="restarted"))[0] != before[0]
    assert version(a, b, c)[0] != before[0]


def test_an_accepted_alignment_carries_its_evidence() -> None:
    alignment = merged().alignments[0]
    assert {(m.room_a, m.room_b) for m in alignment.matches} == {(0, 0), (2, 2), (4, 4)}
    assert 0.75 < alignment.overlap < 0.9
    assert alignment.confidence > 0.5
    assert alignment.rmse < 0.02
    assert alignment.covariance is not None
    assert np.linalg.eigvalsh(alignment.covariance).min() > 0


def test_aligning_in_the_other_order_gives_the_inverse() -> None:
    a, b, _ = maps()
    forward, back = merged().alignments[0], align(b, a, DEFAULT)
    assert forward.T_a_b is not None
    assert back.T_a_b is not None
    shift, turn = error_of(inverse(back.T_a_b), forward.T_a_b, b.centres())
    assert shift < 0.01
    assert turn < 0.1
    assert {(m.room_b, m.room_a) for m in back.matches} == {
        (m.room_a, m.room_b) for m in forward.matches
    }


def test_a_reversed_alignment_twice_is_itself() -> None:
    alignment = merged().alignments[0]
    twice = reversed_alignment(reversed_alignment(alignment))
    assert twice.agents == alignment.agents
    np.testing.assert_allclose(twice.T_a_b, alignment.T_a_b, atol=1e-12)
    np.testing.assert_allclose(twice.covariance, alignment.covariance, rtol=1e-6, atol=1e-15)
    assert twice.matches == alignment.matches


def test_the_same_maps_give_the_same_bytes() -> None:
    a, b, _ = maps()
    one, two = align(a, b, DEFAULT), merged().alignments[0]
    assert one.T_a_b is not None
    assert two.T_a_b is not None
    assert one.T_a_b.tobytes() == two.T_a_b.tobytes()
    assert one.reason == two.reason


def test_transforms_hold_between_input_frames() -> None:
    """An agent whose cloud lies on its side is aligned in the frame that its cloud uses."""
    a, b, _ = maps()
    side = np.eye(4)
    side[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    side[:3, 3] = (0.5, -2.0, 0.1)
    result = merge([dataclasses.replace(a, T_level_input=side), b], DEFAULT)
    T = result.alignments[0].T_a_b
    assert T is not None
    np.testing.assert_allclose(level_frames(T, side, np.eye(4)), merged().alignments[0].T_a_b)
    np.testing.assert_array_equal(result.global_map.map.T_level_input, side)


def test_tilted_clouds_are_levelled_and_aligned_in_their_own_frames() -> None:
    rng = np.random.default_rng(0)
    tilted, clouds = [], []
    for rooms, T, angle, axis in (
        (A_ROOMS, T_BUILDING_A, 4.0, (1.0, 0.5, 0.0)),
        (B_ROOMS, T_BUILDING_B, 1.4, (-0.2, 1.0, 0.0)),
    ):
        R = Rotation.from_rotvec(np.radians(angle) * np.array(axis) / np.linalg.norm(axis))
        T_tilted_agent = np.eye(4)
        T_tilted_agent[:3, :3] = R.as_matrix()
        tilted.append(T_tilted_agent @ inverse(T))
        points = np.concatenate([room_points(number) for number in rooms])
        clouds.append(apply(tilted[-1], points + rng.normal(0, 0.01, points.shape)))
    found = [
        extract_map(cloud, ExtractionConfig(), DEFAULT.matching, agent=name).map
        for name, cloud in zip("ab", clouds, strict=True)
    ]
    T_a_b = merge(found, DEFAULT).alignments[0].T_a_b
    assert T_a_b is not None
    shift, turn = error_of(T_a_b, tilted[0] @ inverse(tilted[1]), clouds[1])
    assert shift < 0.03
    assert turn < 0.1


@pytest.mark.parametrize("source", ["rooms", "search"])
def test_either_source_of_candidates_is_enough(source: str) -> None:
    a, b, _ = maps()
    alignment = align(a, b, dataclasses.replace(DEFAULT, sources=(source,)))
    assert alignment.T_a_b is not None
    assert error_of(alignment.T_a_b, T_A_B, b.centres())[0] < 0.01


def test_rooms_seen_by_one_agent_only_give_no_transform() -> None:
    one = agent_map("a", (1, 2), T_BUILDING_A)
    other = agent_map("b", (4,), T_BUILDING_B)
    result = merge([one, other], DEFAULT)
    alignment = result.alignments[0]
    assert not alignment.accepted
    assert alignment.T_a_b is None
    assert alignment.reason
    assert result.agents[1].status is AgentStatus.UNALIGNED
    assert result.agents[1].T_global_agent is None
    assert result.agents[1].group == 1
    assert set(result.global_map.agents.tolist()) == {1}


def test_the_thesis_preset_refuses_what_the_gates_refuse() -> None:
    a, b, _ = maps()
    alignment = align(a, b, merge_preset("thesis"))
    if alignment.T_a_b is not None:
        assert error_of(alignment.T_a_b, T_A_B, b.centres())[0] < 0.5
    believed = align(a, b, dataclasses.replace(merge_preset("thesis"), check="none"))
    assert believed.accepted
    assert "not verified" in believed.reason


def test_maps_of_nothing_are_an_answer() -> None:
    a, _, _ = maps()
    nothing = dataclasses.replace(
        agent_map("b", (2,), T_BUILDING_B, bare=True),
        voxels=np.zeros((0, 3), np.int32),
        offsets=np.zeros((0, 3), np.int8),
        room=np.zeros(0, np.int32),
    )
    result = merge([a, nothing], DEFAULT)
    assert result.alignments[0].status is AlignmentStatus.NONE
    assert "'b' is empty" in result.alignments[0].reason
    assert len(merge([nothing], DEFAULT).global_map.agents) == 0


def test_a_map_without_storeys_is_refused_in_words() -> None:
    a, _, _ = maps()
    alignment = align(a, agent_map("b", (2,), T_BUILDING_B, bare=True), DEFAULT)
    assert alignment.status is AlignmentStatus.NONE
    assert "floor" in alignment.reason


def test_agents_of_one_name_and_too_many_agents_are_refused() -> None:
    a, b, _ = maps()
    with pytest.raises(MergeError, match="'a' appears 2 times"):
        merge([a, dataclasses.replace(b, agent="a")], DEFAULT)
    with pytest.raises(MergeError, match="33 agents"):
        merge([dataclasses.replace(a, agent=f"r{i}") for i in range(33)], DEFAULT)
    with pytest.raises(MergeError, match="no maps"):
        merge([], DEFAULT)
    with pytest.raises(ConfigurationError, match="sources"):
        merge([a, b], dataclasses.replace(DEFAULT, sources=("guess",)))


def test_known_alignments_are_kept_and_fixed_ones_believed() -> None:
    known = {x.agents: x for x in merged().alignments}
    by_hand = Alignment(
        ("b", "a"), AlignmentStatus.ACCEPTED, "set by hand", T_a_b=np.eye(4), confidence=1.0
    )
    result = merge(maps()[:2], DEFAULT, known=known, fixed={("b", "a"): by_hand})
    assert result.alignments[0].reason == "set by hand"
    np.testing.assert_array_equal(result.agents[1].T_global_agent, np.eye(4))
    kept = merge(maps()[:2], DEFAULT, known=known)
    assert kept.alignments[0] is known["a", "b"]


def test_global_voxels_are_the_union_and_say_who_saw_them() -> None:
    a, b, _ = maps()
    T = inverse(T_BUILDING_A) @ T_BUILDING_B
    result = fuse([a, b], [np.eye(4), T], FuseConfig())
    codes = morton_encode(result.map.voxels)
    of_a = morton_encode(a.voxels)
    moved = lattice_coordinates(apply(T, b.surface()), 0.1, np.array(a.origin))
    of_b = np.unique(morton_encode(moved))
    np.testing.assert_array_equal(codes, np.union1d(of_a, of_b))
    np.testing.assert_array_equal((result.agents & 1) > 0, np.isin(codes, of_a))
    np.testing.assert_array_equal((result.agents & 2) > 0, np.isin(codes, of_b))
    assert (np.diff(codes.astype(np.int64)) > 0).all()


def test_fusing_one_map_changes_nothing_but_its_name() -> None:
    a, _, _ = maps()
    fused = fuse([a], [np.eye(4)], FuseConfig()).map
    for name in ("voxels", "offsets", "room", "navigable", "viewpoints"):
        np.testing.assert_array_equal(getattr(fused, name), getattr(a, name))
    assert [room.id for room in fused.rooms] == [room.id for room in a.rooms]
    for own, before in zip(fused.rooms, a.rooms, strict=True):
        np.testing.assert_allclose(own.bounds, before.bounds, atol=1e-9)
    assert {p.rooms for p in fused.passages} == {p.rooms for p in a.passages}
    np.testing.assert_array_equal(fused.storeys[0].layers.free, a.storeys[0].layers.free)


def test_a_room_cut_in_two_by_one_agent_is_one_room() -> None:
    a, b, _ = maps()
    where = b.room == 0
    half = b.centres()[:, 0] > np.median(b.centres()[where, 0])
    room = np.where(where & half, 7, b.room).astype(np.int32)
    extra = dataclasses.replace(b.room_by_id(0), id=7)
    cut = dataclasses.replace(b, room=room, rooms=(*b.rooms, extra), descriptors=())
    fused = fuse([a, cut], [np.eye(4), T_A_B], FuseConfig())
    assert [r.id for r in fused.map.rooms] == [0, 1, 2, 4, 10003]
    assert set(fused.rooms_of) == {0, 1, 2, 4, 10003}
    assert fused.rooms_of[0] == ((0, 0), (1, 0), (1, 7))
    assert fused.rooms_of[10003] == ((1, 3),)


def test_maps_of_different_voxel_size_meet_at_the_coarser() -> None:
    a, _, _ = maps()
    coarse = agent_map("b", B_ROOMS, T_BUILDING_B, voxel_size=0.2)
    result = merge([a, coarse], DEFAULT)
    T = result.alignments[0].T_a_b
    assert T is not None
    assert error_of(T, T_A_B, coarse.centres())[0] < 0.03
    assert result.global_map.map.voxel_size == 0.2
    assert result.global_map.map.origin == a.origin
    assert any("voxel sizes differ" in warning for warning in result.warnings)


def test_agents_in_another_group_stay_out_of_the_global_map() -> None:
    a, b, _ = maps()
    fused = fuse([a, b], [np.eye(4), None], FuseConfig())
    assert set(fused.agents.tolist()) == {1}
    assert (fused.map.room != NO_ROOM).any()


def test_storeys_of_one_height_are_one_and_others_are_kept() -> None:
    a, b, _ = maps()
    upstairs = yaw_transform(0.0, (0.0, 0.0, 3.0)) @ T_A_B
    fused = fuse([a, b], [np.eye(4), upstairs], FuseConfig()).map
    assert [storey.id for storey in fused.storeys] == [0, 1]
    assert fused.storeys[1].floor_z - fused.storeys[0].floor_z == pytest.approx(3.0, abs=1e-6)
    assert {room.storey for room in fused.rooms} == {0, 1}


@needs_shared_data
def test_two_agents_of_a_real_plan_align_to_a_centimetre() -> None:
    import json

    from topometric_ros.extraction.config import extraction_preset
    from topometric_ros.extraction.pipeline import extract
    from topometric_ros.io.clouds import read_cloud

    folder = SHARED_DATA / "pairs" / "lab_ipa_100"
    a, b = (
        extract(read_cloud(folder / f"{x}.ply").points, extraction_preset("default"), agent=x).map
        for x in "ab"
    )
    truth = np.array(json.loads((folder / "truth.json").read_text())["a_from_b"])
    alignment = align(a, b, DEFAULT)
    assert alignment.T_a_b is not None
    shift, turn = error_of(alignment.T_a_b, truth, apply(inverse(b.T_level_input), b.surface()))
    assert shift < 0.01
    assert turn < 0.1
