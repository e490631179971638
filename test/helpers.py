"""Small factories that the tests share; every one is deterministic."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

needs_shared_data = pytest.mark.skipif(
    not SHARED_DATA.is_dir(), reason="the development data folder ../shared/data is not here"
)


def yaw_transform(
    yaw: float, translation: tuple[float, float, float] = (0.0, 0.0, 0.0)
) -> NDArray[np.float64]:
    """Return a (4, 4) transform that turns by `yaw` (rad) about z and then moves (m)."""
    T = np.eye(4)
    T[:2, :2] = [[np.cos(yaw), -np.sin(yaw)], [np.sin(yaw), np.cos(yaw)]]
    T[:3, 3] = translation
    return T


def moved(points: NDArray[np.float64], T: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return points (N, 3) in the target frame of `T`."""
    return points @ T[:3, :3].T + T[:3, 3]


def box_room(
    corner: tuple[float, float, float],
    size: tuple[float, float, float],
    doors: tuple[tuple[str, float], ...] = (),
    step: float = 0.04,
) -> NDArray[np.float64]:
    """Return the points of an empty room: floor, ceiling and four walls with door openings.

    `doors` names a side ("x-", "x+", "y-", "y+") and the middle of a 0.9 m wide, 2.1 m high opening
    along that side, in metres from the room's corner.
    """
    (x, y, z), (dx, dy, dz) = corner, size
    u, v = (np.arange(0, length + step / 2, step) for length in (dx, dy))
    h = np.arange(0, dz + step / 2, step)
    floor = np.stack(np.meshgrid(u, v, [0.0, dz], indexing="ij"), -1).reshape(-1, 3)
    parts = [floor]
    for side, along in (("x-", v), ("x+", v), ("y-", u), ("y+", u)):
        a, b = (g.ravel() for g in np.meshgrid(along, h, indexing="ij"))
        keep = np.ones(len(a), bool)
        for where, middle in doors:
            if where == side:
                keep &= ~((np.abs(a - middle) < 0.45) & (b < 2.1))
        fixed = np.full(len(a), {"x-": 0.0, "x+": dx, "y-": 0.0, "y+": dy}[side])
        wall = (fixed, a, b) if side[0] == "x" else (a, fixed, b)
        parts.append(np.stack(wall, -1)[keep])
    return np.concatenate(parts) + (x, y, z)
