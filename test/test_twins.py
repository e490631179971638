"""Twin flats: what may be one is never merged, also where it shows only when registered."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from test.helpers_evidence import at, good
from test.helpers_matching import A_ROOMS, B_ROOMS, T_BUILDING_A, T_BUILDING_B, agent_map
from topometric_ros.alignment import AlignmentStatus
from topometric_ros.fusion import align as align_module
from topometric_ros.fusion.align import align
from topometric_ros.fusion.config import merge_preset
from topometric_ros.fusion.furniture import Pieces
from topometric_ros.fusion.gates import VerificationConfig
from topometric_ros.fusion.twins import twin_doubt
from topometric_ros.fusion.verification import decide
from topometric_ros.matching.evidence import Evidence, evaluate

DEFAULT = merge_preset("default")
CONFIG = VerificationConfig()


def pieces(kept, moved, in_place=1.0):
    """Return what pieces tell that are fixed in both directions, with the walls round a share."""
    odds = kept * np.log(0.88 / 0.3) + moved * np.log(0.12 / 0.7)
    return Pieces(kept + moved, kept, odds, in_place * odds)


def test_a_pose_that_a_twin_flat_would_have_where_it_is_registered_is_ambiguous(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def of_a_twin(*args: Any) -> Evidence:
        moved = {"furniture_judged": 300, "furniture_conflict_cells": 6, "furniture_conflict": 0.02}
        return replace(evaluate(*args), free_share=0.95, free_floor=45.0, **moved)

    a = agent_map("a", A_ROOMS, T_BUILDING_A, noise=0.01)
    b = agent_map("b", B_ROOMS, T_BUILDING_B, noise=0.01, seed=1)
    # Judged rough by `judge`, and once more here.
    monkeypatch.setattr(align_module, "evaluate", of_a_twin)
    alignment = align(a, b, DEFAULT)
    assert alignment.status is AlignmentStatus.AMBIGUOUS
    assert "an identical flat would look the same" in alignment.reason
    assert alignment.confidence < 0.5
    assert alignment.T_a_b is None
    assert len(alignment.alternatives) >= 1


def test_a_flat_that_one_map_holds_whole_may_be_its_twin_where_furniture_differs():
    twin = {"free_share": 0.95, "furniture_judged": 400, "furniture_conflict_cells": 14}
    decision = decide([at(0.0, good(**twin, furniture_conflict=0.035))], CONFIG)
    assert decision.status is AlignmentStatus.AMBIGUOUS
    assert "an identical flat would look the same" in decision.reason
    assert decision.confidence < 0.5
    same = good(free_share=0.95, furniture_judged=400)
    assert decide([at(0.0, same)], CONFIG).status is AlignmentStatus.ACCEPTED
    floor = good(**twin, furniture_conflict=0.035, free_floor=150.0)
    assert decide([at(0.0, floor)], CONFIG).status is AlignmentStatus.ACCEPTED


@pytest.mark.parametrize(
    ("share", "floor", "cells", "judged"),
    [(0.5, 40.0, 35, 177), (0.9, 127.0, 18, 185), (0.69, 36.5, 9, 198), (0.95, 46.0, 1, 160)],
    ids=[
        "a flat furnished otherwise",
        "an identical storey",
        "most of a flat furnished alike",
        "a flat furnished alike but for a cell",
    ],
)
def test_where_furniture_differs_the_rest_must_stand_to_the_centimetre(share, floor, cells, judged):
    e = good(
        free_share=share, free_floor=floor, furniture_judged=judged,
        furniture_conflict_cells=cells, furniture_conflict=cells / judged,
    )  # fmt: skip
    assert twin_doubt(e, CONFIG, lambda: pieces(1, 1))
    assert not twin_doubt(e, CONFIG, lambda: pieces(9, 3))
    assert not twin_doubt(replace(e, free_share=0.3), CONFIG, lambda: pieces(1, 1))


def test_a_floor_furnished_otherwise_is_the_same_only_where_that_is_said():
    moved = good(
        free_share=0.6, free_floor=150.0, furniture_judged=400,
        furniture_conflict_cells=50, furniture_conflict=0.125,
    )  # fmt: skip
    assert twin_doubt(moved, CONFIG, lambda: pieces(1, 1))
    assert not twin_doubt(moved, replace(CONFIG, changed_furniture=True), lambda: pieces(1, 1))


def test_furniture_that_was_put_there_anew_is_a_twin_s_even_where_no_cell_conflicts():
    e = good(free_share=0.3, free_floor=90.0, furniture_judged=300)
    for anew in (pieces(3, 6), pieces(2, 3), pieces(0, 2)):
        told = twin_doubt(e, CONFIG, lambda found=anew: found)
        assert f"of {anew.fixed} pieces" in told
    drifted = pieces(3, 6, in_place=0.1)
    for as_before in (pieces(17, 5), pieces(1, 1), drifted, Pieces(0, 0)):
        assert not twin_doubt(e, CONFIG, lambda found=as_before: found)


def test_cupboards_that_stand_elsewhere_are_walls_in_conflict():
    strained = good(
        free_share=0.58, free_floor=47.0, wall_conflict=0.022, wall_conflict_cells=15
    )  # fmt: skip
    assert "no piece can be placed" in twin_doubt(strained, CONFIG, lambda: Pieces(0, 0))
    assert not twin_doubt(strained, CONFIG, lambda: pieces(4, 0))
    less = replace(strained, free_share=0.33)
    assert not twin_doubt(less, CONFIG, lambda: Pieces(0, 0))
    furniture = {"furniture_judged": 130, "furniture_conflict_cells": 25}
    both = replace(less, **furniture, furniture_conflict=0.19)
    assert twin_doubt(both, CONFIG, lambda: Pieces(0, 0))


def test_half_of_a_small_map_is_little_where_some_furniture_stands_elsewhere():
    half = {"free_share": 0.56, "free_floor": 25.0, "furniture_judged": 108}
    assert decide([at(0.0, good(**half))], CONFIG).status is AlignmentStatus.ACCEPTED
    moved = good(**half, furniture_conflict_cells=7, furniture_conflict=0.065)
    assert decide([at(0.0, moved)], CONFIG).status is AlignmentStatus.AMBIGUOUS


def test_a_small_map_within_another_may_be_part_of_a_twin():
    part = good(free_share=0.7, free_floor=30.0, furniture_judged=120)
    decision = decide([at(0.0, part)], CONFIG)
    assert decision.status is AlignmentStatus.AMBIGUOUS
    assert "only 30 m²" in decision.reason
    assert "let the smaller map grow" in decision.reason


def test_one_room_of_the_few_that_a_map_has_does_not_tell_twin_flats_apart():
    room = {"free_floor": 12.0, "furniture_judged": 76}
    decision = decide([at(0.0, good(**room, free_share=0.39))], CONFIG)
    assert decision.status is AlignmentStatus.AMBIGUOUS
    assert "only 12 m², at least 15 m² are needed" in decision.reason
    # Few cells of furniture are no proof against a pose, but here they count.
    for cells in (1, 5):
        little = {**room, "furniture_judged": 18, "furniture_conflict_cells": cells}
        moved = good(**little, furniture_conflict=cells / 18, free_share=0.2)
        assert decide([at(0.0, moved)], CONFIG).status is AlignmentStatus.AMBIGUOUS
    # Of a map with much more in it the rest speaks for the pose.
    assert decide([at(0.0, good(**room, free_share=0.2))], CONFIG).status is not decision.status
