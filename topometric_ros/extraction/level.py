"""Levelling a cloud by its floors: the tilt at which the most points lie in the fewest layers.

Floors and ceilings are the largest planes of a building, so the histogram of heights is sharpest
when they are level. Walls, stairs, ramps and sloped roofs blur it at any tilt and do not decide.
The same areas tell a cloud that lies on its side: then another axis has the largest layers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.extraction.errors import ExtractionError
from topometric_ros.extraction.quality import Finding
from topometric_ros.extraction.surfaces import (
    fit_planes,
    lean_of_walls,
    measure_surfaces,
    steepest_tilt,
)
from topometric_ros.voxels.grid import thin

_CELL = 0.1
"""One point is kept in each cell of this edge, so that areas count and not densities, m."""
_MOST_POINTS = 40_000
_LAYER = 0.05
"""Thickness of the layers that the search ends with, m."""
_FIT_BAND, _FIT_ROUNDS = 0.06, 4
"""How near to the largest layer's plane points count for its fit, m, and how often it is fitted."""
_COARSE_STEP, _COARSE_PART = 1.5, 4
"""The first pass: degrees between slopes, and one point in so many."""
_NOTICED_TILT = 0.5
"""Degrees from which a tilt that is left as it is is told."""
_EXTENT = 2.45
"""Side of a square over the root mean square distance of its points from the middle."""

_WARNED_TILT = 1.0
"""Degrees from which a tilt that is taken out is a warning and not a note."""
_MEASURABLE, _BUILT = 0.1, 0.5
"""Share of the points in measured blocks, and of those on thin surfaces, in any building."""
_CLEARLY_LARGER = 1.1
"""Factor from which another axis' largest layer tells that z is not up."""
_STILL_TILTED = 5.0
"""Degrees by which planes lean where the cloud is tilted more than what was looked for."""

_SMALLEST_LAYER = 0.5
"""Area in m² below which nothing is a floor, whatever axis points up."""


@dataclass(frozen=True)
class LevelConfig:
    """When a cloud counts as tilted or as lying on its side."""

    enabled: bool = parameter(True, "Level tilted clouds before anything is extracted.")
    largest_tilt: float = parameter(
        15.0, "Largest tilt that is looked for.", unit="deg", minimum=0.0, maximum=30.0
    )
    smallest_tilt: float = parameter(
        1.0,
        "Smaller tilts are left as they are, since real floors are that uneven.",
        unit="deg",
        minimum=0.0,
        maximum=10.0,
    )
    smallest_rise: float = parameter(
        0.4,
        "Smaller tilts are taken out all the same where they lift one end of the map this much.",
        unit="m",
        minimum=0.0,
        maximum=10.0,
    )
    trusted_tilt: float = parameter(
        1.5,
        "Floors are believed from this tilt on where no walls were seen that lean as well.",
        unit="deg",
        minimum=0.0,
        maximum=10.0,
    )
    gain: float = parameter(
        1.3, "Factor by which levelling must sharpen the layers.", minimum=1.0, maximum=10.0
    )
    check_up: bool = parameter(True, "Compare the floor with what other axes would take for one.")
    doubt: float = parameter(
        1.4, "Warn where another axis has a layer this much larger.", minimum=1.0, maximum=100.0
    )
    refusal: float = parameter(
        2.5, "Refuse where another axis has a layer this much larger.", minimum=1.0, maximum=100.0
    )
    refusal_area: float = parameter(
        60.0, "Refuse only where that layer has this area.", unit="m²", minimum=0.0
    )


@dataclass(frozen=True)
class Level:
    """How the input lies: `T_level_input` (4, 4) levels it by turning it by `tilt` (rad)."""

    T_level_input: NDArray[np.float64]
    tilt: float
    findings: tuple[Finding, ...]


def estimate_level(
    points: NDArray[np.float64], config: LevelConfig, cells: NDArray[np.float64] | None = None
) -> Level:
    """Find the transform that makes the floors level.

    Floors slope and drift warps them: two parts of one real building measured 0.3° and 0.7°. So
    small tilts are only taken out where they matter, and where the walls lean too.

    Parameters
    ----------
    points : (P, 3) float64, m, input frame, P > 0, thinned to 5 cm or less
    config : LevelConfig
    cells : (K, 3), the means of the points in cells of 0.1 m, if the caller has them

    Returns
    -------
    Level, the identity where the tilt is too small, levelling would sharpen too little or the
    walls stand upright

    Raises
    ------
    ExtractionError
        The layers perpendicular to another axis are so much larger that it must be the one up.
    """
    cells = thin(points, _CELL) if cells is None else cells
    slope = np.zeros(2)
    told: tuple[Finding, ...] = ()
    if config.enabled:
        slope, told = _believed(points, *_sharpest_slope(cells, config), config)
    tilt = float(np.arctan(np.hypot(*slope)))
    T = np.eye(4)
    if tilt > 0.0:
        T[:3, :3] = _levelling_rotation(slope)
        told = tilt_findings(tilt)
    if config.check_up:
        told = (*_doubt_of_up(_largest_layers(cells, T[2, :3]), config), *told)
    return Level(T, tilt, told)


def _believed(
    points: NDArray[np.float64], slope: NDArray[np.float64], gain: float, config: LevelConfig
) -> tuple[NDArray[np.float64], tuple[Finding, ...]]:
    """Return the slope that is to be taken out, and what to tell where it is left.

    `gain` is by how much taking it out would sharpen the layers.
    """
    none = np.zeros(2)
    R = _levelling_rotation(slope)
    tilt = float(np.degrees(np.arccos(min(1.0, R[2, 2]))))
    rise = _EXTENT * np.tan(np.radians(tilt)) * np.hypot(points[:, 0].std(), points[:, 1].std())
    if tilt < config.smallest_tilt and rise < config.smallest_rise:
        message = f"the floor seems tilted by {tilt:.1f}° and was left so"
        advice = f"set level.smallest_tilt, now {config.smallest_tilt:g}°, lower to level it"
        told = tilt >= _NOTICED_TILT and gain >= config.gain
        return none, ((Finding("tilt", "note", message, advice),) if told else ())
    before, after = lean_of_walls(points), lean_of_walls(points @ R.T)
    if before is not None and after is not None:
        if after < before:
            return slope, ()
        reason = "as the walls stand more upright like this"
    elif tilt >= config.trusted_tilt and gain >= config.gain:
        return slope, ()
    else:
        reason = "as no walls confirm it"
    if tilt < _NOTICED_TILT or gain < config.gain:
        return none, ()
    message = f"the floor seems tilted by {tilt:.1f}° and was left so, {reason}"
    advice = f"set level.trusted_tilt, now {config.trusted_tilt:g}°, lower to level it"
    return none, (Finding("tilt", "warning", message, "" if before is not None else advice),)


def tilt_findings(tilt: float) -> tuple[Finding, ...]:
    """Return what to tell of a cloud that was turned by `tilt` (rad) to be level."""
    if tilt == 0.0:
        return ()
    message = f"the floor is tilted by {np.degrees(tilt):.1f}°, so the cloud was levelled first"
    severity = "warning" if np.degrees(tilt) >= _WARNED_TILT else "note"
    return (Finding("tilt", severity, message, "set level.enabled to false to take it as it is"),)


def no_floor(points: NDArray[np.float64], config: LevelConfig) -> ExtractionError:
    """Return the error for a cloud (P, 3) in which nothing has headroom above it."""
    layers = _largest_layers(thin(points, _CELL), np.array([0.0, 0.0, 1.0]))
    axis = "xy"[int(np.argmax(layers[:2]))]
    if max(layers) < _SMALLEST_LAYER:
        x, y, z = np.ptp(points, axis=0)
        return ExtractionError(
            f"no floor found with z up or any other axis: the cloud spans {x:.3g} m x {y:.3g} m x "
            f"{z:.3g} m; is it in metres (--scale)? If it is, name the axis that points up with "
            "--up"
        )
    planes = fit_planes(points)
    surfaces = measure_surfaces(planes)
    if surfaces.measured >= _MEASURABLE and surfaces.flat < _BUILT:
        return ExtractionError(
            f"no floor found: only {surfaces.flat:.0%} of the points lie on thin surfaces, in "
            "buildings most do; is it a building, seen without much noise?"
        )
    if surfaces.straight < _BUILT and np.degrees(steepest_tilt(planes)) > _STILL_TILTED:
        return ExtractionError(
            f"no floor found with z up: the cloud seems tilted by more than level.largest_tilt, "
            f"now {config.largest_tilt:g}°; set it higher (30° at most) or turn the cloud"
        )
    if max(layers[:2]) < _CLEARLY_LARGER * layers[2]:
        return ExtractionError(
            f"no floor found with z up (largest level {layers[2]:.0f} m²): is it indoors? "
            "Name the axis that points up with --up x or --up y if it is not z"
        )
    return ExtractionError(f"no floor found with z up; {'; '.join(_up_hint(axis, layers))}")


def _up_hint(axis: str, layers: tuple[float, float, float]) -> tuple[str, str]:
    area = layers["xyz".index(axis)]
    message = (
        f"the floor looks perpendicular to {axis} (largest layer {area:.0f} m², perpendicular to "
        f"z {layers[2]:.0f} m²)"
    )
    return message, f"use --up {axis}, or --up=-{axis} if it then stands on its head"


def _doubt_of_up(layers: tuple[float, float, float], config: LevelConfig) -> tuple[Finding, ...]:
    """Return a warning where another axis is likelier up.

    Raises
    ------
    ExtractionError
        It is much likelier.
    """
    axis = "xy"[int(np.argmax(layers[:2]))]
    area = max(layers[:2])
    if area >= config.refusal * layers[2] and area >= config.refusal_area:
        raise ExtractionError(f"no floor found with z up; {'; '.join(_up_hint(axis, layers))}")
    if area < config.doubt * layers[2]:
        return ()
    return (Finding("up_axis", "warning", *_up_hint(axis, layers)),)


def _levelling_rotation(slope: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the smallest rotation (3, 3) that turns planes z = slope · (x, y) level."""
    normal = np.array([-slope[0], -slope[1], 1.0])
    x, y, z = normal / np.linalg.norm(normal)
    # Rodrigues' formula for the turn of (x, y, z) into (0, 0, 1).
    return np.array(
        [
            [1 - x * x / (1 + z), -x * y / (1 + z), -x],
            [-x * y / (1 + z), 1 - y * y / (1 + z), -y],
            [x, y, z],
        ]
    )


def _largest_layers(
    cells: NDArray[np.float64], up: NDArray[np.float64]
) -> tuple[float, float, float]:
    """Return the areas (m²) of the largest layers perpendicular to x, y and `up`.

    `cells` holds one point of each 0.1 m cell; a layer is three cells thick.
    """
    areas = []
    for heights in (cells[:, 0], cells[:, 1], cells @ up):
        bins = np.floor(heights / _CELL + 0.5).astype(np.int64)
        counts = np.bincount(bins - bins.min())
        areas.append(float(np.convolve(counts, np.ones(3)).max() * _CELL**2))
    return areas[0], areas[1], areas[2]


def _sharpest_slope(
    cells: NDArray[np.float64], config: LevelConfig
) -> tuple[NDArray[np.float64], float]:
    """Return the slope (2,) of the floors, and by what factor levelling would sharpen them.

    Searched from coarse to fine, layers as thick as a step of the search moves the points; then a
    plane is fitted to the largest layer.
    """
    stride = -(-len(cells) // _MOST_POINTS)
    sample = cells[::stride] - np.median(cells, axis=0)
    span = float(np.sqrt((sample[:, :2] ** 2).sum(1).mean())) + _LAYER
    step, limit = np.radians(_COARSE_STEP), np.radians(config.largest_tilt)
    side = np.arange(-np.floor(limit / step), np.floor(limit / step) + 1) * step
    grid = np.stack(np.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 2)
    within = grid[np.hypot(grid[:, 0], grid[:, 1]) <= limit + 1e-9]
    # Layers are thick at first, and a part of the points tells them as well.
    slope = _best(np.ascontiguousarray(sample[::_COARSE_PART]), within, span * step / 2)
    while span * step > _LAYER / 2:
        step /= 3
        side = np.arange(-3, 4) * step
        around = np.stack(np.meshgrid(side, side, indexing="ij"), -1).reshape(-1, 2)
        slope = _best(sample, slope + around, span * step / 2)
    slope = _fitted(sample, slope)
    before = _sharpness(sample, 0.0, 0.0, _LAYER)
    after = _sharpness(sample, slope[0], slope[1], _LAYER)
    return slope, after / max(before, 1e-12)


def _best(
    points: NDArray[np.float64], slopes: NDArray[np.float64], layer: float
) -> NDArray[np.float64]:
    """Return the slope of sharpest layers; of equal ones the smallest tilt."""
    slopes = slopes[np.lexsort((slopes[:, 1], slopes[:, 0], (slopes**2).sum(1)))]
    layer = max(layer, _LAYER)
    scores = [_sharpness(points, a, b, layer) for a, b in slopes]
    return np.asarray(slopes[int(np.argmax(scores))])


def _fitted(points: NDArray[np.float64], slope: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the slope of the plane through the largest layer, by least squares."""
    heights = (points[:, 2] - points[:, :2] @ slope) / _LAYER
    bins = np.floor(heights).astype(np.int64)
    counts = np.convolve(np.bincount(bins - bins.min()), np.ones(2))
    level = (int(np.argmax(counts)) + bins.min()) * _LAYER
    plane = np.array([slope[0], slope[1], level])
    design = np.column_stack([points[:, :2], np.ones(len(points))])
    for _ in range(_FIT_ROUNDS):
        near = np.abs(points[:, 2] - design @ plane) < _FIT_BAND
        if np.count_nonzero(near) < 3:
            break
        plane = np.linalg.lstsq(design[near], points[near, 2], rcond=None)[0]
    return plane[:2]


@njit(cache=True, nogil=True)
def _sharpness(points, slope_x, slope_y, layer):  # type: ignore[no-untyped-def]
    """Sum of squares of the histogram of heights above a plane, points shared by two bins."""
    count = len(points)
    heights = np.empty(count)
    scale = 1.0 / np.sqrt(1.0 + slope_x * slope_x + slope_y * slope_y) / layer
    low, high = np.inf, -np.inf
    for i in range(count):
        heights[i] = (points[i, 2] - slope_x * points[i, 0] - slope_y * points[i, 1]) * scale
        low, high = min(low, heights[i]), max(high, heights[i])
    histogram = np.zeros(int(high - low) + 2)
    for i in range(count):
        position = heights[i] - low
        bin_below = int(position)
        part = position - bin_below
        histogram[bin_below] += 1.0 - part
        histogram[bin_below + 1] += part
    total = 0.0
    for value in histogram:
        total += value * value
    return total / (float(count) * float(count))
