"""What scan mode costs and what it leaves: ghosts, walls, memory, and updates against extractions.

    python scripts/benchmark_scans.py [--spacing 0.4] [--every 20] [--seed 0]

One agent walks through all rooms of the simulated office with a lidar of 32 rings of 1,024 rays
(45° up and down, 20 m, 15 mm noise) and thin poles (3 cm, 0.9 m high) beside its way, four times:
alone, with a person who walks to and fro, with one who walks 1.5 m ahead, and with one who
follows 1.2 m behind. Counts are of 0.1 m voxels against the same scans gathered without carving:
ghosts hold returns of the person alone, poles are the voxels on their axes. Then the walk is
extracted every so many scans, once as the session does and once anew; the maps must be the same
bytes. Times are CPU ms of one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")  # CPU seconds are of one thread.

import argparse
import importlib
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.io.map_files import save_map
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.runtime.extractor_session import ExtractorSession
from topometric_ros.simulation.agents import WalkConfig, path_through, sensor_poses, translation
from topometric_ros.simulation.office import office
from topometric_ros.simulation.scanner import LidarConfig, ray_directions
from topometric_ros.voxels.grid import lattice_coordinates
from topometric_ros.voxels.morton import morton_encode
from topometric_ros.voxels.scan_grid import ScanConfig, ScanGrid

Floats = NDArray[np.float64]
ROOMS = (1, 8, 2, 9, 3, 10, 7, 6, 5, 4)
LIDAR = LidarConfig(
    rings=32, azimuths=1024, lowest=-45.0, highest=45.0, maximum_range=20.0, noise=0.015, step=0.0
)
WALL, POLE, PERSON = 1, 2, 3


o3d: Any = importlib.import_module("open3d")


class Walk:
    """Scans of the walk: the sensor, the points, and what each point lies on."""

    def __init__(self, spacing: float, seed: int) -> None:
        rng = np.random.default_rng(seed)
        building = office()
        self.spacing = spacing
        path = path_through(building, ROOMS)
        self.poses = sensor_poses(path, WalkConfig(spacing=spacing), rng)
        self._rays = ray_directions(LIDAR)
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        vertices, triangles = building.mesh()
        self._scene.add_triangles(o3d.core.Tensor(vertices), o3d.core.Tensor(triangles))
        self.axes: list[Floats] = []
        self._poles = [self._pole(pose, rng) for pose in self.poses[:: len(self.poses) // 15]]

    def _pole(self, pose: Floats, rng: np.random.Generator) -> int:
        angle = rng.uniform(0.0, 2 * np.pi)
        x, y = pose[:2, 3] + 0.8 * np.array([np.cos(angle), np.sin(angle)])
        heights = np.linspace(0.15, 0.85, 15)
        self.axes.append(
            np.stack([0 * heights + x, 0 * heights + y, heights], 1) + [0.015, 0.015, 0]
        )
        mesh = o3d.geometry.TriangleMesh.create_box(0.03, 0.03, 0.9).translate((x, y, 0.0))
        return int(self._scene.add_triangles(o3d.t.geometry.TriangleMesh.from_legacy(mesh)))

    def scans(self, place: Callable[[int], Floats | None]) -> Iterator[tuple[Floats, Any, Any]]:
        rng = np.random.default_rng(3)
        for k, pose in enumerate(self.poses):
            lidar = pose @ translation(0.0, 0.0, 1.1)
            sensor, rays = lidar[:3, 3], self._rays @ lidar[:3, :3].T
            both = np.concatenate([np.broadcast_to(sensor, rays.shape), rays], 1)
            found = self._scene.cast_rays(o3d.core.Tensor(both.astype(np.float32)), nthreads=1)
            reach = found["t_hit"].numpy().astype(float)
            on = np.where(np.isin(found["geometry_ids"].numpy(), self._poles), POLE, WALL)
            middle = place(k)
            if middle is not None:
                to_person = box_ranges(sensor, rays, middle + [-0.25, -0.25, 0.0])
                on = np.where(to_person < reach, PERSON, on)
                reach = np.minimum(reach, to_person)
            reach = reach + rng.normal(0.0, LIDAR.noise, len(reach))
            kept = (reach > LIDAR.minimum_range) & (reach < LIDAR.maximum_range)
            yield sensor, sensor + rays[kept] * reach[kept, None], on[kept]

    def places(self) -> dict[str, Callable[[int], Floats | None]]:
        """Return where the person is at each scan: a point on the floor, None for nowhere."""
        way = [pose[:3, 3] * (1, 1, 0) for pose in self.poses]

        def beside(k: int, at: int) -> Floats | None:
            inside = 0 <= at < len(way) and np.linalg.norm(way[at] - way[k]) > 0.5
            return way[at] if inside else None

        ahead, behind = round(1.5 / self.spacing), round(1.2 / self.spacing)
        turn = len(way) - 1
        return {
            "nobody": lambda k: None,
            "to and fro": lambda k: beside(k, int(turn * (1 + np.sin(k * self.spacing / 5)) / 2)),
            "ahead": lambda k: beside(k, k + ahead),
            "following": lambda k: beside(k, k - behind),
        }


def box_ranges(sensor: Floats, rays: Floats, low: Floats) -> Floats:
    """Return where rays enter a person's box, 0.5 m x 0.5 m x 1.75 m: (R,) m, inf where none."""
    with np.errstate(divide="ignore"):
        ends = np.stack([(low - sensor) / rays, (low + [0.5, 0.5, 1.75] - sensor) / rays])
    enter, leave = ends.min(axis=0).max(axis=1), ends.max(axis=0).min(axis=1)
    return np.where((enter <= leave) & (enter > 0), enter, np.inf)


def voxels(points: Floats) -> NDArray[np.uint64]:
    """Return the codes of the 0.1 m voxels that hold points."""
    return np.unique(morton_encode(lattice_coordinates(points, 0.1, np.zeros(3))))


def gathered(
    scans: list[tuple[Floats, Any, Any]], most: int, carve: bool
) -> tuple[ScanGrid, float]:
    """Gather the returns of what is numbered up to `most`; return the grid and ms a scan."""
    grid = ScanGrid(0.05, np.zeros(3), ScanConfig(carve=carve))
    start = time.thread_time()
    for sensor, points, on in scans:
        grid.add(points[on <= most], sensor)
    return grid, (time.thread_time() - start) * 1e3 / len(scans)


def carving(walk: Walk) -> None:
    """Print what carving leaves and costs."""
    print("| person | ghosts before | after | walls lost | poles lost | ms a scan | cells | MB |")
    print("|---|---:|---:|---:|---:|---:|---:|---:|")
    for name, place in walk.places().items():
        scans = list(walk.scans(place))
        gathered(scans[:1], PERSON, True)
        plain = voxels(gathered(scans, PERSON, False)[0].points())
        walls = np.intersect1d(plain, voxels(gathered(scans, WALL, False)[0].points()))
        still = np.intersect1d(plain, voxels(gathered(scans, POLE, False)[0].points()))
        poles = np.intersect1d(still, voxels(np.concatenate(walk.axes)))
        ghosts = np.setdiff1d(plain, still)
        grid, cost = gathered(scans, PERSON, True)
        carved = voxels(grid.points())
        left = int(np.isin(ghosts, carved).sum())
        lost = [f"{1 - np.isin(group, carved).mean():.2%}" for group in (walls, poles)]
        counts = [name, f"{len(ghosts):,}", f"{left:,}", *lost, f"{cost:.1f}"]
        print("| " + " | ".join([*counts, f"{grid.cells:,}", f"{grid.memory / 1e6:.0f}"]) + " |")
    points = np.mean([len(scan[1]) for scan in scans])
    print(f"\n{len(scans)} scans of {points:,.0f} points\n")


def updates(walk: Walk, every: int) -> None:
    """Print what updates cost and what extractions of the same anew."""
    session, anew = (
        ExtractorSession("a", ExtractionConfig(), MatchingConfig(), lambda: "s") for _ in range(2)
    )
    print("| scans | rooms | area m² | changed | update ms | anew ms | same bytes |")
    print("|---:|---:|---:|---:|---:|---:|---|")
    stages: dict[str, list[float]] = {}
    for k, (sensor, points, _) in enumerate(walk.scans(walk.places()["to and fro"]), 1):
        for one in (session, anew):
            one.add_scan(points, "map", k, np.eye(4), sensor=sensor)
        if k % every:
            continue
        changed = session.change()
        update, full = session.extract(), anew.extract(reuse=False)
        with tempfile.TemporaryDirectory() as folder:
            contents = []
            for result in (update, full):
                save_map(Path(folder) / "map.tmap", result.map)
                contents.append((Path(folder) / "map.tmap").read_bytes())
        cost = [sum(result.timings.values()) * 1e3 for result in (update, full)]
        for stage in update.timings:
            pair = stages.setdefault(stage, [0.0, 0.0])
            pair[0] += update.timings[stage] * 1e3
            pair[1] += full.timings[stage] * 1e3
        area = sum(room.area for room in full.map.rooms)
        same = "yes" if contents[0] == contents[1] else "NO"
        print(
            f"| {k} | {len(full.map.rooms)} | {area:.0f} | {changed:.1%} | {cost[0]:.0f} | "
            f"{cost[1]:.0f} | {same} |"
        )
    print("\n| stage, all updates | update ms | anew ms |\n|---|---:|---:|")
    for stage, (update_ms, full_ms) in stages.items():
        print(f"| {stage} | {update_ms:.0f} | {full_ms:.0f} |")


def main() -> None:
    """Run the script."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--spacing", type=float, default=0.4, help="m between scans")
    parser.add_argument("--every", type=int, default=20, help="scans between updates")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    walk = Walk(options.spacing, options.seed)
    carving(walk)
    updates(walk, options.every)


if __name__ == "__main__":
    main()
