"""A .tmap gives back every bit of a map, and a damaged one a sentence instead of a crash."""

from __future__ import annotations

import json
import tracemalloc
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from test.helpers_io import assert_same_map, random_map
from topometric_ros.io.map_files import (
    MapFileError,
    decode_map,
    encode_map,
    load_global_map,
    load_map,
    save_map,
)
from topometric_ros.io.ply import read_ply_points
from topometric_ros.io.summaries import map_summary, write_rooms_ply

WHOLE = encode_map(random_map())


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_a_map_round_trips_in_every_bit(tmp_path: Path, seed: int) -> None:
    original = random_map(seed)
    save_map(tmp_path / "a.tmap", original)
    assert_same_map(load_map(tmp_path / "a.tmap"), original)


def test_an_empty_map_round_trips() -> None:
    m = random_map()
    empty = replace(
        m,
        **{name: getattr(m, name)[:0] for name in ("voxels", "offsets", "room", "navigable")},
        viewpoints=m.viewpoints[:0],
        rooms=(),
        passages=(),
        storeys=(),
        descriptors=(),
        warnings=(),
    )
    assert_same_map(decode_map(encode_map(empty), "empty")[0], empty)


def test_a_global_map_keeps_who_saw_what(tmp_path: Path) -> None:
    m = random_map()
    seen = np.random.default_rng(0).integers(1, 1 << 32, len(m.voxels), dtype=np.uint32)
    save_map(tmp_path / "g.tmap", m, seen, ("robot1", "robot2"))
    back, observed_by, observers = load_global_map(tmp_path / "g.tmap")
    assert_same_map(back, m)
    np.testing.assert_array_equal(observed_by, seen)
    assert observers == ("robot1", "robot2")


def test_the_same_map_gives_the_same_bytes() -> None:
    assert encode_map(random_map()) == WHOLE


def test_an_unknown_version_is_named() -> None:
    newer = WHOLE[:4] + (9).to_bytes(2, "little") + WHOLE[6:]
    with pytest.raises(MapFileError, match=r"x\.tmap: \.tmap version 9 is not known"):
        decode_map(newer, "x.tmap")


def test_an_unknown_schema_is_named() -> None:
    with pytest.raises(MapFileError, match="unknown schema 'topometric-map/2'"):
        decode_map(with_header(schema="topometric-map/2"), "x.tmap")


def test_a_missing_file_and_another_kind_are_one_line(tmp_path: Path) -> None:
    with pytest.raises(MapFileError, match=r"a\.tmap: the file cannot be read: No such file"):
        load_map(tmp_path / "a.tmap")
    (tmp_path / "a.tmap").write_bytes(b"ply\n")
    with pytest.raises(MapFileError, match=r"expected a \.tmap file"):
        load_map(tmp_path / "a.tmap")


def test_an_older_file_stays_until_the_new_one_is_whole(tmp_path: Path) -> None:
    save_map(tmp_path / "a.tmap", random_map())
    with pytest.raises(MapFileError, match="cannot be written"):
        save_map(tmp_path / "missing" / "a.tmap", random_map())
    assert_same_map(load_map(tmp_path / "a.tmap"), random_map())
    assert [path.name for path in tmp_path.iterdir()] == ["a.tmap"]


@given(st.integers(0, len(WHOLE) - 1))
@settings(max_examples=60)
def test_a_truncated_file_is_refused(length: int) -> None:
    with pytest.raises(MapFileError):
        decode_map(WHOLE[:length], "cut.tmap")


@given(st.lists(st.tuples(st.integers(0, len(WHOLE) - 1), st.integers(0, 7)), min_size=1))
@settings(max_examples=150)
def test_flipped_bits_never_crash(flips: list[tuple[int, int]]) -> None:
    damaged = bytearray(WHOLE)
    for position, bit in flips:
        damaged[position] ^= 1 << bit
    try:
        result = decode_map(bytes(damaged), "flipped.tmap")[0]
    except MapFileError:
        return
    assert_same_map(result, random_map())


@pytest.mark.parametrize(
    "changes",
    [
        {"rooms": None},
        {"rooms": [{}]},
        {"rooms": []},
        {"stamp": "now"},
        {"voxel_size": -1},
        {"voxel_size": None},
        {"origin": [0, 0]},
        {"origin": [0, 0, 1e999]},
        {"T_level_input": [[1]]},
        {"sections": []},
        {"sections": 3},
        {"sections": [{"name": "voxels", "encoding": "coords", "shape": [1 << 50, 3], "bytes": 1}]},
        {"sections": [{"name": "room", "encoding": "array", "shape": [1 << 26, 1 << 26]}]},
        {"sections": [{"name": "a", "encoding": "array", "dtype": "O", "shape": [1], "bytes": 0}]},
        {
            "sections": [
                {"name": "a", "encoding": "array", "dtype": "i4", "shape": [-1], "bytes": -5}
            ]
        },
    ],
)
def test_a_header_that_lies_is_refused_without_taking_memory(changes: dict[str, object]) -> None:
    data = with_header(**changes)
    tracemalloc.start()
    with pytest.raises(MapFileError):
        decode_map(data, "lying.tmap")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert peak < 5e6


def test_the_summary_has_the_contract_s_keys() -> None:
    summary = json.loads(json.dumps(map_summary(random_map()), allow_nan=False))
    assert list(summary) == [
        *("schema", "agent", "frame_id", "voxel_size", "warnings", "T_level_input"),
        *("rooms", "passages", "storeys", "building"),
    ]
    assert list(summary["rooms"][0]) == [
        *("id", "storey", "centroid", "bounds", "voxels", "area", "isolated"),
        *("centre", "floor_area", "volume", "completeness", "frontier", "kind", "kind_confidence"),
    ]
    assert list(summary["passages"][0]) == [
        *("rooms", "position", "width", "height", "kind", "confidence"),
    ]


def test_the_summary_is_a_tree_of_building_storeys_and_rooms() -> None:
    m = random_map()
    upstairs = replace(m.rooms[1], storey=1)
    summary = map_summary(replace(m, rooms=(m.rooms[0], upstairs)))
    assert summary["building"]["storeys"] == [0, 1]
    assert summary["building"]["floor_area"] == 11.1
    assert summary["storeys"][0] == {
        **{"id": 0, "floor_z": 0.01, "ceiling_z": None},
        **{"rooms": [3], "links": [0]},
    }
    assert summary["storeys"][1]["rooms"] == [7]
    assert summary["storeys"][1]["links"] == [0]


def test_a_file_from_before_rooms_had_attributes_still_loads() -> None:
    size = int.from_bytes(WHOLE[6:10], "little")
    fields = json.loads(WHOLE[14 : 14 + size])
    old = {"rooms": ("centre", "floor_area", "volume", "completeness", "frontier")}
    old["rooms"] += ("kind", "kind_confidence")
    old["passages"] = ("height", "kind", "confidence")
    changes = {
        part: [{k: v for k, v in entry.items() if k not in names} for entry in fields[part]]
        for part, names in old.items()
    }
    m = decode_map(with_header(**changes), "old.tmap")[0]
    assert m.rooms[1].kind == "unknown"
    assert m.rooms[1].centre is None
    assert m.passages[0].height is None
    assert m.rooms_of(0) == (3, 7)


def test_rooms_ply_lies_in_the_frame_of_the_input(tmp_path: Path) -> None:
    m = random_map()
    write_rooms_ply(tmp_path / "rooms.ply", m)
    points = read_ply_points(tmp_path / "rooms.ply")
    T = m.T_level_input
    np.testing.assert_allclose(points @ T[:3, :3].T + T[:3, 3], m.centres(), atol=1e-12)
    header = (tmp_path / "rooms.ply").read_bytes().split(b"end_header")[0].decode()
    assert [line.split()[1:] for line in header.splitlines() if line.startswith("property")] == [
        *(["double", axis] for axis in "xyz"),
        ["int", "room"],
        *(["uchar", channel] for channel in ("red", "green", "blue")),
    ]


def with_header(**changes: object) -> bytes:
    """Return the whole file with fields of its header replaced and a checksum that fits."""
    size = int.from_bytes(WHOLE[6:10], "little")
    fields = json.loads(WHOLE[14 : 14 + size])
    header = json.dumps({**fields, **changes}).encode()
    prefix = WHOLE[:6] + len(header).to_bytes(4, "little")
    return prefix + zlib.crc32(header).to_bytes(4, "little") + header + WHOLE[14 + size :]
