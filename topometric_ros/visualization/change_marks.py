"""What has changed between the agents' visits, on the global map's plan: moved furniture, doors."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.alignment import Change
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.plan import Plan
from topometric_ros.visualization.sheet import Pose, Sheet

_KINDS = (
    ("gone since", "#d1003f"),
    ("new since", "#00875a"),
    ("seen by one only", "#b35c00"),
)
_SPARE = 4
"""Cells round what is drawn, for the lines about it."""


def draw_changes(
    sheet: Sheet,
    changes: Sequence[Change],
    m: TopometricMap,
    plans: Sequence[tuple[Plan, Pose]],
) -> list[tuple[str, str, str]]:
    """Draw changes on the storeys of the map that they were found in; return the legend.

    What the newer of two maps no longer has is *gone since*, what only it has *new since*; where
    nobody knows which is the newer, it is *seen by one only*.
    """
    legend = []
    for kind, (name, colour) in enumerate(_KINDS):
        points = [c.points for c in changes if _kind(c) == kind]
        if not points:
            continue
        for plan, pose in plans:
            here = _on_storey(np.concatenate(points), m, plan)
            if len(here):
                mask, origin = _raster(here, plan.cell)
                sheet.mask(mask, origin, plan.cell, pose, colour + "66", 4.0)
                sheet.outline(mask, origin, plan.cell, pose, colour, 1.6)
        legend.append((name, colour, "patch"))
    return legend


def _kind(change: Change) -> int:
    if not change.ordered:
        return 2
    return 0 if change.gone else 1


def _on_storey(points: NDArray[np.float64], m: TopometricMap, plan: Plan) -> NDArray[np.float64]:
    """Return where points (n, 3), level frame, stand on a storey: (k, 2) m."""
    floors = sorted(storey.floor_z for storey in m.storeys)
    floor = plan.storey.floor_z
    above = [z for z in floors if z > floor]
    low = -np.inf if floor == floors[0] else floor
    high = above[0] if above else np.inf
    return points[(points[:, 2] >= low) & (points[:, 2] < high), :2]


def _raster(
    places: NDArray[np.float64], cell: float
) -> tuple[NDArray[np.bool_], tuple[float, float]]:
    """Return a mask of the cells that places (n, 2) lie in, small gaps closed, and its origin."""
    cells = np.floor(places / cell).astype(np.int64)
    low = cells.min(axis=0) - _SPARE
    mask = np.zeros(cells.max(axis=0) - low + 1 + _SPARE, dtype=bool)
    mask[tuple((cells - low).T)] = True
    x, y = (low + 0.5) * cell
    return ndimage.binary_closing(mask, np.ones((3, 3), bool)), (float(x), float(y))
