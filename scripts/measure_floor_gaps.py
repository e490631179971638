#!/usr/bin/env python3
"""Measure the navigable volume where patches of floor were not seen, before and after closing.

    measure_floor_gaps.py BUILDING... [--shares 0 0.2 0.4 0.6] [--patch 1.0] [--seed 0]

BUILDING is what `topometric simulate` takes. One agent walks through all rooms of it; from its
cloud the floors of all storeys lose a share of their square patches, whatever lies within 0.15 m of
a floor's height. A navigable cell is right where the model has a surface within 0.15 m of it with
1.2 m of nothing above; recall is of the right cells of the whole cloud. "Added" are the cells that
closing adds, "parts" the pieces of at least 1 m² that the navigable volume falls into.
"""

from __future__ import annotations

import argparse
import importlib
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.config import ExtractionConfig, extraction_preset
from topometric_ros.extraction.passages import steps
from topometric_ros.extraction.pipeline import extract
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.cases import SimulationConfig, prepare, simulate
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.components import connected_components
from topometric_ros.voxels.kernels import kernel_of

sys.path.insert(0, str(Path(__file__).parent))
from measure_passages import SEED, tour

Floats = NDArray[np.float64]
o3d: Any = importlib.import_module("open3d")

_NEAR = 0.15
_FREE = 1.2


class Truth:
    """Where the model can be stood on, told by rays that fall."""

    def __init__(
        self, vertices: NDArray[np.floating], faces: NDArray[np.integer], T_building_agent: Floats
    ):
        self._T = T_building_agent
        self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
        self._scene.add_triangles(
            o3d.core.Tensor(vertices.astype(np.float32)), o3d.core.Tensor(faces.astype(np.uint32))
        )

    def holds(self, places: Floats) -> NDArray[np.bool_]:
        """Return which places (N, 3), m, agent frame, are floor with free space above."""
        above = places @ self._T[:3, :3].T + self._T[:3, 3] + (0.0, 0.0, _FREE)
        down = np.broadcast_to((0.0, 0.0, -1.0), above.shape)
        rays = np.concatenate([above, down], axis=1).astype(np.float32)
        reach = self._scene.cast_rays(o3d.core.Tensor(rays), nthreads=1)["t_hit"].numpy()
        return np.asarray(np.abs(reach - _FREE) <= _NEAR)


def places_of(m: TopometricMap) -> Floats:
    """Return the navigable cells in the input's frame: (M, 3), m."""
    level = np.asarray(m.origin) + m.navigable * m.voxel_size
    return (level - m.T_level_input[:3, 3]) @ m.T_level_input[:3, :3]


def keys_of(places: Floats) -> list[tuple[int, ...]]:
    """Return a key for each place, one for every column and half metre of height."""
    return list(map(tuple, np.floor(places / (0.1, 0.1, 0.5) + 0.5).astype(int).tolist()))


def parts_of(m: TopometricMap) -> int:
    """Return into how many pieces of at least 1 m² the navigable volume falls."""
    kernel = kernel_of(steps("26", round(0.2 / m.voxel_size)))
    sizes = np.bincount(connected_components(m.navigable, kernel))
    return int(np.count_nonzero(sizes * m.voxel_size**2 >= 1.0))


def without_patches(
    points: Floats, floors: Floats, share: float, patch: float, seed: int
) -> Floats:
    """Return the points without a share of the patches of floor."""
    at = np.floor((points[:, :2] - points[:, :2].min(axis=0)) / patch).astype(np.int64)
    rng = np.random.default_rng(seed)
    kept = np.ones(len(points), bool)
    for floor in floors:
        chosen = rng.random(tuple(at.max(axis=0) + 1)) < share
        kept &= ~((np.abs(points[:, 2] - floor) < _NEAR) & chosen[at[:, 0], at[:, 1]])
    return points[kept]


def rows(spec: str, args: argparse.Namespace) -> list[list[float]]:
    """Print a row for each share; return the numbers."""
    config = SimulationConfig(agents=1)
    ready = prepare(load_building(spec), config)
    agent = simulate(ready, config, SEED, [tour(ready.walkable)]).agents[0]
    truth = Truth(
        ready.building.vertices,
        ready.building.faces,
        np.asarray(np.linalg.inv(agent.T_agent_building), np.float64),
    )
    default = extraction_preset("default")
    plain = replace(
        default, navigation=replace(default.navigation, gap=0.0, roofed_gap=0.0, treads=False)
    )
    whole = extract(agent.points, plain).map
    all_places = places_of(whole)
    right = set(keys_of(all_places[truth.holds(all_places)]))
    floors = np.array([s.floor_z for s in whole.storeys]) - whole.T_level_input[2, 3]
    table = []
    for share in args.shares:
        points = without_patches(agent.points, floors, share, args.patch, args.seed)
        before, after = (_measured(points, c, truth, right) for c in (plain, default))
        name = spec.rsplit("/", 1)[-1].removesuffix(".npz")
        added = sorted(after.cells.keys() - before.cells.keys())
        sure = np.mean([after.cells[cell] for cell in added]) if added else 1.0
        print(
            f"| {name} | {share:g} | {before.precision:.3f} / {before.recall:.3f} "
            f"| {before.parts} | {after.precision:.3f} / {after.recall:.3f} | {after.parts} "
            f"| {len(added) / 100:.1f} | {sure:.2f} |",
            flush=True,
        )
        table.append([share, before.precision, before.recall, after.precision, after.recall])
    return table


@dataclass(frozen=True)
class Measured:
    """A navigable volume against the truth; `cells` says of each column whether it is right."""

    precision: float
    recall: float
    parts: int
    cells: dict[tuple[int, ...], bool]


def _measured(
    points: Floats, config: ExtractionConfig, truth: Truth, right: set[tuple[int, ...]]
) -> Measured:
    m = extract(points, config).map
    places = places_of(m)
    holds = truth.holds(places)
    cells = dict(zip(keys_of(places), holds.tolist(), strict=True))
    recall = len(right & cells.keys()) / max(len(right), 1)
    return Measured(float(holds.mean()), recall, parts_of(m), cells)


def main() -> int:
    """Print the table and the means."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("building", nargs="+")
    parser.add_argument("--shares", nargs="+", type=float, default=[0.0, 0.2, 0.4, 0.6])
    parser.add_argument("--patch", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    args = parser.parse_args()
    print("| building | floor missing | before: precision / recall | parts ", end="")
    print("| after: precision / recall | parts | added, m² | of it right |")
    print("|---|" + "---:|" * 7)
    numbers = np.array([row for spec in args.building for row in rows(spec, args)])
    for share in args.shares:
        p0, r0, p1, r1 = numbers[numbers[:, 0] == share, 1:].mean(axis=0)
        print(f"| mean | {share:g} | {p0:.3f} / {r0:.3f} | | {p1:.3f} / {r1:.3f} | | | |")
    return 0


if __name__ == "__main__":
    sys.exit(main())
