"""A drawing in metres, seen from above: rasters, graphs, outlines and a scale bar, as PNG bytes.

Everything that is drawn brings its `Pose`, the place of its frame on the sheet, so maps in
different frames lie side by side or on top of each other without being resampled.
"""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.visualization.painting import Raster, painted, raster_on_sheet
from topometric_ros.visualization.plan import UNSEEN, Plan
from topometric_ros.visualization.smoothing import (
    fine_origin,
    refinement,
    smooth_labels,
    smooth_mask,
)
from topometric_ros.voxels.palette import room_colours

INK = "#22272e"
PAPER = "#ffffff"
_WASHED = 0.42
"""How far room colours are mixed with white, so that walls and numbers stand out."""
_DPI = 170
_MARGIN = 0.5
"""Paper round the drawing, m."""


@dataclass(frozen=True)
class Pose:
    """Where a frame lies on the sheet: turned by `angle` (rad), then moved by (x, y) m."""

    angle: float = 0.0
    x: float = 0.0
    y: float = 0.0

    def apply(self, places: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return places (n, 2) m on the sheet."""
        c, s = np.cos(self.angle), np.sin(self.angle)
        return places @ np.array([[c, s], [-s, c]]) + (self.x, self.y)

    def moved(self, x: float, y: float) -> Pose:
        """Return this pose shifted by (x, y) m on the sheet."""
        return Pose(self.angle, self.x + x, self.y + y)

    def after(self, T: NDArray[np.float64]) -> Pose:
        """Return the pose of a frame whose transform into this one is `T` (4, 4), level."""
        x, y = self.apply(T[None, :2, 3])[0]
        return Pose(self.angle + float(np.arctan2(T[1, 0], T[0, 0])), float(x), float(y))


def plan_bounds(plan: Plan, pose: Pose) -> tuple[float, float, float, float]:
    """Return what a plan covers of the sheet: left, bottom, right, top, m."""
    places = np.argwhere(plan.rooms != UNSEEN) * plan.cell + np.asarray(plan.origin)
    return bounds_of(pose.apply(places))


def bounds_of(places: NDArray[np.float64]) -> tuple[float, float, float, float]:
    """Return left, bottom, right and top of places (n, 2), m."""
    (left, bottom), (right, top) = places.min(axis=0), places.max(axis=0)
    return float(left), float(bottom), float(right), float(top)


def room_image(
    rooms: NDArray[np.int32], colours: Mapping[int, Sequence[float]] | None = None
) -> NDArray[np.uint8]:
    """Return room ids (nx, ny) as an image (nx, ny, 4) uint8 in pale colours.

    With `colours`, rooms that it does not name are grey.
    """
    low = int(rooms.min(initial=0))
    present = np.bincount(rooms.ravel() - low) > 0  # A sort of millions of cells costs far more.
    ids, row_of = np.flatnonzero(present) + low, np.cumsum(present) - 1
    table = np.ones((len(ids), 4))
    table[:, :3] = room_colours(ids) / 255.0 * (1 - _WASHED) + _WASHED
    for row, room in enumerate(ids.tolist()):
        if room < 0:
            table[row] = (0.93, 0.93, 0.93, 0.0 if room == UNSEEN else 1.0)
        elif colours is not None:
            table[row, :3] = colours.get(room, (0.86, 0.87, 0.88))
    return np.round(table * 255).astype(np.uint8)[row_of[rooms - low]]


class Sheet:
    """One picture; nothing is shown or written until :meth:`png`."""

    def __init__(self) -> None:
        from matplotlib.backends.backend_agg import FigureCanvasAgg
        from matplotlib.figure import Figure

        self._figure = Figure(facecolor=PAPER, dpi=_DPI)
        FigureCanvasAgg(self._figure)
        self._axes: Any = self._figure.add_axes((0, 0, 1, 1))
        self._axes.set_axis_off()
        self._seen: list[tuple[float, float, float, float]] = []
        self._rasters: list[Raster] = []
        self._legend: list[Any] = []
        self._head = 0.0  # Room that captions need above the drawing, inches.

    def include(self, bounds: tuple[float, float, float, float]) -> None:
        """Make sure that the picture covers left, bottom, right, top, m on the sheet."""
        self._seen.append(bounds)

    def raster(
        self,
        image: NDArray[np.uint8],
        origin: tuple[float, float],
        cell: float,
        pose: Pose,
        order: float = 1.0,
    ) -> None:
        """Draw an image (nx, ny, 4) uint8 whose first cell is centred at `origin`, m.

        All rasters lie below all lines, dots and numbers.
        """
        place = (pose.angle, pose.x, pose.y)
        self._rasters.append(raster_on_sheet(image, origin, cell, place, order))

    def mask(
        self,
        mask: NDArray[np.bool_],
        origin: tuple[float, float],
        cell: float,
        pose: Pose,
        colour: str,
        order: float = 2.0,
    ) -> None:
        """Draw the true cells of a mask (nx, ny) in one colour (`#rrggbb` or `#rrggbbaa`)."""
        from matplotlib.colors import to_rgba

        factor = refinement(mask.shape)
        fine = smooth_mask(mask, factor)
        image = np.zeros((*fine.shape, 4), dtype=np.uint8)
        image[fine] = np.round(np.array(to_rgba(colour)) * 255)
        self.raster(image, fine_origin(origin, cell, factor), cell / factor, pose, order)

    def rooms(
        self, plan: Plan, pose: Pose, colours: Mapping[int, Sequence[float]] | None = None
    ) -> None:
        """Draw the rooms of a plan, in their own colours or in those given."""
        factor = refinement(plan.rooms.shape)
        image = room_image(smooth_labels(plan.rooms, factor), colours)
        origin = fine_origin(plan.origin, plan.cell, factor)
        self.raster(image, origin, plan.cell / factor, pose)

    def outline(
        self,
        mask: NDArray[np.bool_],
        origin: tuple[float, float],
        cell: float,
        pose: Pose,
        colour: str,
        width: float,
    ) -> None:
        """Draw a smooth line round the true cells of a mask (nx, ny)."""
        from scipy import ndimage

        smooth = ndimage.gaussian_filter(np.pad(mask, 8).astype(float), 2.0)
        x, y = (origin[k] + cell * (np.arange(smooth.shape[k]) - 8) for k in (0, 1))
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1)
        placed = pose.apply(grid.reshape(-1, 2)).reshape(grid.shape)
        self._axes.contour(
            *(placed[..., 0], placed[..., 1], smooth),
            levels=[0.5],
            colors=[colour],
            linewidths=width,
            zorder=5,
        )

    def line(
        self, places: Any, colour: Any, width: float, order: float = 6.0, casing: float = 0.0
    ) -> None:
        """Draw a line through places (n, 2) m on the sheet, `casing` points of white beside it."""
        x, y = np.asarray(places, dtype=float).T
        if casing:
            self._axes.plot(x, y, color=PAPER, lw=width + 2 * casing, zorder=order - 0.01)
        self._axes.plot(x, y, color=colour, lw=width, zorder=order, solid_capstyle="round")

    def dot(self, place: Any, colour: Any, size: float, order: float = 7.0) -> None:
        """Draw a small disk with a dark rim."""
        self._axes.plot(
            *place, "o", ms=size, mfc=colour, mec=INK, mew=0.9, zorder=order, clip_on=False
        )

    def number(self, place: Any, text: str, size: float = 8.0) -> None:
        """Draw a room's number on a white disk, wider where the number is long."""
        shape = "circle,pad=0.3" if len(text) < 3 else "round,pad=0.3,rounding_size=0.9"
        self._axes.text(
            *place,
            text,
            ha="center",
            va="center_baseline",
            size=size,
            color=INK,
            weight="bold",
            zorder=9,
            bbox={
                "boxstyle": shape,
                "facecolor": PAPER,
                "edgecolor": INK,
                "linewidth": 0.9,
            },
        )

    def caption(self, x: float, y: float, text: str, size: float = 9.5, colour: str = INK) -> None:
        """Write a line of text that starts a little above a place on the sheet."""
        self._head = max(self._head, 0.35 if size > 10 else 0.3)
        self._seen.append((x, y, x, y))
        weight = "bold" if size > 10 else "normal"
        y += 0.2
        self._axes.text(x, y, text, va="bottom", size=size, color=colour, weight=weight, zorder=9)

    def legend(self, entries: Sequence[tuple[str, str, str]]) -> None:
        """Explain colours below the drawing: (text, colour, "line", "dot" or "patch")."""
        from matplotlib.lines import Line2D
        from matplotlib.patches import Patch

        handles: list[Any] = []
        for text, colour, kind in entries:
            if kind == "line":
                handles.append(Line2D([], [], color=colour, lw=2.6, label=text))
            elif kind == "dot":
                rim: dict[str, Any] = {"mec": INK, "mew": 0.9}
                handles.append(Line2D([], [], ls="", marker="o", mfc=colour, label=text, **rim))
            else:
                handles.append(Patch(facecolor=colour, edgecolor="none", label=text))
        self._legend = handles

    def png(self, width: float = 9.0, tallest: float = 8.0) -> bytes:
        """Return the picture, `width` inches wide or less and at most `tallest` inches high."""
        left, bottom, right, top = (
            pick(b[k] for b in self._seen) for k, pick in enumerate((min, min, max, max))
        )
        left, right, top = left - _MARGIN, right + _MARGIN, top + _MARGIN
        inch = min(width / (right - left), tallest / (top - bottom))
        top += self._head / inch
        # A narrow drawing gets paper beside it, for the scale bar and the legend below.
        needed = 2.0 + sum(max(1.45, 0.6 + 0.085 * len(h.get_label())) for h in self._legend)
        narrow = max(0.0, needed / inch - (right - left)) / 2
        left, right = left - narrow, right + narrow
        below = 0.42 / inch
        bottom -= _MARGIN + below
        self._scale_bar(left + _MARGIN, bottom + 0.2 / inch, right - left, inch)
        self._axes.set_xlim(left, right)
        self._axes.set_ylim(bottom, top)
        self._figure.set_size_inches((right - left) * inch, (top - bottom) * inch)
        if self._legend:
            self._axes.legend(
                handles=self._legend,
                loc="lower right",
                ncols=len(self._legend),
                frameon=False,
                fontsize=10,
                borderaxespad=0.15,
                handlelength=1.4,
                columnspacing=1.3,
            )
        self._figure.add_artist(_background(self._painted((left, bottom), 1 / (inch * _DPI))))
        stream = io.BytesIO()
        # No software name or date: equal pictures have equal bytes.
        self._figure.savefig(stream, format="png", dpi=_DPI, metadata={"Software": None})
        return stream.getvalue()

    def _painted(self, corner: tuple[float, float], pixel: float) -> NDArray[np.uint8]:
        box = self._figure.bbox
        return painted(self._rasters, corner, pixel, (int(box.height), int(box.width)))

    def _scale_bar(self, x: float, y: float, width: float, inch: float) -> None:
        length = next((step for step in (1, 2, 5, 10, 20, 50) if step > width / 9), 100)
        self.line([(x, y), (x + length, y)], INK, 2.2)
        self.caption(x + length + 0.08 / inch, y - 0.06 / inch, f"{length} m")


def _background(image: NDArray[np.uint8]) -> Any:
    """Return an artist that puts an image (rows, columns, 4), lowest row first, below the rest."""
    from matplotlib.artist import Artist

    class Background(Artist):
        def draw(self, renderer: Any) -> None:
            renderer.draw_image(renderer.new_gc(), 0, 0, image)

    artist = Background()
    artist.set_zorder(-1)
    return artist
