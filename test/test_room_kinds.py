"""Kinds of rooms from shape and neighbours, or from a classifier of one's own."""

from __future__ import annotations

import numpy as np
import pytest

from test.helpers_passages import shell, surfaces, wall_with_door
from topometric_ros.configuration import with_values
from topometric_ros.errors import ConfigurationError
from topometric_ros.extraction.config import extraction_preset
from topometric_ros.extraction.pipeline import extract
from topometric_ros.extraction.room_kinds import (
    GeometricClassifier,
    RoomClassifier,
    RoomView,
    join_corridors,
    load_classifier,
    room_kind,
    told,
    typical_width,
)


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


class Purposes(RoomClassifier):
    """Calls whatever is long a corridor, and other rooms halls: what a model might have learned."""

    def kind(self, room: RoomView) -> tuple[str, float]:
        long = max(room.floor.shape) > 3 * min(room.floor.shape)
        return ("corridor", 0.9) if long else ("hall", 0.7)


class Confused(GeometricClassifier):
    def kind(self, room: RoomView) -> tuple[str, float]:
        return "kitchen", 0.5


class Joining(Purposes):
    """Looks through doors too, as long as they have no lintel."""

    def same_corridor(self, first: RoomView, second: RoomView, opening: float) -> bool:
        return self.kind(first)[0] == self.kind(second)[0] == "corridor"


def _hall() -> np.ndarray:
    """Return a cloud of 24 m x 2 m cut by a wall with a door, and a square room beside it."""
    boxes = shell(0.0, 0.0, 24.0, 2.0, 0.0, 2.6) + shell(0.0, 2.3, 4.0, 6.3, 0.0, 2.6)
    return surfaces([*boxes, *wall_with_door(12.0, 0.0, 2.0, (0.6, 1.4), 2.6, 2.6)])


@pytest.mark.parametrize(
    ("classifier", "kinds"),
    [
        (GeometricClassifier(), ["room", "room", "room"]),
        (Purposes(), ["corridor", "corridor", "hall"]),
        (Joining(), ["corridor", "hall"]),
    ],
)
def test_an_own_classifier_tells_the_kinds_and_joins_the_cuts_of_a_corridor(
    classifier: RoomClassifier, kinds: list[str]
) -> None:
    rooms = extract(_hall(), extraction_preset("default"), classifier=classifier).map.rooms
    assert sorted(room.kind for room in rooms) == kinds


def test_a_classifier_is_named_in_the_configuration() -> None:
    assert isinstance(load_classifier("geometric"), GeometricClassifier)
    assert isinstance(load_classifier(f"{__name__}:Purposes"), Purposes)
    config = with_values(extraction_preset("default"), {"kinds.classifier": f"{__name__}:Purposes"})
    kinds = {room.kind for room in extract(_hall(), config).map.rooms}
    assert kinds == {"corridor", "hall"}


class Fragile:
    def __init__(self) -> None:
        raise RuntimeError("no network file")


@pytest.mark.parametrize(
    "name", ["nowhere", "nowhere:at_all", "math:pi", "math:none", "", f"{__name__}:Fragile"]
)
def test_what_is_no_classifier_is_refused_in_one_line(name: str) -> None:
    with pytest.raises(ConfigurationError, match=r"kinds\.classifier: expected") as caught:
        with_values(extraction_preset("default"), {"kinds.classifier": name})
    assert "\n" not in str(caught.value)


def test_a_classifier_that_names_no_known_kind_is_refused() -> None:
    with pytest.raises(ConfigurationError, match="kitchen"):
        told(Confused(), RoomView(np.ones((9, 9), bool), 0.1, np.zeros((0, 3))))


def test_three_cuts_of_a_corridor_become_one_and_the_room_beside_them_stays() -> None:
    regions = np.ones((120, 24), np.int32)
    regions[40:80], regions[80:] = 2, 3
    regions[:, 20:] = 4
    distance = np.minimum(np.arange(24) + 1.0, 24.0 - np.arange(24))[None] * np.ones((120, 1))
    distance[:, 19:21] = 1.0

    class Bold(Purposes):
        def kind(self, room: RoomView) -> tuple[str, float]:
            return ("corridor" if room.width > 1.0 else "room"), 1.0

    joined = join_corridors(regions, distance, 0.1, Bold())
    assert set(np.unique(joined[:, :20])) == {1}
    assert set(np.unique(joined[:, 20:])) == {4}
    assert join_corridors(regions, distance, 0.1, GeometricClassifier()) is regions
