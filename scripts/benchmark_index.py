#!/usr/bin/env python3
"""Compare octree, hash table and dense bit grid for radius queries, as Markdown tables.

    benchmark_index.py [CLOUD ...] [--voxel-size M] [--queries N]

The clouds are put into voxels; the queries stand on voxels drawn with a fixed seed. All three run
compiled and return the same rows, which is checked. Microseconds of CPU a query, the best of three
rounds; building in milliseconds; memory in MB of what a structure keeps.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit

from topometric_ros.errors import TopometricError
from topometric_ros.io.clouds import read_cloud
from topometric_ros.voxels.grid import voxelise
from topometric_ros.voxels.index import VoxelIndex, rows_within
from topometric_ros.voxels.octree import Octree, _leaves_within

RADII = (0.1, 0.2, 0.3, 0.5, 0.7, 1.0)
ROUNDS = 3


def main() -> int:
    """Print a table for each cloud; return 2 where one cannot be read."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("clouds", nargs="+", type=Path)
    parser.add_argument("--voxel-size", type=float, default=0.1)
    parser.add_argument("--queries", type=int, default=2000)
    args = parser.parse_args()
    for path in args.clouds:
        try:
            points = read_cloud(path).points
        except TopometricError as error:
            print(error, file=sys.stderr)
            return 2
        grid, _ = voxelise(points, args.voxel_size, points.min(axis=0))
        _print_table(path, grid.coords, args)
    return 0


def _print_table(path: Path, coords: Any, args: argparse.Namespace) -> None:
    """Measure the three structures on one cloud."""
    rng = np.random.default_rng(0)
    places = coords[rng.integers(0, len(coords), args.queries)].astype(float)
    octree, index, bits = Octree(coords), VoxelIndex(coords), _bit_grid(coords)
    tree, table = octree._tree, index.table
    ways: dict[str, tuple[Callable[[], Any], float, Callable[[float], Any]]] = {
        "octree": (lambda: Octree(coords), octree.nbytes,
                   lambda r: _octree_queries(*tree, places, r)),
        "hash table": (lambda: VoxelIndex(coords), sum(p.nbytes for p in table),
                       lambda r: _table_queries(table, places, r)),
        "dense bit grid": (lambda: _bit_grid(coords), bits[0].nbytes,
                           lambda r: _grid_queries(*bits, places, r)),
    }  # fmt: skip
    print(f"\n`{path.parent.name}/{path.name}`: {len(coords)} voxels of {args.voxel_size:g} m\n")
    print("| | build (ms) | memory (MB) | " + " | ".join(f"{r:g} m (µs)" for r in RADII) + " |")
    print("|---" + "|---:" * (2 + len(RADII)) + "|")
    counts = set()
    for name, (build, size, query) in ways.items():
        cells = [1e3 * _seconds(build), size / 1e6]
        for radius in RADII:
            cells.append(1e6 * _seconds(lambda: query(radius / args.voxel_size)) / len(places))  # noqa: B023
        counts.add(tuple(int(query(r / args.voxel_size)) for r in RADII))
        print(f"| {name} | " + " | ".join(f"{c:.1f}" for c in cells) + " |")
    if len(counts) > 1:
        raise SystemExit("the structures disagree")


def _seconds(work: Callable[[], Any]) -> float:
    """CPU seconds of the best of three rounds, compilation left out."""
    work()
    spent = []
    for _ in range(ROUNDS):
        start = time.thread_time()
        work()
        spent.append(time.thread_time() - start)
    return min(spent)


def _bit_grid(coords: Any) -> tuple[Any, Any, Any]:
    """Return one bit for each cell of the bounding box, along z in words of 64, and its corner."""
    low = coords.min(axis=0).astype(np.int64)
    shape = coords.max(axis=0) - low + 1
    words = np.zeros((shape[0], shape[1], (shape[2] + 63) // 64), np.uint64)
    x, y, z = (coords - low).T
    np.bitwise_or.at(words, (x, y, z >> 6), np.uint64(1) << (z & 63).astype(np.uint64))
    return words, low, shape


@njit(nogil=True)
def _octree_queries(corner, reach, child, leaf, places, radius):  # type: ignore[no-untyped-def]
    found = 0
    for place in places:
        found += len(_leaves_within(corner, reach, child, leaf, place, place, radius))
    return found


@njit(nogil=True)
def _table_queries(table, places, radius):  # type: ignore[no-untyped-def]
    found = 0
    for place in places:
        found += len(rows_within(table, place, radius))
    return found


@njit(nogil=True)
def _grid_queries(words, low, shape, places, radius):  # type: ignore[no-untyped-def]
    """Look at every cell of the ball's bounding box; cells are listed, as the others list rows."""
    total = 0
    found = np.empty(1024, np.int64)
    for place in places:
        begin = np.maximum(np.ceil(place - radius).astype(np.int64) - low, 0)
        end = np.minimum(np.floor(place + radius).astype(np.int64) - low + 1, shape)
        x, y, z = place - low
        count = 0
        for i in range(begin[0], end[0]):
            for j in range(begin[1], end[1]):
                for k in range(begin[2], end[2]):
                    square = (i - x) ** 2 + (j - y) ** 2 + (k - z) ** 2
                    word = words[i, j, k >> 6] >> np.uint64(k & 63)
                    if square <= radius * radius and word & np.uint64(1):
                        if count == len(found):
                            found = np.append(found, np.empty(count, np.int64))
                        found[count] = (i * shape[1] + j) * shape[2] + k
                        count += 1
        total += count
    return total


if __name__ == "__main__":
    sys.exit(main())
