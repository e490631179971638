"""Twin flats that only show as such where the pose was registered."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from test.helpers_matching import A_ROOMS, B_ROOMS, T_BUILDING_A, T_BUILDING_B, agent_map
from topometric_ros.alignment import AlignmentStatus
from topometric_ros.fusion import align as align_module
from topometric_ros.fusion.align import align
from topometric_ros.fusion.config import merge_preset
from topometric_ros.matching.evidence import Evidence, evaluate

DEFAULT = merge_preset("default")


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
