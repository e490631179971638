"""Gaps of the navigable volume are closed where evidence says that floor was there (§6.1)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from test.helpers import box_room
from test.helpers_passages import shell, surfaces, wall_with_door
from test.helpers_voxels import as_set, block, grid_of
from topometric_ros.extraction.config import extraction_preset
from topometric_ros.extraction.floor_gaps import close_gaps
from topometric_ros.extraction.navigation import NavigationConfig, navigable_volume, unobstructed
from topometric_ros.extraction.pipeline import extract
from topometric_ros.extraction.storeys import StoreyHeights
from topometric_ros.voxels.grid import voxelise

CONFIG = NavigationConfig(keep="all", gap=1.0, roofed_gap=3.0)
STOREY = (StoreyHeights(0.0, 2.6, True),)
ROOM = voxelise(box_room((0, 0, 0), (6.0, 4.0, 2.6)), 0.1, np.zeros(3))[0].coords


def closed(*things, without=(), storeys=STOREY, config=CONFIG, way=None) -> set:
    """Return the cells that closing adds to a room of 6 m x 4 m with things in it."""
    cells = as_set(np.concatenate([ROOM, *things])) - as_set(
        np.concatenate([*without, np.zeros((0, 3), np.int32)])
    )
    grid = grid_of(np.array(sorted(cells), np.int32))
    free = unobstructed(grid, config)
    navigable = navigable_volume(grid, config, free)
    full = close_gaps(navigable, grid.coords[free], grid, storeys, config, way)
    assert as_set(navigable) <= as_set(full)
    return as_set(full) - as_set(navigable)


def test_a_hole_is_closed_with_floor_at_the_height_round_it() -> None:
    hole = block((20, 15, 0), (30, 25, 0))
    assert closed(without=(hole,)) == as_set(hole)
    assert closed(without=(hole,), config=NavigationConfig(keep="all")) == set()


def test_without_a_ceiling_only_narrow_holes_are_closed() -> None:
    wide, ceiling = block((10, 15, 0), (30, 25, 0)), block((0, 0, 26), (60, 40, 26))
    across = block((10, 2, 0), (30, 38, 0))
    assert closed(without=(wide,)) == as_set(wide)
    assert closed(without=(across,)) == as_set(across)
    assert closed(without=(across, ceiling)) == set()


@pytest.mark.parametrize("height", [4, 7, 9])
def test_beds_tables_and_the_floor_hidden_under_them_are_not_added(height: int) -> None:
    top, hidden = block((20, 10, height), (33, 27, height)), block((20, 10, 0), (33, 27, 0))
    added = closed(top, without=(hidden,))
    assert not added & as_set(np.concatenate([top, hidden]))


def test_what_lies_between_the_faces_of_a_wall_is_no_floor() -> None:
    faces = [block((x, 0, 0), (x, 40, 26)) for x in (28, 34)]
    within = block((29, 0, 0), (33, 40, 0))
    assert not closed(*faces, without=(within,)) & as_set(within)


def test_an_opening_through_which_the_storey_below_is_seen_stays_open() -> None:
    low, hole = block((0, 0, -30), (60, 40, -30)), block((20, 15, 0), (30, 25, 0))
    storeys = (StoreyHeights(-3.0, -0.3, True), *STOREY)
    assert not closed(low, without=(hole,), storeys=storeys) & as_set(hole)
    slab = block((0, 0, -3), (60, 40, -3))  # of a slab's lower face, floor was above
    assert as_set(hole) <= closed(low, slab, without=(hole,), storeys=storeys)


def test_a_few_specks_of_a_glass_pane_do_not_end_the_floor_and_a_wall_does() -> None:
    pane = block((30, 1, 1), (30, 39, 24))
    few = pane[np.random.default_rng(0).random(len(pane)) < 0.08]
    joined = closed(few)
    assert {(30, y, 0) for y in range(10, 14)} & joined
    assert closed(pane) == set()
    rail = block((30, 1, 8), (30, 39, 8))
    assert closed(rail) == set()


def test_where_the_sensor_went_there_is_floor_though_a_pane_seemed_closed() -> None:
    pane = block((30, 1, 1), (30, 39, 24))
    way = np.column_stack([np.arange(1.0, 5.0, 0.3), np.full(14, 2.0), np.full(14, 1.1)])
    added = closed(pane, way=way)
    assert {(30, 20, 0), (29, 20, 0), (31, 20, 0)} <= added
    assert max(abs(y - 20) for _, y, _ in added) <= 2


def test_pieces_of_floor_in_the_middle_of_a_room_count_once_floor_is_closed_up_to_them() -> None:
    ring = set(as_set(block((15, 10, 0), (45, 30, 0)))) - as_set(block((27, 17, 0), (33, 23, 0)))
    added = closed(without=(np.array(sorted(ring), np.int32),))
    assert as_set(block((15, 10, 0), (45, 30, 0))) <= added


def _two_rooms(rise: float, ramp: float, gap: tuple[float, float] | None) -> np.ndarray:
    """Return a cloud of two rooms, 8 m x 4 m, with a door, the right one `rise` m higher.

    A ramp or a threshold lies in the right room behind the door; no floor in x of `gap`.
    """
    boxes = shell(0.0, 0.0, 8.0, 4.0, 0.0, 2.8)[1:]
    points = surfaces([*boxes, *wall_with_door(3.9, 0.0, 4.0, (1.5, 2.5), 2.1, 2.8)], 0.04)
    x, y = (v.ravel() for v in np.meshgrid(np.arange(0, 8, 0.04), np.arange(0, 4, 0.04)))
    z = rise * np.clip((x - 4.0) / max(ramp, 1e-6), 0.0, 1.0)
    kept = np.ones(len(x), bool) if gap is None else (x < gap[0]) | (x > gap[1])
    kept &= ~((x > 3.9) & (x < 4.05) & ((y < 1.5) | (y > 2.5)))
    return np.concatenate([points, np.column_stack([x, y, z])[kept]])


@pytest.mark.parametrize(
    ("rise", "ramp", "gap"),
    [(0.0, 0.0, None), (0.03, 0.0, None), (0.05, 0.0, None), (0.2, 4.0, None), (0.3, 2.5, None)]
    + [(0.0, 0.0, (3.4, 4.3)), (0.05, 0.0, (3.6, 4.2)), (0.3, 2.5, (3.5, 4.4))],
)
def test_doors_with_thresholds_ramps_and_unseen_floor_join_two_rooms(rise, ramp, gap) -> None:
    found = extract(_two_rooms(rise, ramp, gap), extraction_preset("default")).map
    assert len(found.rooms) == 2
    assert [p.rooms for p in found.passages] == [(0, 1)]
    assert found.passages[0].position[0] == pytest.approx(4.0, abs=0.5)
    assert found.passages[0].width == pytest.approx(1.0, abs=0.25)


def test_floors_that_nothing_joins_are_kept_and_told_apart() -> None:
    points = _two_rooms(0.0, 0.0, None)
    door = surfaces([(3.9, 1.5, 0.0, 4.05, 2.5, 2.1)], 0.04)
    found = extract(np.concatenate([points, door]), extraction_preset("default"))
    assert found.map.passages == ()
    assert sorted(rooms for rooms, _ in found.quality.parts) == [(0,), (1,)]
    x = found.map.navigable[:, 0] * 0.1
    assert (x < 3.8).sum() > 1000
    assert (x > 4.2).sum() > 1000


def test_treads_on_which_the_stick_does_not_fit_are_added() -> None:
    """A ship's ladder: rises of 0.22 m, treads of 0.12 m, from a floor to the next at 2.7 m."""
    steps = [(4.0 + 0.12 * k, 0.22 * k + 0.22) for k in range(12)]
    boxes = [(x, 1.0, z - 0.03, x + 0.12, 2.0, z) for x, z in steps]
    lower = shell(0.0, 0.0, 8.0, 4.0, 0.0, 2.5)
    upper = shell(0.0, 0.0, 8.0, 4.0, 2.7, 5.2)
    points = surfaces([*lower, *upper], 0.04)
    over = (points[:, 2] > 2.4) & (points[:, 2] < 2.8)
    over &= (np.abs(points[:, 0] - 4.7) < 0.9) & (np.abs(points[:, 1] - 1.5) < 0.6)
    points = np.concatenate([points[~over], surfaces(boxes, 0.04)])
    config = extraction_preset("default")
    without = replace(config, navigation=replace(config.navigation, treads=False))
    heights = [
        {int(z) for i, j, z in extract(points, c).map.navigable if 40 <= i <= 54 and 10 <= j <= 20}
        for c in (config, without)
    ]
    assert len([z for z in heights[0] if 3 <= z <= 22]) >= 6
    assert heights[0] > heights[1]


def test_treads_outside_the_columns_where_one_can_stand_take_part() -> None:
    grid = grid_of(ROOM)
    standing = grid.coords[unobstructed(grid, CONFIG)]
    middle = standing[(standing[:, 0] >= 10) & (standing[:, 0] < 50)]
    full = close_gaps(standing, middle, grid, STOREY, CONFIG)
    assert as_set(standing) <= as_set(full)
