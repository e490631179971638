"""Scans leave walls and poles standing and no ghosts of who walked through them."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from topometric_ros.voxels import scan_kernels
from topometric_ros.voxels.grid import thin
from topometric_ros.voxels.morton import morton_encode
from topometric_ros.voxels.raycast import traversed
from topometric_ros.voxels.scan_grid import ScanConfig, ScanGrid

CELL = 0.05
ROOM = (np.array([0.0, 0.0, 0.0]), np.array([8.0, 5.0, 2.6]))
POLE = (np.array([4.0, 1.5, 0.0]), np.array([4.03, 1.53, 1.8]))


def directions() -> np.ndarray:
    elevation, azimuth = np.meshgrid(
        np.radians(np.linspace(-45, 45, 48)), np.radians(np.arange(0, 360, 0.9)), indexing="ij"
    )
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    return np.stack([x, y, np.sin(elevation)], axis=-1).reshape(-1, 3)


def ranges(origin: np.ndarray, rays: np.ndarray, box: tuple[np.ndarray, np.ndarray]) -> np.ndarray:
    """Return where rays enter a box from outside, or leave it from inside; inf where neither."""
    with np.errstate(divide="ignore"):
        ends = np.sort(np.stack([(box[0] - origin) / rays, (box[1] - origin) / rays]), axis=0)
    enter, leave = ends[0].max(axis=1), ends[1].min(axis=1)
    return np.where(leave < np.maximum(enter, 0.0), np.inf, np.where(enter > 0, enter, leave))


def walk(person: bool, noise: float = 0.01) -> Iterator[tuple[np.ndarray, np.ndarray]]:
    """Yield (sensor, points) of scans along a room; the person crosses it in front of the robot."""
    rng = np.random.default_rng(0)
    rays = directions()
    for k, x in enumerate(np.linspace(1.0, 6.8, 24)):
        sensor = np.array([x, 2.5 + 0.5 * np.sin(k), 1.1])
        hit = np.minimum(ranges(sensor, rays, ROOM), ranges(sensor, rays, POLE))
        middle = np.array([5.0, 0.6 + 0.3 * k, 0.0])
        if person and middle[1] < 4.4:
            size = np.array([0.25, 0.25, 1.75])
            low, high = middle - size * (1, 1, 0), middle + size
            hit = np.minimum(hit, ranges(sensor, rays, (low, high)))
        yield sensor, sensor + rays * (hit + rng.normal(0.0, noise, len(hit)))[:, None]


def gathered(person: bool, carve: bool = True) -> ScanGrid:
    grid = ScanGrid(CELL, np.zeros(3), ScanConfig(carve=carve))
    for sensor, points in walk(person):
        grid.add(points, sensor)
    return grid


def voxels(points: np.ndarray) -> np.ndarray:
    return np.unique(morton_encode(np.floor(points / 0.1 + 0.5).astype(np.int64)))


def test_a_person_who_walked_through_leaves_no_ghost_and_the_walls_stand() -> None:
    empty = voxels(gathered(person=False, carve=False).points())
    plain = voxels(gathered(person=True, carve=False).points())
    carved = voxels(gathered(person=True).points())
    ghosts = np.setdiff1d(plain, empty)
    still = np.intersect1d(plain, empty)
    assert len(ghosts) > 1500
    assert np.isin(ghosts, carved).sum() < 0.03 * len(ghosts)
    assert 1 - np.isin(still, carved).mean() < 0.01


def test_a_thin_pole_stands() -> None:
    inside = np.linspace(POLE[0] + 0.015, POLE[1] - 0.015, 17)
    column = voxels(inside)
    plain, carved = (voxels(gathered(False, carve).points()) for carve in (False, True))
    assert np.isin(column, plain).sum() >= 15
    assert np.isin(column, carved).sum() >= np.isin(column, plain).sum() - 1


def test_points_in_any_batches_give_the_means_of_cells() -> None:
    points = np.random.default_rng(0).normal(size=(6000, 3))
    whole, parts = (ScanGrid(0.3, np.zeros(3), ScanConfig()) for _ in range(2))
    whole.add(points)
    for part in np.array_split(points, 7):
        parts.add(part)
        parts.points()
    np.testing.assert_array_equal(whole.points(), parts.points())
    found, wanted = (p[np.lexsort(p.T)] for p in (whole.points(), thin(points, 0.3)))
    np.testing.assert_allclose(found, wanted, atol=1e-6)


@pytest.mark.parametrize("seed", range(3))
def test_rays_look_through_the_cells_that_they_enter_and_no_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    grid = ScanGrid(0.1, np.zeros(3), ScanConfig(core=0.1, margin=0.0, reach=30.0))
    points = rng.uniform(-1.5, 1.5, (20_000, 3))
    grid.add(points)
    sensor, ends = rng.uniform(-2.5, -2.0, 3), rng.uniform(2.0, 3.0, (100, 3))
    grid.add(ends, sensor)
    every = np.unique(np.floor(points / 0.1 + 0.5).astype(np.int64), axis=0)
    entered = np.concatenate([traversed(sensor / 0.1, end / 0.1) for end in ends])
    entered = {tuple(c) for c in entered} - {tuple(c) for c in np.floor(ends / 0.1 + 0.5)}
    missed = grid._evidence[: grid.cells, scan_kernels.MISSES].sum()
    # A core of 0.1 m reaches all of a cell but its corners, where a mean seldom lies.
    wanted = len(entered & {tuple(c) for c in every})
    assert wanted > 100
    assert 0.95 * wanted <= missed <= wanted


def test_counts_keep_their_ratio_and_the_change_is_what_came_or_went() -> None:
    grid = ScanGrid(CELL, np.zeros(3), ScanConfig(least=2, ratio=0.5))
    wall = np.array([[1.0, 0.02 * k, 0.0] for k in range(50)])
    for _ in range(300):
        grid.add(wall, np.array([-1.0, 0.5, 0.0]))
    assert grid.change() == 1.0
    before = len(grid.points())
    assert (len(grid.points()), grid.change()) == (before, 0.0)
    for _ in range(250):
        grid.add(wall * (3.0, 3.0, 1.0), np.zeros(3))
    assert 0.2 < grid.change() <= 1.0
    assert (grid.points()[:, 0] > 2.5).all()
    assert grid.add(np.full((3, 3), 1e9)) == 3
