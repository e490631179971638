"""Kinds of rooms from shape and neighbours."""

from __future__ import annotations

import numpy as np
import pytest

from topometric_ros.extraction.room_kinds import room_kind, typical_width


def test_the_typical_width_of_a_long_strip_is_about_its_width() -> None:
    assert typical_width(np.ones((20, 300), bool), 0.1) == pytest.approx(2.0, rel=0.12)
    assert typical_width(np.zeros((3, 3), bool), 0.1) == 0.0


@pytest.mark.parametrize(
    ("kind", "area", "width", "neighbours", "stairs"),
    [
        ("corridor", 36.0, 2.0, 10, 0),
        ("corridor", 9.3, 1.9, 6, 2),
        ("room", 14.0, 2.2, 1, 0),
        ("room", 20.0, 3.0, 3, 0),
        ("hall", 130.0, 7.5, 2, 0),
        ("stairwell", 37.0, 3.8, 6, 3),
        ("unknown", 0.0, 0.0, 2, 0),
    ],
)
def test_kinds(kind: str, area: float, width: float, neighbours: int, stairs: int) -> None:
    found, sure = room_kind(area, width, neighbours, stairs)
    assert found == kind
    assert (sure > 0.5) == (kind != "unknown")
