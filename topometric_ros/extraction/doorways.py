"""Doorways: how wide and how high a passage is, and whether it is a door, an opening or a ramp.

A passage lies where the space between two rooms is narrowest: of all straight lines on the plan
through the places where they meet, the shortest that ends at a jamb on either
side. What hangs
over that line lower than a ceiling is a lintel. Jambs and lintel are read at the mean of the
points in a voxel, so that a door is measured finer than the voxels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.extraction.columns import Columns
from topometric_ros.voxels.grid import VoxelGrid

_SMALLEST_RISE, _FLIGHT, _HIGHEST_RISE = 0.15, 0.5, 1.0
"""m: a threshold rises less than a ramp, a stool less than a flight of stairs, and what lies
farther up or down within a metre is another floor."""
_SLOPE, _STEEP = 0.04, 0.3
"""Rise over run from which a floor is a ramp, and from which it is stairs."""
_EVEN, _TREAD = 0.03, 0.08
"""How far from one plane the floor of a ramp, and that of stairs, lies on average, m."""
_BODY = (0.4, 1.7)
"""Heights above the floor, m, at which what stands beside a passage is a jamb."""
_JAMB = 3
"""Fewest voxels of 0.1 m between those heights in the column of a jamb."""
_FARTHEST = 3.0
"""How far to either side a jamb is looked for, m."""
_BESIDE = 0.4
"""How far before and behind the line in which the rooms meet the narrowest one is looked for, m."""
_LOWEST_LINTEL = 1.7
"""m above the floor: lower things hang or stand in the way, but are no lintel."""
_UNDER_CEILING = 0.15
"""A lintel hangs lower than the storey's ceiling by at least this, m."""
_WIDEST_DOOR = 2.2
"""m: wider holes in a wall are openings, with a lintel or without."""
_SWING = 0.6
"""rad: how far the narrowest line may be turned against the line in which the rooms meet."""
_TURNS = 6
"""Directions tried to either side of it."""


@dataclass(frozen=True)
class Doorway:
    """The opening of a passage, m: its middle on the plan, width, free height and jambs found.

    `height` is None where no lintel was seen; `ceiling_seen` says that more than that was: the
    space above is open up to the ceiling.
    """

    middle: tuple[float, float]
    width: float
    height: float | None
    ceiling_seen: bool

    @property
    def kind(self) -> str:
        """`door` for what has a lintel, or narrow with the space above unseen; else `opening`."""
        if self.height is None and self.ceiling_seen:
            return "opening"
        return "door" if self.width <= _WIDEST_DOOR else "opening"


class Surroundings:
    """The occupied voxels by columns, for looking at what stands round a place."""

    def __init__(self, grid: VoxelGrid, columns: Columns, surface: NDArray[np.float64]) -> None:
        """Take voxels, their columns and their mean points `surface` (N, 3), m."""
        self._grid, self._columns, self._surface = grid, columns, surface
        self._column_at = np.full(columns.shape, -1, np.int32)
        self._column_at[tuple(columns.cells.T)] = np.arange(len(columns.cells))

    def doorway(
        self,
        contact: NDArray[np.float64],
        least: float,
        floor: float,
        ceiling: float | None,
    ) -> Doorway | None:
        """Measure the doorway at the places (C, 2), m, where two rooms meet; None: no jambs.

        Parameters
        ----------
        contact : (C, 2) float64, m, level frame
        least : m, narrower lines end at things that stand in the room
        floor, ceiling : heights, m; None where no ceiling was seen
        """
        size = self._grid.voxel_size
        reach = _FARTHEST + _BESIDE
        low = self._cell(contact.min(axis=0) - reach)
        high = self._cell(contact.max(axis=0) + reach) + 1
        low, high = np.maximum(low, 0), np.minimum(high, self._columns.shape)
        window = self._column_at[low[0] : high[0], low[1] : high[1]]
        jambs, lowest = self._profile(window, floor)
        middle = contact.mean(axis=0)
        main = _direction(contact)
        steps = np.arange(-round(_BESIDE / size), round(_BESIDE / size) + 1)[:, None]
        across = np.array([-np.sin(main), np.cos(main)])
        places = (middle - self._grid.origin[:2]) / size - self._columns.corner - low
        line = _narrowest(
            jambs, places + steps * across, main, _SWING, least / size, _FARTHEST / size
        )
        if line[0] < 0:
            return None
        ends = [self._jamb(window, line[k : k + 2], floor) for k in (1, 3)]
        along = ends[1] - ends[0]
        width = float(np.hypot(*along))
        height, ceiling_seen = _lintel(
            lowest, np.array(line[1:5]).reshape(2, 2), size, floor, ceiling
        )
        x, y = ((ends[0] + ends[1]) / 2).tolist()
        return Doorway((x, y), width, height, ceiling_seen)

    def _cell(self, flat: NDArray[np.float64]) -> NDArray[np.int64]:
        """Return the raster cells of positions (.., 2), m."""
        grid = self._grid
        cells = np.floor((flat - grid.origin[:2]) / grid.voxel_size + 0.5).astype(np.int64)
        return cells - self._columns.corner

    def _profile(
        self, window: NDArray[np.int32], floor: float
    ) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
        """Return which cells hold a jamb, and the height of the lowest thing overhead (inf)."""
        need = max(1, round(_JAMB * 0.1 / self._grid.voxel_size))
        return _profile(
            window,
            self._columns.starts,
            self._columns.order,
            self._surface[:, 2],
            (floor + _BODY[0], floor + _BODY[1], floor + _LOWEST_LINTEL),
            need,
        )

    def _jamb(
        self, window: NDArray[np.int32], cell: tuple[float, ...], floor: float
    ) -> NDArray[np.float64]:
        """Return the mean point (2,), m, of what stands in a cell of the window."""
        column = window[int(cell[0]), int(cell[1])]
        rows = self._columns.order[self._columns.starts[column] : self._columns.starts[column + 1]]
        z = self._surface[rows, 2]
        body = rows[(z >= floor + _BODY[0]) & (z <= floor + _BODY[1])]
        mean: NDArray[np.float64] = self._surface[body, :2].mean(axis=0)
        return mean


def _direction(contact: NDArray[np.float64]) -> float:
    """Return the angle (rad) of the main direction of points (C, 2)."""
    centred = contact - contact.mean(axis=0)
    _, axes = np.linalg.eigh(centred.T @ centred)
    return float(np.arctan2(axes[1, -1], axes[0, -1]))


@njit(cache=True, nogil=True)
def _profile(window, starts, order, z, levels, need):  # type: ignore[no-untyped-def]
    """Jambs and the lowest height overhead of each cell of a window of columns."""
    jambs = np.zeros(window.shape, np.bool_)
    lowest = np.full(window.shape, np.inf)
    for i in range(window.shape[0]):
        for j in range(window.shape[1]):
            column = window[i, j]
            if column < 0:
                continue
            count = 0
            for k in range(starts[column], starts[column + 1]):
                height = z[order[k]]
                if levels[0] <= height <= levels[1]:
                    count += 1
                if height >= levels[2] and height < lowest[i, j]:
                    lowest[i, j] = height
            jambs[i, j] = count >= need
    return jambs, lowest


@njit(cache=True, nogil=True)
def _narrowest(jambs, places, main, swing, least, farthest):  # type: ignore[no-untyped-def]
    """Return length and both end cells of the shortest line between jambs; length -1: none."""
    best = (-1.0, 0.0, 0.0, 0.0, 0.0)
    for p in range(len(places)):
        x, y = places[p, 0], places[p, 1]
        for d in range(-_TURNS, _TURNS + 1):
            angle = main + swing * d / _TURNS
            dx, dy = np.cos(angle), np.sin(angle)
            ax, ay = _end(jambs, x, y, dx, dy, farthest)
            bx, by = _end(jambs, x, y, -dx, -dy, farthest)
            if ax < 0 or bx < 0:
                continue
            length = np.hypot(ax - bx, ay - by)
            if length >= least and (best[0] < 0 or length < best[0] - 1e-9):
                best = (length, ax, ay, bx, by)
    return best


@njit(cache=True, nogil=True)
def _end(jambs, x, y, dx, dy, farthest):  # type: ignore[no-untyped-def]
    """Return the first jamb on a ray, (-1, -1) where there is none within reach."""
    step = 0.5
    for k in range(int(farthest / step)):
        i, j = int(np.floor(x + dx * step * k + 0.5)), int(np.floor(y + dy * step * k + 0.5))
        if i < 0 or j < 0 or i >= jambs.shape[0] or j >= jambs.shape[1]:
            return -1.0, -1.0
        if jambs[i, j]:
            return float(i), float(j)
    return -1.0, -1.0


def _lintel(
    lowest: NDArray[np.float64],
    ends: NDArray[np.float64],
    size: float,
    floor: float,
    ceiling: float | None,
) -> tuple[float | None, bool]:
    """Return the free height under a lintel or None, and whether the ceiling was seen instead.

    Parameters
    ----------
    lowest : (nx, ny) height of the lowest thing overhead, m, inf for none
    ends : (2, 2), the cells of both jambs
    """
    along = ends[1] - ends[0]
    length = float(np.hypot(*along))
    across = np.array([-along[1], along[0]]) / max(length, 1e-9)
    places = ends[0] + along * np.linspace(0.0, 1.0, max(3, round(length) + 1))[1:-1, None]
    steps = np.arange(-2, 3)[:, None, None] * (0.1 / size)
    cells = np.round(places + steps * across).astype(int)
    cells = np.clip(cells, 0, np.array(lowest.shape) - 1)
    # A lintel is a line across the passage, and may lie a cell or two beside the narrowest one.
    over = np.min(lowest[cells[..., 0], cells[..., 1]], axis=0)
    limit = np.inf if ceiling is None else ceiling - _UNDER_CEILING
    lintel = over[over < limit]
    if len(lintel) >= 0.5 * len(over):
        return float(np.median(lintel) - floor), False
    return None, bool(np.mean(np.isfinite(over)) >= 0.5)


def kind_of_rise(floor: NDArray[np.float64]) -> str | None:
    """Return `stairs` or `ramp` where the floor round a passage rises like one, else None.

    Parameters
    ----------
    floor : (n, 3) float64, m, points of the floor, relative to the passage
    """
    floor = floor[np.abs(floor[:, 2]) <= _HIGHEST_RISE]
    if len(floor) < 10 or np.ptp(floor[:, 2]) < _SMALLEST_RISE:
        return None
    plane = np.column_stack([floor[:, :2], np.ones(len(floor))])
    slope = np.linalg.lstsq(plane, floor[:, 2], rcond=None)[0]
    off = np.sqrt(np.mean((plane @ slope - floor[:, 2]) ** 2))
    gradient = float(np.hypot(slope[0], slope[1]))
    if gradient >= _STEEP and off <= _TREAD and np.ptp(floor[:, 2]) >= _FLIGHT:
        return "stairs"
    return "ramp" if gradient >= _SLOPE and off <= _EVEN else None
