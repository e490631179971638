"""Pictures of two maps: one laid over the other, and side by side with their matches.

Each function returns PNG bytes, the same for the same input.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.alignment import Alignment
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.agreement import (
    AGREES,
    CONFLICTS,
    FREE,
    OWN,
    SAME_FLOOR,
    JudgedStorey,
    compare,
    level_transform,
)
from topometric_ros.visualization.figures import GAP, draw_plan, number_size
from topometric_ros.visualization.page import number
from topometric_ros.visualization.plan import Plan, main_direction, storey_plans
from topometric_ros.visualization.sheet import INK, Pose, Sheet, bounds_of, plan_bounds
from topometric_ros.voxels.palette import room_colours

CONFLICT_COLOUR = "#d1003f"


def overlay_figure(
    a: TopometricMap,
    b: TopometricMap,
    T_a_b: NDArray[np.float64],
    colours: tuple[str, str],
) -> bytes | None:
    """Lay map b over map a: walls in the agents' colours, dark where both, red in conflict.

    `T_a_b` (4, 4) m holds between the input frames. None where neither map has a storey.
    """
    storeys = compare(a, b, T_a_b)
    T_level = level_transform(a, b, T_a_b)
    upright = Pose(angle=-main_direction(a))
    sheet, right, drawn = Sheet(), 0.0, False
    for storey in storeys:
        poses = ((storey.a, upright, colours[0]), (storey.b, upright.after(T_level), colours[1]))
        parts = [(judged, pose, colour) for judged, pose, colour in poses if judged is not None]
        shown = [_judged_places(judged, pose) for judged, pose, _ in parts]
        places = np.concatenate(shown)
        if not len(places):
            continue
        left, bottom, end, top = bounds_of(places)
        shift = right - left if drawn else 0.0
        for judged, pose, colour in parts:
            _draw_judged(sheet, judged, pose.moved(shift, 0.0), colour)
        if len(storeys) > 1:
            sheet.caption(left + shift, top, f"floor at {number(storey.floor_z, 1, 'm')}")
        sheet.include((left + shift, bottom, end + shift, top))
        right, drawn = end + shift + GAP, True
    if not drawn:
        return None
    sheet.legend(
        [
            (f"walls of {a.agent}", colours[0], "patch"),
            (f"walls of {b.agent}", colours[1], "patch"),
            ("both agree", INK, "patch"),
            ("conflict", CONFLICT_COLOUR, "patch"),
        ]
    )
    return sheet.png(width=10.0)


def matches_figure(a: TopometricMap, b: TopometricMap, alignment: Alignment) -> bytes | None:
    """Draw two maps side by side with a line between the rooms held to be the same.

    Matched rooms have one colour in both maps. Storeys lie one above the other; where there is a
    transform, equal places lie at equal heights on the page.
    """
    plans_a, plans_b = storey_plans(a), storey_plans(b)
    if not plans_a or not plans_b:
        return None
    sheet = Sheet()
    poses_a, poses_b = _facing(a, b, plans_a, plans_b, alignment.T_a_b)
    tints = room_colours([match.room_a for match in alignment.matches]) / 255.0 * 0.7 + 0.3
    colours = [(float(red), float(green), float(blue)) for red, green, blue in tints]
    of_a = {m.room_a: c for m, c in zip(alignment.matches, colours, strict=True)}
    of_b = {m.room_b: c for m, c in zip(alignment.matches, colours, strict=True)}
    places_a = _draw_side(sheet, a, list(zip(plans_a, poses_a, strict=True)), of_a)
    places_b = _draw_side(sheet, b, list(zip(plans_b, poses_b, strict=True)), of_b)
    for match, colour in zip(alignment.matches, colours, strict=True):
        if match.room_a in places_a and match.room_b in places_b:
            ends = [places_a[match.room_a], places_b[match.room_b]]
            sheet.line(ends, np.array(colour) * 0.75, 2.0, order=7.5, casing=1.0)
    return sheet.png(width=11.0)


def _draw_side(
    sheet: Sheet,
    m: TopometricMap,
    placed: Sequence[tuple[Plan, Pose]],
    colours: Mapping[int, Sequence[float]],
) -> dict[int, NDArray[np.float64]]:
    """Draw one of two facing maps; returns where its rooms' numbers are."""
    places = {}
    for plan, pose in placed:
        draw_plan(sheet, plan, pose, colours)
        places.update({r: pose.apply(np.array([xy]))[0] for r, xy in plan.labels.items()})
    for room, place in places.items():
        sheet.number(place, str(room), number_size(m, room))
    bounds = [plan_bounds(plan, pose) for plan, pose in placed]
    sheet.caption(min(b[0] for b in bounds), max(b[3] for b in bounds), m.agent, size=12)
    return places


def _facing(
    a: TopometricMap,
    b: TopometricMap,
    plans_a: Sequence[Plan],
    plans_b: Sequence[Plan],
    T_a_b: NDArray[np.float64] | None,
) -> tuple[list[Pose], list[Pose]]:
    """Return where the storeys of two maps lie: a on the left, rows by the floors' heights."""
    pose_a, pose_b = Pose(angle=-main_direction(a)), Pose(angle=-main_direction(b))
    rise = plans_a[0].storey.floor_z - plans_b[0].storey.floor_z
    if T_a_b is not None:
        T_level = level_transform(a, b, T_a_b)
        pose_b, rise = pose_a.after(T_level), float(T_level[2, 3])
    if T_a_b is None:
        # Nothing relates the frames: put their lower edges level.
        down = _covered(plans_b, pose_b)[1] - _covered(plans_a, pose_a)[1]
        pose_b = pose_b.moved(0.0, -down)
    pose_b = pose_b.moved(_covered(plans_a, pose_a)[2] - _covered(plans_b, pose_b)[0] + 2 * GAP, 0)
    placed = [(plan.storey.floor_z, plan_bounds(plan, pose_a)) for plan in plans_a]
    placed += [(plan.storey.floor_z + rise, plan_bounds(plan, pose_b)) for plan in plans_b]
    shifts = _row_shifts(placed)
    count = len(plans_a)
    return (
        [pose_a.moved(0.0, shift) for shift in shifts[:count]],
        [pose_b.moved(0.0, shift) for shift in shifts[count:]],
    )


def _row_shifts(placed: Sequence[tuple[float, tuple[float, float, float, float]]]) -> list[float]:
    """Return how far up each of many drawings, (floor height, bounds) m, must go to lie in rows.

    Drawings of one floor share a row; rows are stacked from the lowest floor up.
    """
    shifts = [0.0] * len(placed)
    order = sorted(range(len(placed)), key=lambda i: placed[i][0])
    rows: list[list[int]] = []
    for i in order:
        if rows and placed[i][0] - placed[rows[-1][0]][0] < SAME_FLOOR:
            rows[-1].append(i)
        else:
            rows.append([i])
    height = 0.0
    for row in rows:
        bottom, top = min(placed[i][1][1] for i in row), max(placed[i][1][3] for i in row)
        for i in row:
            shifts[i] = height - bottom
        height += top - bottom + GAP
    return shifts


def _covered(plans: Sequence[Plan], pose: Pose) -> tuple[float, float, float, float]:
    """Return what plans laid on top of each other cover: left, bottom, right, top, m."""
    corners = [plan_bounds(plan, pose) for plan in plans]
    return bounds_of(np.array(corners).reshape(-1, 2))


def _judged_places(judged: JudgedStorey, pose: Pose) -> NDArray[np.float64]:
    """Return where the seen cells of a judged storey lie on the sheet: (n, 2) m."""
    layers = judged.layers
    return pose.apply(np.argwhere(judged.verdict > 0) * layers.cell + np.asarray(layers.origin))


def _draw_judged(sheet: Sheet, judged: JudgedStorey, pose: Pose, colour: str) -> None:
    """Draw one map of an overlay: its floor pale, its walls by verdict."""
    layers, verdict = judged.layers, judged.verdict
    conflict = ndimage.binary_dilation(verdict == CONFLICTS)
    for mask, tint, order in (
        (verdict == FREE, colour + "30", 1.0),
        (verdict == OWN, colour, 2.0),
        (verdict == AGREES, INK, 3.0),
        (conflict, CONFLICT_COLOUR, 4.0),
    ):
        sheet.mask(mask, layers.origin, layers.cell, pose, tint, order)
