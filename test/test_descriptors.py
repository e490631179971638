"""Descriptors of rooms: alike for the same room wherever it stands, unlike for different ones."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from test.helpers import yaw_transform
from test.helpers_matching import A_ROOMS, T_BUILDING_A, agent_map
from topometric_ros.configuration import with_values
from topometric_ros.errors import ConfigurationError
from topometric_ros.matching import planes
from topometric_ros.matching.assignment import cost_matrix
from topometric_ros.matching.config import ContextConfig, DescriptorConfig, MatchingConfig
from topometric_ros.matching.context import embed_pair
from topometric_ros.matching.descriptors import (
    MERGED,
    EngineeredDescriptor,
    ShapeDescriptor,
    SpectralDescriptor,
    TopologicalDescriptor,
    describe,
    described,
)
from topometric_ros.matching.descriptors.engineered import FEATURES, bounding_sides
from topometric_ros.matching.descriptors.roughness import roughness
from topometric_ros.matching.descriptors.spectral import neighbourhood_graph
from topometric_ros.voxels.grid import in_morton_order


def box_shell(nx: int, ny: int, nz: int) -> np.ndarray:
    """Return the surface voxels of a box."""
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in (nx, ny, nz)), indexing="ij"), -1)
    grid = grid.reshape(-1, 3)
    shell = ((grid == 0) | (grid == np.array([nx, ny, nz]) - 1)).any(axis=1)
    return in_morton_order(grid[shell])


def test_planes_do_not_depend_on_how_many_are_fitted_at_a_time(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    points = np.random.default_rng(1).normal(size=(500, 3)) * (4.0, 3.0, 0.05)
    whole = planes.fit_planes(points, 10)
    monkeypatch.setattr(planes, "_AT_ONCE", 64)
    for one, other in zip(whole, planes.fit_planes(points, 10), strict=True):
        np.testing.assert_array_equal(one, other)
    assert np.median(np.abs(whole[0][:, 2])) > 0.99


def test_engineered_features_of_a_box_are_its_sizes() -> None:
    voxels = box_shell(41, 31, 26)
    values = dict(zip(FEATURES, EngineeredDescriptor().features(voxels, 0.1), strict=True))
    assert values["height"] == pytest.approx(2.5)
    assert values["horizontal_area"] == pytest.approx(12.0)
    assert values["volume"] == pytest.approx(30.0)
    assert values["surface"] == pytest.approx(len(voxels) * 0.01)
    assert values["verticality"] == pytest.approx(0.0, abs=1e-6)


@settings(max_examples=6)
@given(turns=st.integers(0, 3), x=st.integers(-500, 500), z=st.integers(-90, 90))
def test_engineered_features_do_not_change_with_quarter_turns_and_translation(
    turns: int, x: int, z: int
) -> None:
    rng = np.random.default_rng(turns)
    voxels = in_morton_order(np.concatenate([box_shell(16, 11, 8), rng.integers(0, 9, (60, 3))]))
    turn = np.rint(yaw_transform(turns * np.pi / 2, (0, 0, 0))[:3, :3]).astype(np.int32)
    moved = in_morton_order(voxels @ turn.T + (x, -x, z))
    features = EngineeredDescriptor().features
    np.testing.assert_allclose(features(moved, 0.1), features(voxels, 0.1), rtol=1e-5, atol=1e-6)


@given(yaw=st.floats(-3.1, 3.1), x=st.floats(-50, 50))
def test_the_smallest_rectangle_turns_with_the_room(yaw: float, x: float) -> None:
    points = box_shell(16, 11, 2)[:, :2] * 0.1
    T = yaw_transform(yaw, (x, -x, 0.0))
    sides = bounding_sides(points @ T[:2, :2].T + T[:2, 3], "oriented")
    assert sorted(sides) == pytest.approx([1.0, 1.5])


def test_roughness_is_the_mean_distance_to_planes_through_the_nearest_voxels() -> None:
    voxels = in_morton_order(np.random.default_rng(3).integers(0, 8, (150, 3)))
    expected = []
    for voxel in voxels:
        square = np.sort(((voxels - voxel) ** 2).sum(1))
        near = voxels[((voxels - voxel) ** 2).sum(1) <= min(square[11], 15)]
        centred = near - near.mean(0)
        normal = np.linalg.eigh(centred.T @ centred)[1][:, 0]
        expected.append(np.abs(centred @ normal).mean() * 12)
    assert roughness(voxels, 12) == pytest.approx(np.mean(expected), rel=1e-9)
    assert roughness(box_shell(9, 9, 1), 12) == 0.0


@pytest.mark.parametrize("names", [("engineered", "spectral"), ("shape",)])
def test_rooms_keep_their_descriptors_when_the_agent_stands_elsewhere(
    names: tuple[str, ...],
) -> None:
    """Voxels on another lattice change each number by less than rooms differ."""
    config = MatchingConfig(descriptors=DescriptorConfig(names=names))
    here = agent_map("a", A_ROOMS, T_BUILDING_A)
    there = agent_map("b", A_ROOMS, yaw_transform(2.2, (3, 1, 1.0)))
    cost = cost_matrix(*embed_pair(here, there, config))
    assert np.argmin(cost, axis=1).tolist() == list(range(len(A_ROOMS)))
    assert np.diag(cost).max() < 0.5 * np.median(cost)


def test_a_long_room_vibrates_lower_than_a_short_one() -> None:
    spectrum = SpectralDescriptor(eigenvalues=8).spectrum
    assert spectrum(box_shell(81, 21, 26), 0.1)[0] < 0.5 * spectrum(box_shell(41, 21, 26), 0.1)[0]


def test_laplacian_spectrum_is_that_of_the_dense_matrix() -> None:
    coords = box_shell(12, 9, 7)
    graph = neighbourhood_graph(coords, "von_neumann").toarray()
    laplacian = np.diag(graph.sum(axis=1)) - graph
    descriptor = SpectralDescriptor(eigenvalues=6, neighbourhood="von_neumann", cell=0.1)
    expected = np.linalg.eigvalsh(laplacian)[1:7] / 0.01
    np.testing.assert_allclose(descriptor.spectrum(coords, 0.1), expected, rtol=1e-4)


@pytest.mark.parametrize("shape", [(30, 24, 19), (60, 20, 25)])
def test_many_eigenvalues_of_a_large_room_are_those_of_the_dense_matrix(shape) -> None:
    coords = in_morton_order(box_shell(*shape) // 3)
    graph = neighbourhood_graph(coords, "moore").toarray()
    expected = np.linalg.eigvalsh(np.diag(graph.sum(axis=1)) - graph)[1:33] / 0.09
    found = SpectralDescriptor().spectrum(box_shell(*shape), 0.1)
    np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_adjacency_spectrum_is_the_singular_values() -> None:
    coords = box_shell(12, 9, 7)
    graph = neighbourhood_graph(coords, "von_neumann").toarray()
    descriptor = SpectralDescriptor(
        eigenvalues=6, matrix="adjacency", neighbourhood="von_neumann", cell=0.1
    )
    expected = np.linalg.svd(graph, compute_uv=False)[:6]
    np.testing.assert_allclose(descriptor.spectrum(coords, 0.1), expected, rtol=1e-4)


def test_shape_histograms_are_shares_of_pairs_and_of_heights() -> None:
    points = box_shell(41, 31, 26) * 0.1
    histograms = ShapeDescriptor().histograms(points)
    distances, heights = histograms[:21], histograms[21:]
    assert distances.sum() == pytest.approx(100.0)
    assert heights.sum() == pytest.approx(100.0)
    assert distances[11:].sum() == 0.0, "no two are farther apart than the diagonal of 5 m"
    floor = 41 * 31 + 2 * (2 * (40 + 30))  # and two rings of the walls below 0.25 m
    assert heights[0] == pytest.approx(100.0 * floor / len(points))


def test_half_a_room_keeps_more_of_its_shape_than_of_its_size() -> None:
    points = box_shell(81, 31, 26) * 0.1
    half = points[points[:, 0] < 5.0]
    shape = ShapeDescriptor().histograms
    other = shape(box_shell(31, 31, 40) * 0.1)
    assert np.abs(shape(half) - shape(points)).sum() < np.abs(other - shape(points)).sum()


def test_the_topological_descriptor_sees_the_graph_and_no_geometry() -> None:
    m = agent_map("a", A_ROOMS, T_BUILDING_A)
    values = TopologicalDescriptor()(m)
    corridor = A_ROOMS.index(0)
    assert values[corridor, 0] == len(A_ROOMS) - 1
    others = np.delete(values, corridor, axis=0)
    assert (others[:, 0] == 1).all()
    assert (others[:, 2] == len(A_ROOMS) - 1).all(), "their one neighbour is the corridor"
    assert (values[:, 6:] >= 0).all()
    assert values[corridor, 6:].sum() <= 360.0 + 1e-3


def test_a_room_of_one_voxel_has_descriptors_too() -> None:
    assert ShapeDescriptor().histograms(np.zeros((1, 3))).tolist() == [0.0] * 38
    assert SpectralDescriptor().spectrum(np.zeros((1, 3), np.int32), 0.1).tolist() == [0.0] * 32
    assert np.isfinite(EngineeredDescriptor().features(np.zeros((1, 3), np.int32), 0.1)).all()


def test_describing_twice_gives_the_same_bytes_and_is_not_repeated() -> None:
    config = MatchingConfig()
    plain = agent_map("a", (2, 4), T_BUILDING_A)
    once, twice = describe(plain, config), describe(plain, config)
    for one, two in zip(once.descriptors, twice.descriptors, strict=True):
        assert one.values.tobytes() == two.values.tobytes()
    assert described(once, config) is once
    other = DescriptorConfig(names=("engineered", "spectral"), eigenvalues=8)
    again = described(once, dataclasses.replace(config, descriptors=other))
    assert again.descriptors[1].values.shape == (2, 8)


def test_merged_context_describes_the_room_with_its_neighbours() -> None:
    config = MatchingConfig(
        descriptors=DescriptorConfig(names=("engineered",)), context=ContextConfig(kind="merged")
    )
    m = describe(agent_map("a", (0, 2), T_BUILDING_A), config)
    merged = m.descriptor("engineered" + MERGED)
    assert merged is not None
    np.testing.assert_allclose(merged.values[0], merged.values[1], rtol=1e-6)
    assert m.descriptors[0].values[0, 4] + m.descriptors[0].values[1, 4] == pytest.approx(
        merged.values[0, 4], rel=1e-5
    )


def test_an_unknown_descriptor_is_refused_by_name() -> None:
    for names in (["shape", "guessed"], []):
        with pytest.raises(ConfigurationError, match="out of engineered, spectral, shape,"):
            with_values(MatchingConfig(), {"descriptors.names": names})
