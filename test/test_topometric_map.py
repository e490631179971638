"""A topometric map whose parts contradict each other cannot be made."""

from dataclasses import replace

import numpy as np
import pytest

from topometric_ros.topometric_map import (
    Descriptors,
    MapError,
    Passage,
    Room,
    Storey,
    StoreyLayers,
    TopometricMap,
)


def two_room_map() -> TopometricMap:
    mask = np.zeros((4, 3), bool)
    box = ((0.0, 0.0, 0.0), (1.0, 1.0, 1.0))
    rooms = tuple(Room(i, 0, (0.5, 0.5, 0.5), box, 1, 0.01, False) for i in (0, 7))
    return TopometricMap(
        agent="robot1",
        session="s",
        sequence=1,
        frame_id="map",
        stamp=0,
        voxel_size=0.1,
        origin=(1.0, 2.0, 0.0),
        voxels=np.array([[0, 0, 0], [1, 0, 0]], np.int32),
        offsets=np.array([[0, 0, 0], [-2, 1, 0]], np.int8),
        room=np.array([0, 7], np.int32),
        navigable=np.zeros((0, 3), np.int32),
        viewpoints=np.zeros((0, 3), np.float32),
        rooms=rooms,
        passages=(Passage((0, 7), (0.5, 0.5, 0.0), 0.9),),
        storeys=(Storey(0, 0.0, None, StoreyLayers(0.1, (0.0, 0.0), mask, mask, mask, mask)),),
        descriptors=(Descriptors("engineered", 1, np.zeros((2, 9), np.float32)),),
    )


def test_centres_and_surface_lie_on_the_lattice_to_half_a_voxel():
    m = two_room_map()
    assert np.allclose(m.centres(), [[1.0, 2.0, 0.0], [1.1, 2.0, 0.0]])
    assert np.abs(m.surface() - m.centres()).max() <= 0.05


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"schema": "topometric-map/9"}, "topometric-map/9"),
        ({"agent": "a\nb"}, "agent: expected a name without control characters"),
        ({"frame_id": "\x1b[2Jmap"}, "frame_id"),
        ({"voxel_size": 0.0}, "voxel_size"),
        ({"origin": (np.nan, 0.0, 0.0)}, "origin"),
        ({"room": np.array([0, 3], np.int32)}, r"\[3\]"),
        ({"room": np.array([0], np.int32)}, "room"),
        ({"offsets": np.array([[0, 0, 0], [2, 0, 0]], np.int8)}, "-2..1"),
        ({"voxels": np.zeros((2, 3), np.int64)}, "int64"),
        ({"viewpoints": np.full((1, 3), np.inf, np.float32)}, "finite"),
        ({"T_level_input": np.zeros((4, 4))}, "rigid motion"),
        ({"T_level_input": np.diag([1.0, 1.0, -1.0, 1.0])}, "rigid motion"),
        ({"T_level_input": np.full((4, 4), np.nan)}, "rigid motion"),
        ({"storeys": (replace(two_room_map().storeys[0], floor_z=np.nan),)}, "finite heights"),
        ({"storeys": two_room_map().storeys * 2}, "unique"),
        ({"storeys": ()}, "storey"),
        ({"passages": (Passage((0, 9), (0.0, 0.0, 0.0), 1.0),)}, "9"),
        ({"passages": (Passage((0, 7), (0.0, 0.0, np.nan), 1.0),)}, "finite"),
        ({"descriptors": (Descriptors("d", 1, np.zeros((1, 2), np.float32)),)}, "descriptor d"),
    ],
)
def test_a_contradiction_is_refused_and_named(change, said):
    with pytest.raises(MapError, match=said):
        replace(two_room_map(), **change)


def test_an_unknown_room_is_named():
    with pytest.raises(MapError, match="no room 5"):
        two_room_map().room_by_id(5)
