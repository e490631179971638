"""A storey as an occupancy grid, the way Nav2 reads maps: PGM and YAML, or a message's values.

A cell is occupied where a wall or furniture stands or anything else was seen above 0.2 m of the
floor, free where floor was seen with nothing on it, unknown elsewhere. Lintels and whatever hangs
above 2.05 m do not count (`extraction/layers.py` has the bands).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.io.summaries import write_atomically
from topometric_ros.topometric_map import Storey, TopometricMap

FREE, OCCUPIED, UNKNOWN = 0, 100, -1
_GREY = {FREE: 254, OCCUPIED: 0, UNKNOWN: 205}
_UPRIGHT = np.cos(np.radians(10.0))
"""Frames whose z is this near to level z can hold a grid; a y-up frame cannot."""


@dataclass(frozen=True)
class OccupancyGrid:
    """One storey from above.

    `values` is (ny, nx) int8 as in nav_msgs/OccupancyGrid: 0 free, 100 occupied, -1 unknown, row 0
    at the lowest y. `origin` is the pose (x, y in m, yaw in rad) of the outer corner of cell (0, 0)
    in the map's input frame, or in its level frame where `level` says that the input's z is not up.
    """

    values: NDArray[np.int8]
    resolution: float
    origin: tuple[float, float, float]
    floor_z: float
    level: bool


def occupancy_grid(m: TopometricMap, storey: Storey) -> OccupancyGrid:
    """Return the occupancy grid of one of a map's storeys."""
    layers = storey.layers
    values = np.full(layers.wall.shape, UNKNOWN, dtype=np.int8)
    values[layers.bare] = FREE
    values[layers.wall | layers.furniture | (layers.free & ~layers.bare)] = OCCUPIED
    T = np.linalg.inv(m.T_level_input)
    upright = bool(T[2, 2] > _UPRIGHT)
    if not upright:
        T = np.eye(4)
    corner = T @ (*(np.asarray(layers.origin) - layers.cell / 2.0), storey.floor_z, 1.0)
    yaw = float(np.arctan2(T[1, 0], T[0, 0]))
    origin = (float(corner[0]), float(corner[1]), yaw)
    return OccupancyGrid(
        np.ascontiguousarray(values.T), layers.cell, origin, float(corner[2]), not upright
    )


def write_occupancy(folder: Path, stem: str, grid: OccupancyGrid) -> list[Path]:
    """Write `stem`.pgm and `stem`.yaml for the map server of Nav2; return both paths."""
    image, text = folder / f"{stem}.pgm", folder / f"{stem}.yaml"
    pixels = np.full(grid.values.shape, _GREY[UNKNOWN], dtype=np.uint8)
    for value in (FREE, OCCUPIED):
        pixels[grid.values == value] = _GREY[value]
    header = f"P5\n{grid.values.shape[1]} {grid.values.shape[0]}\n255\n".encode()
    # An image's first row is its top: the largest y.
    write_atomically(image, header + pixels[::-1].tobytes())
    x, y, yaw = grid.origin
    frame = "the map's level frame, since its input is not z up" if grid.level else "the map frame"
    lines = [
        f"# floor at z = {grid.floor_z:.3f} m; origin in {frame}",
        f"image: {image.name}",
        "mode: trinary",
        f"resolution: {grid.resolution:g}",
        f"origin: [{x:.6f}, {y:.6f}, {yaw:.9f}]",
        "negate: 0",
        "occupied_thresh: 0.65",
        "free_thresh: 0.25",
    ]
    write_atomically(text, ("\n".join(lines) + "\n").encode())
    return [image, text]
