"""Pictures of maps seen from above: one agent's, or the global map.

Each function returns PNG bytes, the same for the same input. Maps are turned so that most walls
run along the page.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.alignment import GlobalMap
from topometric_ros.topometric_map import NO_ROOM, TopometricMap
from topometric_ros.visualization.change_marks import draw_changes
from topometric_ros.visualization.page import number
from topometric_ros.visualization.plan import Plan, main_direction, storey_plans
from topometric_ros.visualization.sheet import (
    INK,
    Pose,
    Sheet,
    plan_bounds,
)
from topometric_ros.visualization.view import ViewError
from topometric_ros.voxels.palette import agent_colour

GAP = 1.2
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
    plans = draw_map(sheet, topometric_map)
    return sheet.png(width=6.0 + 2.0 * (len(plans) > 1)) if plans else None


def global_figure(
    global_map: GlobalMap, agents: Sequence[str], placed: Sequence[str]
) -> bytes | None:
    """Draw the global map; what each agent saw is outlined in the agent's colour.

    What has changed between their visits is filled, see :mod:`change_marks`.
    `agents` names the bits of `global_map.agents`, `placed` those of them that are in the map.
    """
    sheet = Sheet()
    plans = draw_map(sheet, global_map.map)
    shown = {k: name for k, name in enumerate(agents) if name in placed}
    for plan, pose in plans:
        for rank, k in enumerate(shown):
            seen = (global_map.agents >> np.uint32(k) & 1).astype(bool)
            mask, origin = _extent(global_map.map, seen, plan)
            # Each line lies a little outside the last one, so that none hides another.
            mask = ndimage.binary_dilation(mask, iterations=1 + 2 * rank)
            sheet.outline(mask, origin, plan.cell, pose, hex_colour(agent_colour(k)), 2.4)
    legend = [(name, hex_colour(agent_colour(k)), "line") for k, name in shown.items()]
    sheet.legend([*legend, *draw_changes(sheet, global_map.changes, global_map.map, plans)])
    return sheet.png(width=10.0) if plans else None


def draw_map(sheet: Sheet, topometric_map: TopometricMap) -> list[tuple[Plan, Pose]]:
    """Draw all storeys of a map side by side; returns where they lie."""
    plans = storey_plans(topometric_map)
    upright = Pose(angle=-main_direction(topometric_map))
    poses = side_by_side(plans, upright)
    for plan, pose in zip(plans, poses, strict=True):
        draw_plan(sheet, plan, pose)
        _draw_graph(sheet, topometric_map, plan, pose)
        if len(plans) > 1:
            _storey_caption(sheet, plan, pose)
    return list(zip(plans, poses, strict=True))


def side_by_side(plans: Sequence[Plan], upright: Pose) -> list[Pose]:
    """Return the poses of storeys from left to right, in register with each other."""
    poses, shift = [], 0.0
    for k, plan in enumerate(plans):
        left, _, right, _ = plan_bounds(plan, upright)
        shift = shift - left if k else 0.0
        poses.append(upright.moved(shift, 0.0))
        shift += right + GAP
    return poses


def draw_paper(
    sheet: Sheet, m: TopometricMap, walls: str = INK
) -> Iterator[tuple[Plan, Pose, int]]:
    """Draw every storey grey; yields where it lies and its index in the map.

    Raises
    ------
    ViewError
        The map is empty.
    """
    plans = storey_plans(m)
    if not plans:
        raise ViewError("the map is empty")
    index = {storey.id: k for k, storey in enumerate(m.storeys)}
    poses = side_by_side(plans, Pose(angle=-main_direction(m)))
    for plan, pose in zip(plans, poses, strict=True):
        draw_plan(sheet, plan, pose, {}, walls)
        if len(plans) > 1:
            left, _, _, top = plan_bounds(plan, pose)
            floor = number(plan.storey.floor_z, 1, "m")
            sheet.caption(left, top, f"storey {plan.storey.id}, floor at {floor}")
        yield plan, pose, index[plan.storey.id]


def draw_plan(
    sheet: Sheet,
    plan: Plan,
    pose: Pose,
    colours: Mapping[int, Sequence[float]] | None = None,
    walls: str = INK,
) -> None:
    """Draw rooms and walls of a storey."""
    sheet.rooms(plan, pose, colours)
    layers = plan.storey.layers
    sheet.mask(layers.wall, layers.origin, layers.cell, pose, walls)
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
        sheet.number(place, str(room), number_size(topometric_map, room))


def number_size(topometric_map: TopometricMap, room: int) -> float:
    """Return the height of a room's number, points: small rooms get small ones."""
    return 8.0 if topometric_map.room_by_id(room).area >= 4.0 else 5.5


def _storey_caption(sheet: Sheet, plan: Plan, pose: Pose) -> None:
    left, _, _, top = plan_bounds(plan, pose)
    floor = number(plan.storey.floor_z, 1, "m")
    sheet.caption(left, top, f"storey {plan.storey.id}, floor at {floor}")


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
