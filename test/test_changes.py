"""Furniture that moved between two visits: the newest is kept, marked, and not doubled."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from test import helpers_matching
from test.helpers import moved, yaw_transform
from test.helpers_matching import PLAN, T_BUILDING_A, T_BUILDING_B, agent_map
from topometric_ros.alignment import (
    AgentPlacement,
    AgentStatus,
    Alignment,
    AlignmentStatus,
    MergeResult,
)
from topometric_ros.fusion.changes import told
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.fuse import FuseConfig, fuse
from topometric_ros.fusion.merge import merge
from topometric_ros.io.merge_files import write_merge_files
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.change_marks import draw_changes
from topometric_ros.visualization.figures import global_figure
from topometric_ros.visualization.plan import storey_plans
from topometric_ros.visualization.sheet import Pose, Sheet

HOUR = 3_600_000_000_000
TABLE = (0.8, 3.2, 1.2, 0.8, 0.8)
"""Where room 2's table stands on the second visit; on the first it stands 2.2 m along x."""


def visits(
    monkeypatch: pytest.MonkeyPatch, first: int, second: int
) -> tuple[TopometricMap, TopometricMap]:
    """Return the maps of two visits with stamps in ns, a's before b's."""
    a = agent_map("a", (0, 2), T_BUILDING_A)
    room = dataclasses.replace(PLAN[2], furniture=(TABLE,))
    monkeypatch.setitem(helpers_matching.PLAN, 2, room)
    b = agent_map("b", (0, 2), T_BUILDING_B, seed=1)
    return dataclasses.replace(a, stamp=first), dataclasses.replace(b, stamp=second)


def boxes(m: TopometricMap) -> tuple[int, int]:
    """Count the fused voxels at table height where the table stood and where it stands, in all."""
    points = moved(m.surface(), T_BUILDING_A)
    corner = np.array(PLAN[2].corner)
    counts = []
    for x in (3.0, 0.8):
        low = corner + (x - 0.05, 3.15)
        inside = np.all((points[:, :2] > low) & (points[:, :2] < low + (1.3, 0.9)), axis=1)
        counts.append(int((inside & (points[:, 2] > 0.35) & (points[:, 2] < 1.0)).sum()))
    return counts[0], counts[1]


def fused(a: TopometricMap, b: TopometricMap):  # type: ignore[no-untyped-def]
    T = np.linalg.inv(T_BUILDING_A) @ T_BUILDING_B
    return fuse([a, b], [np.eye(4), T], FuseConfig())


def test_a_table_that_moved_stands_where_it_was_seen_last(monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = visits(monkeypatch, 0, HOUR)
    result = fused(a, b)
    was, stands = boxes(result.map)
    assert was == 0
    assert stands > 100
    gone, appeared = sorted(result.changes, key=lambda c: not c.gone)
    assert (gone.holder, gone.witness, gone.gone) == (0, 1, True)
    assert (appeared.holder, appeared.gone, appeared.ordered) == (1, False, True)
    lines = told(result.changes, ["a", "b"])
    assert any("of a stand where b saw the bare floor (older" in line for line in lines)
    # The rasters have one table too.
    layers = result.map.storeys[0].layers
    assert not (layers.furniture & layers.bare).any()
    assert layers.furniture.sum() < 1.5 * b.storeys[0].layers.furniture.sum()


def test_the_older_visit_may_come_second(monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = visits(monkeypatch, HOUR, 0)
    was, stands = boxes(fused(a, b).map)
    assert was > 100
    assert stands == 0


def test_maps_of_one_time_are_marked_and_nothing_is_dropped(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    a, b = visits(monkeypatch, 0, HOUR // 3600)
    result = fused(a, b)
    assert min(boxes(result.map)) > 100
    assert [c.ordered for c in result.changes] == [False, False]
    T = np.eye(4)
    places = tuple(
        AgentPlacement(name, name, AgentStatus.ALIGNED, "", 0, T, T) for name in ("a", "b")
    )
    whole = MergeResult("global", places, (), result)
    write_merge_files(tmp_path, whole)
    written = (tmp_path / "changes.ply").read_bytes()
    assert b"element vertex %d" % sum(len(c.points) for c in result.changes) in written


def test_changes_are_drawn_on_the_storey_where_they_were_found(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    a, b = visits(monkeypatch, 0, HOUR)
    result = fused(a, b)
    plans = [(plan, Pose()) for plan in storey_plans(result.map)]
    drawn = draw_changes(Sheet(), result.changes, result.map, plans)
    assert [name for name, _, _ in drawn] == ["gone since", "new since"]
    unsure = [dataclasses.replace(change, ordered=False) for change in result.changes]
    drawn = draw_changes(Sheet(), unsure, result.map, plans)
    assert [name for name, _, _ in drawn] == ["seen by one only"]
    still = dataclasses.replace(result, changes=())
    pictures = [global_figure(x, ["a", "b"], ["a", "b"]) for x in (result, still)]
    assert pictures[0] != pictures[1]


def test_nothing_changes_where_nothing_moved() -> None:
    a = agent_map("a", (0, 2), T_BUILDING_A, noise=0.01)
    b = agent_map("b", (0, 2), T_BUILDING_B, noise=0.01, seed=1)
    b = dataclasses.replace(b, stamp=HOUR)
    off = yaw_transform(np.radians(0.2), (0.03, 0.03, 0.0))
    T = np.linalg.inv(T_BUILDING_A) @ T_BUILDING_B @ off
    assert fuse([a, b], [np.eye(4), T], FuseConfig()).changes == ()


def test_a_merge_tells_what_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    a, b = visits(monkeypatch, 0, HOUR)
    T = np.linalg.inv(T_BUILDING_A) @ T_BUILDING_B
    by_hand = Alignment(("a", "b"), AlignmentStatus.ACCEPTED, "set by hand", T, confidence=1.0)
    result = merge([a, b], MergeConfig(), fixed={("a", "b"): by_hand})
    assert any(w.startswith("changed: ") for w in result.warnings)
