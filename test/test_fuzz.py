"""Messages made to be wrong: whatever arrives is refused in words or is a map that can be used.

`make soak` runs many more cases (TOPOMETRIC_FUZZ_CASES) than `make test`.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
from typing import Any

import numpy as np
import pytest
import zstandard
from hypothesis import given, settings
from hypothesis import strategies as st

from test.helpers_io import random_map
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.io.bag_messages import CLOUD_TYPE, MAP_TYPE, message_classes, typestore
from topometric_ros.io.pointcloud2 import CloudError, points_from_message
from topometric_ros.runtime.cloud_message import map_cloud
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.message_codec import CodecError, map_from_message, map_to_message

CASES = int(os.environ.get("TOPOMETRIC_FUZZ_CASES", "100"))

fuzz = settings(max_examples=CASES, derandomize=CASES <= 100, database=None)

COUNTS = st.sampled_from((0, 1, 2, 3, 255, 2**16, 2**26, 2**26 + 1, 2**31 - 1, 2**31, 2**32 - 1))
SMALL = st.sampled_from((-(2**31), -2, -1, 0, 1, 3, 7, 2**31 - 1))
REALS = st.sampled_from(
    (float("nan"), float("inf"), -float("inf"), 0.0, -1.0, 1e-300, 1e-9, 1e9, 1e30, 1e308)
) | st.floats(-1e6, 1e6)


def bomb(size: int) -> bytes:
    """Return a small frame that says it holds `size` zeros, and does."""
    return zstandard.ZstdCompressor(level=1, write_content_size=True).compress(bytes(size))


BOMB = bomb(1 << 24)


def damaged(raw: bytes, draw: Any) -> bytes:
    """Return packed bytes cut short, turned over, or replaced."""
    kind = draw(st.sampled_from(("cut", "flip", "noise", "none", "bomb", "zeros")))
    if kind == "cut":
        return raw[: draw(st.integers(0, len(raw)))]
    if kind == "flip" and raw:
        data = bytearray(raw)
        for _ in range(draw(st.integers(1, 8))):
            data[draw(st.integers(0, len(data) - 1))] ^= 1 << draw(st.integers(0, 7))
        return bytes(data)
    if kind == "noise":
        return draw(st.binary(max_size=200))
    if kind == "zeros":
        return bomb(draw(st.integers(0, 5000)))
    return BOMB if kind == "bomb" else b""


def strange(value: Any, draw: Any) -> Any:
    """Return something of a field's own type that is unlikely to be right."""
    if isinstance(value, bool):
        return not value
    if isinstance(value, int):
        return draw(SMALL if value < 0 else SMALL.filter(lambda n: n >= 0) | COUNTS)
    if isinstance(value, float):
        return draw(REALS)
    if isinstance(value, str):
        return draw(st.text(max_size=20) | st.sampled_from(("", "room", "door", "x" * 10_000)))
    if isinstance(value, np.ndarray) and value.dtype == np.uint8:
        return np.frombuffer(damaged(value.tobytes(), draw), np.uint8)
    if isinstance(value, np.ndarray) and value.dtype.kind == "f" and value.size:
        changed = value.copy()
        changed[draw(st.integers(0, value.size - 1))] = np.float64(draw(REALS)).astype(value.dtype)
        return changed
    if isinstance(value, list) and value:
        kind = draw(st.sampled_from(("none", "twice", "last")))
        return {"none": [], "twice": [*value, value[0]], "last": value[-1:]}[kind]
    return value


def spoil(message: Any, draw: Any) -> None:
    """Change one field of a message, however deep it lies."""
    while True:
        names = [field.name for field in dataclasses.fields(message) if field.name[0] != "_"]
        name = draw(st.sampled_from(sorted(names)))
        value = getattr(message, name)
        if dataclasses.is_dataclass(value):
            message = value
        elif isinstance(value, list) and value and draw(st.booleans()):
            message = value[draw(st.integers(0, len(value) - 1))]
            if not dataclasses.is_dataclass(message):
                return
        else:
            with np.errstate(over="ignore"):
                setattr(message, name, strange(value, draw))
            return


def spoilt_map(draw: Any, seed: int = 0) -> Any:
    message = map_to_message(random_map(seed), message_classes())
    for _ in range(draw(st.integers(1, 3))):
        spoil(message, draw)
    return message


@fuzz
@given(data=st.data())
def test_a_spoilt_map_message_is_refused_in_words_or_is_a_map(data: Any) -> None:
    message = spoilt_map(data.draw)
    try:
        received = map_from_message(message)
    except CodecError:
        return
    assert np.isfinite(received.map.centres()).all()


@fuzz
@given(data=st.data())
def test_a_spoilt_cloud_is_refused_in_words_or_has_finite_points(data: Any) -> None:
    m = random_map(0, voxels=60)
    message = map_cloud(m, message_classes(), m.stamp)
    for _ in range(data.draw(st.integers(1, 3))):
        spoil(message, data.draw)
    try:
        points, dropped = points_from_message(message)
    except CloudError:
        return
    assert np.isfinite(points).all()
    assert len(points) + dropped == message.height * message.width


@fuzz
@given(data=st.data(), kind=st.sampled_from((MAP_TYPE, CLOUD_TYPE)))
def test_noise_in_the_serialized_bytes_is_refused_in_words(data: Any, kind: str) -> None:
    """What the bags' reader makes of damaged bytes is an error, or a message for the codec."""
    m = random_map(0, voxels=60)
    message = (
        map_to_message(m, message_classes())
        if kind == MAP_TYPE
        else map_cloud(m, message_classes(), m.stamp)
    )
    raw = bytearray(typestore().serialize_cdr(message, kind))
    for _ in range(data.draw(st.integers(1, 4))):
        raw[data.draw(st.integers(4, len(raw) - 1))] = data.draw(st.integers(0, 255))
    del raw[data.draw(st.integers(4, len(raw))) :]
    try:
        spoilt = typestore().deserialize_cdr(bytes(raw), kind)
    except Exception:
        return  # not ours: `io/bags.py` turns what the library raises into one line
    with contextlib.suppress(CodecError, CloudError):
        map_from_message(spoilt) if kind == MAP_TYPE else points_from_message(spoilt)


@settings(fuzz, max_examples=max(CASES // 10, 10))
@given(data=st.data())
def test_a_spoilt_map_that_is_taken_costs_the_others_nothing(data: Any) -> None:
    message = spoilt_map(data.draw, seed=1)
    message.agent = "bad"
    try:
        bad = map_from_message(message).map
    except CodecError:
        return
    session = MergerSession(MergeConfig(), ["a", "b", "bad"])
    for agent in "ab":
        session.add_map(dataclasses.replace(random_map(0), agent=agent, frame_id=agent))
    session.add_map(bad)
    result = session.merge()
    placed = {place.id for place in result.agents if place.T_global_agent is not None}
    assert "a" in placed


@pytest.mark.parametrize("storeys", [1, 40])
def test_what_a_message_unpacks_to_is_bounded_in_all(storeys: int) -> None:
    """Each raster may be allowed by itself: together they must not fill the memory."""
    message = map_to_message(random_map(0), message_classes())
    side = 1 << 12
    packed = np.frombuffer(bomb(side * side // 8), np.uint8)
    one = message.storeys[0]
    layers = dataclasses.replace(
        one.layers, cells_x=side, cells_y=side, wall=packed, furniture=packed, free=packed,
        bare=packed,
    )  # fmt: skip
    message.rooms, message.passages, message.descriptors = [], [], []
    message.room_of_voxel = map_to_message(
        dataclasses.replace(
            random_map(0), room=np.full(len(random_map(0).voxels), -1, np.int32), rooms=(),
            passages=(), descriptors=(),
        ),
        message_classes(),
    ).room_of_voxel  # fmt: skip
    message.storeys = [dataclasses.replace(one, id=i, layers=layers) for i in range(storeys)]
    if storeys == 1:
        assert len(map_from_message(message).map.storeys) == 1
        return
    with pytest.raises(CodecError, match="raster cells"):
        map_from_message(message)
