"""The pictures of a merge, seen from above: maps, alignments, matches, the global map.

Each function returns PNG bytes, the same for the same input. Maps are turned so that most walls
run along the page.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.alignment import Alignment, GlobalMap
from topometric_ros.topometric_map import NO_ROOM, TopometricMap
from topometric_ros.visualization.agreement import (
    AGREES,
    CONFLICTS,
    FREE,
    OWN,
    JudgedStorey,
    compare,
    level_transform,
)
from topometric_ros.visualization.plan import Plan, main_direction, storey_plans
from topometric_ros.visualization.sheet import (
    INK,
    Pose,
    Sheet,
    bounds_of,
    plan_bounds,
)
from topometric_ros.voxels.palette import agent_colour, room_colours

CONFLICT_COLOUR = "#d1003f"
_GAP = 1.2
"""Between plans that lie side by side, m."""


def hex_colour(rgb: Sequence[int]) -> str:
    """Return `#rrggbb`.

    Examples
    --------
    >>> hex_colour((0, 119, 187))
    '#0077bb'
    """
    return "#" + "".join(f"{value:02x}" for value in rgb)


def map_figure(topometric_map: TopometricMap) -> bytes | None:
    """Draw each storey of a map with its rooms and topological graph; None where it is empty."""
    sheet = Sheet()
    plans = _draw_map(sheet, topometric_map)
    return sheet.png(width=6.0 + 2.0 * (len(plans) > 1)) if plans else None


def global_figure(
    global_map: GlobalMap, agents: Sequence[str], placed: Sequence[str]
) -> bytes | None:
    """Draw the global map; what each agent saw is outlined in the agent's colour.

    `agents` names the bits of `global_map.agents`, `placed` those of them that are in the map.
    """
    sheet = Sheet()
    plans = _draw_map(sheet, global_map.map)
    shown = {k: name for k, name in enumerate(agents) if name in placed}
    for plan, pose in plans:
        for rank, k in enumerate(shown):
            seen = (global_map.agents >> np.uint32(k) & 1).astype(bool)
            mask, origin = _extent(global_map.map, seen, plan)
            # Each line lies a little outside the last one, so that none hides another.
            mask = ndimage.binary_dilation(mask, iterations=1 + 2 * rank)
            sheet.outline(mask, origin, plan.cell, pose, hex_colour(agent_colour(k)), 2.4)
    sheet.legend([(name, hex_colour(agent_colour(k)), "line") for k, name in shown.items()])
    return sheet.png(width=10.0) if plans else None


def _draw_map(sheet: Sheet, topometric_map: TopometricMap) -> list[tuple[Plan, Pose]]:
    """Draw all storeys of a map side by side; returns where they lie."""
    plans = storey_plans(topometric_map)
    upright = Pose(angle=-main_direction(topometric_map))
    poses = _side_by_side(plans, upright)
    for plan, pose in zip(plans, poses, strict=True):
        _draw_plan(sheet, plan, pose)
        _draw_graph(sheet, topometric_map, plan, pose)
        if len(plans) > 1:
            _storey_caption(sheet, plan, pose)
    return list(zip(plans, poses, strict=True))


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
            sheet.caption(left + shift, top + 0.3, f"floor at {storey.floor_z:.1f} m")
        sheet.include((left + shift, bottom, end + shift, top + 0.6 * (len(storeys) > 1)))
        right, drawn = end + shift + _GAP, True
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

    Matched rooms have one colour in both; map b is turned as the alignment says.
    """
    plans_a, plans_b = storey_plans(a), storey_plans(b)
    if not plans_a or not plans_b:
        return None
    upright_a = Pose(angle=-main_direction(a))
    upright_b = Pose(angle=-main_direction(b))
    if alignment.T_a_b is not None:
        turned = upright_a.after(level_transform(a, b, alignment.T_a_b))
        upright_b = replace(turned, x=0.0, y=0.0)
    colours = np.round(room_colours([m.room_a for m in alignment.matches]) / 255.0 * 0.7 + 0.3, 4)
    sheet = Sheet()
    poses_a = _stacked(plans_a, upright_a, 0.0)
    end = max(plan_bounds(p, q)[2] for p, q in zip(plans_a, poses_a, strict=True))
    poses_b = _stacked(plans_b, upright_b, end + 2 * _GAP)
    places: list[dict[int, Any]] = []
    for m, plans, poses, key in (
        (a, plans_a, poses_a, "room_a"),
        (b, plans_b, poses_b, "room_b"),
    ):
        matched = {getattr(x, key): c for x, c in zip(alignment.matches, colours, strict=True)}
        labels = {}
        for plan, pose in zip(plans, poses, strict=True):
            _draw_plan(sheet, plan, pose, matched)
            labels.update({r: pose.apply(np.array([xy]))[0] for r, xy in plan.labels.items()})
        places.append(labels)
        for room, place in labels.items():
            sheet.number(place, str(room), _number_size(m, room))
        left, _, _, top = plan_bounds(plans[-1], poses[-1])
        sheet.caption(left, top + 0.4, m.agent, size=12)
        sheet.include((left, top, left, top + 1.0))
    for match, colour in zip(alignment.matches, colours, strict=True):
        if match.room_a in places[0] and match.room_b in places[1]:
            ends = [places[0][match.room_a], places[1][match.room_b]]
            sheet.line(ends, colour * 0.75, 2.0, order=7.5, casing=1.0)
    return sheet.png(width=11.0)


def _side_by_side(plans: Sequence[Plan], upright: Pose) -> list[Pose]:
    """Return the poses of storeys from left to right, in register with each other."""
    poses, shift = [], 0.0
    for k, plan in enumerate(plans):
        left, _, right, _ = plan_bounds(plan, upright)
        shift = shift - left if k else 0.0
        poses.append(upright.moved(shift, 0.0))
        shift += right + _GAP
    return poses


def _stacked(plans: Sequence[Plan], upright: Pose, left_edge: float) -> list[Pose]:
    """Return the poses of storeys one above the other, the lowest on the page's zero line."""
    poses, height = [], 0.0
    left = min(plan_bounds(plan, upright)[0] for plan in plans)
    for plan in plans:
        _, bottom, _, top = plan_bounds(plan, upright)
        poses.append(upright.moved(left_edge - left, height - bottom))
        height += top - bottom + _GAP
    return poses


def _draw_plan(sheet: Sheet, plan: Plan, pose: Pose, colours: dict[int, Any] | None = None) -> None:
    """Draw rooms and walls of a storey."""
    sheet.rooms(plan, pose, colours)
    layers = plan.storey.layers
    sheet.mask(layers.wall, layers.origin, layers.cell, pose, INK)
    sheet.include(plan_bounds(plan, pose))


def _draw_graph(sheet: Sheet, topometric_map: TopometricMap, plan: Plan, pose: Pose) -> None:
    """Draw the topological graph: rooms as numbers, passages as dots with lines to their rooms."""
    labels = {room: pose.apply(np.array([xy]))[0] for room, xy in plan.labels.items()}
    for passage in topometric_map.passages:
        here = [room for room in passage.rooms if room in labels]
        place = pose.apply(np.array([passage.position[:2]]))[0]
        for room in here:
            sheet.line([labels[room], place], "#22272e99", 1.1)
        if here:
            # A passage to another storey, a stair, is filled dark.
            sheet.dot(place, "#ffffff" if len(here) == len(passage.rooms) else INK, 4.5)
    for room, place in labels.items():
        sheet.number(place, str(room), _number_size(topometric_map, room))


def _number_size(topometric_map: TopometricMap, room: int) -> float:
    """Return the height of a room's number, points: small rooms get small ones."""
    return 8.0 if topometric_map.room_by_id(room).area >= 4.0 else 5.5


def _storey_caption(sheet: Sheet, plan: Plan, pose: Pose) -> None:
    left, bottom, right, top = plan_bounds(plan, pose)
    text = f"storey {plan.storey.id}, floor at {plan.storey.floor_z:.1f} m"
    sheet.caption(left, top + 0.3, text)
    sheet.include((left, bottom, right, top + 0.6))


def _extent(
    topometric_map: TopometricMap, seen: NDArray[np.bool_], plan: Plan
) -> tuple[NDArray[np.bool_], tuple[float, float]]:
    """Return where seen voxels (N,) lie on a storey, without slivers seen through doors.

    The mask has 12 spare cells on each side of the plan; its origin comes with it.
    """
    low = np.round((np.asarray(plan.origin) - topometric_map.origin[:2]) / plan.cell)
    cells = topometric_map.voxels[:, :2] - low.astype(np.int64)
    inside = ((cells >= 0) & (cells < plan.rooms.shape)).all(axis=1)
    on_storey = inside & np.isin(topometric_map.room, [*plan.labels, NO_ROOM])
    mask = np.zeros(plan.rooms.shape, dtype=bool)
    mask[tuple(cells[on_storey & seen].T)] = True
    disk = np.hypot(*np.mgrid[-5:6, -5:6]) <= 5.2
    mask = ndimage.binary_closing(np.pad(mask, 12), disk)
    mask = _large_parts(ndimage.binary_opening(ndimage.binary_fill_holes(mask), disk))
    return mask, (plan.origin[0] - 12 * plan.cell, plan.origin[1] - 12 * plan.cell)


def _large_parts(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Drop the parts of a mask that are smaller than a tenth of its largest."""
    parts, count = ndimage.label(mask)
    sizes = np.bincount(parts.ravel(), minlength=count + 1)
    sizes[0] = 0
    kept: NDArray[np.bool_] = (sizes >= 0.1 * max(1, sizes.max()))[parts] & mask
    return kept


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
