"""What people type and open that is not quite right: told in one line with the file and the way."""

from __future__ import annotations

import io
import json
import struct
import zlib
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from test.helpers import yaw_transform
from test.helpers_bags import START, cloud, flat, write_scan_bag
from topometric_ros.cli.main import main
from topometric_ros.fusion.poses import apply, matrix_lines
from topometric_ros.io import pointcloud2
from topometric_ros.io.bag_messages import CLOUD_TYPE
from topometric_ros.io.bag_writer import BagWriter
from topometric_ros.io.bags import Bag
from topometric_ros.io.clouds import CloudError, read_cloud


def told(arguments: Sequence[object], capsys: pytest.CaptureFixture[str]) -> str:
    """Return the one line that a command says before it ends with status 2."""
    try:
        status = main([str(argument) for argument in arguments])
    except SystemExit as end:
        status = end.code
    captured = capsys.readouterr()
    assert status == 2
    assert captured.err.count("\n") == 1
    return captured.err.strip()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the same flat upright and on its side, twice under one name, and a point."""
    folder = tmp_path_factory.mktemp("wrong")
    (folder / "other").mkdir()
    points = flat()
    for name in ("a", "other/a"):
        np.save(folder / name, points)
    np.save(folder / "down", points * (1, -1, -1))
    np.save(folder / "side", points[:, [0, 2, 1]] * (1, 1, -1))
    np.save(folder / "point", points[:1])
    return folder


def test_the_source_that_is_wrong_is_named(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    a, point = folder / "a.npy", folder / "point.npy"
    assert f"{point}: no floor found" in told(["merge", a, point, "-o", tmp_path], capsys)
    twice = told(["merge", a, folder / "other" / "a.npy", "-o", tmp_path], capsys)
    assert twice.endswith(f"left={a} right={folder / 'other' / 'a.npy'}")
    assert f"got the file {point}" in told(["extract", a, "-o", point], capsys)


def test_names_that_are_nearly_right_are_told(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "c.yaml").write_text("extraction: {voxelsize: 0.1, rooms: 2}\n")
    line = told(
        ["extract", folder / "a.npy", "-o", tmp_path, "--config", tmp_path / "c.yaml"], capsys
    )
    assert line.endswith("unknown parameter 'voxelsize'; did you mean voxel_size?")
    line = told(["simulate", "office:rooms=[3", "-o", tmp_path], capsys)
    assert "office:rooms=[3: rooms: not YAML" in line


def test_a_negative_axis_is_an_axis(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["extract", str(folder / "down.npy"), "--up", "-z", "-o", str(folder / "D")]) == 0
    assert "warning" not in capsys.readouterr().out


def test_what_the_maps_warn_of_is_told_by_a_merge_of_folders_and_files(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    extracted = folder / "A"
    assert main(["extract", str(folder / "a.npy"), "-o", str(extracted)]) == 0
    sources = [str(extracted), str(folder / "side.npy")]
    assert main(["merge", *sources, "-o", str(folder / "M")]) == 0
    out = capsys.readouterr().out
    assert "a: anchor" in out
    assert "warning: side: the floor looks perpendicular to y" in out


def test_a_printed_transform_serves_projected_coordinates_too() -> None:
    T = yaw_transform(0.3, (-494_959.579, 10_634_612.055, 288.17))
    copied = np.array([[float(word) for word in row.split()] for row in matrix_lines(T)])
    place = np.array([[412_345.0, 5_312_345.0, 12.0]])
    np.testing.assert_allclose(apply(copied, place), apply(T, place), atol=0.01, rtol=0)


def las(size: int = 400, **fields: int) -> bytearray:
    """Return the header of a LAS 1.2 file whose points begin at byte 227."""
    raw = bytearray(size)
    raw[:4] = b"LASF"
    raw[24:26] = b"\1\2"
    struct.pack_into("<HIIBH", raw, 94, 227, 227, 0, fields.get("kind", 0x83), 34)
    struct.pack_into("<I", raw, 107, fields.get("points", 1))
    return raw


@pytest.mark.parametrize(
    ("place", "chunks", "what"),
    [(300, 2**32 - 1, "one of 4294967295 chunks"), (396, 1, "none"), (-1, 0, "none"),
     (2**60, 0, "none")],
)  # fmt: skip
def test_a_laz_file_cannot_claim_more_chunks_than_it_has_bytes(
    tmp_path: Path, place: int, chunks: int, what: str
) -> None:
    """The library that reads them ends the process where it cannot take memory for its table."""
    pytest.importorskip("lazrs")
    raw = las()
    struct.pack_into("<q", raw, 227, place)
    if 0 <= place < 390:
        struct.pack_into("<II", raw, place, 0, chunks)
    (tmp_path / "a.laz").write_bytes(raw)
    with pytest.raises(CloudError, match=f"table of its chunks before byte 400, got {what}"):
        read_cloud(tmp_path / "a.laz")


def test_a_cloud_that_memory_cannot_hold_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    np.savez_compressed(tmp_path / "a.npz", points=np.zeros((1000, 3)))
    assert len(read_cloud(tmp_path / "a.npz").points) == 1000
    monkeypatch.setattr(pointcloud2, "_BYTES_OF_A_POINT", 1e12)
    with pytest.raises(CloudError, match=r"fits into memory .* got 1000 points"):
        read_cloud(tmp_path / "a.npz")


@pytest.mark.parametrize(
    "change",
    [
        lambda raw: raw.replace(b"'descr'", b"'descr(", 1),
        lambda raw: raw.replace(b"(4, 3)", b"(9" + b"9" * 30 + b", 3)", 1),
        lambda raw: raw.replace(b"}", b" ", 1),
    ],
)
def test_a_numpy_header_that_is_no_header_is_told(tmp_path: Path, change: object) -> None:
    file = io.BytesIO()
    np.save(file, np.zeros((4, 3)))
    (tmp_path / "a.npy").write_bytes(change(file.getvalue()))  # type: ignore[operator]
    with pytest.raises(CloudError, match=r"not a complete numpy file: .{1,300}"):
        read_cloud(tmp_path / "a.npy")


def test_what_a_damaged_file_holds_does_not_fill_the_screen(tmp_path: Path) -> None:
    (tmp_path / "a.xyz").write_bytes(b"x" * 50_000)
    header = b"FIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nPOINTS 1\nDATA " + b"binary" * 1000 + b"\n"
    (tmp_path / "b.pcd").write_bytes(header)
    for name in ("a.xyz", "b.pcd"):
        with pytest.raises(CloudError) as caught:
            read_cloud(tmp_path / name)
        assert len(str(caught.value)) < len(str(tmp_path)) + 400


def test_a_picture_of_more_pixels_than_memory_holds_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    plan = tmp_path / "plan.png"
    Image.new("1", (64, 64)).save(plan)
    raw = bytearray(plan.read_bytes())
    for size in (9_000, 2**31 - 1):
        struct.pack_into(">II", raw, 16, size, size)
        struct.pack_into(">I", raw, 29, zlib.crc32(raw[12:29]))
        plan.write_bytes(raw)
        assert f"{plan}: " in told(["simulate", plan, "-o", tmp_path], capsys)


def test_a_frame_that_is_not_above_the_scans_is_told_with_those_that_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    bag = write_scan_bag(tmp_path / "walk", flat())
    for command in ("extract", "replay"):
        line = told([command, bag, "-o", tmp_path / "out", "--map-frame", "nap"], capsys)
        assert line.endswith("expected nap above lidar on /tf, got lidar, base_link, odom, map")


def test_text_clouds_of_other_names_are_read_and_topics_of_files_are_not(
    folder: Path, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    (tmp_path / "a.csv").write_text("x;y;z\n1,5;2;3\n")
    (tmp_path / "a.pts").write_text("2\n1 2 3 -4 9 9 9\n5 6 7 0 9 9 9\n")
    assert read_cloud(tmp_path / "a.csv").points.tolist() == [[1.5, 2, 3]]
    assert read_cloud(tmp_path / "a.pts").points.tolist() == [[1, 2, 3], [5, 6, 7]]
    source = f"{folder / 'a.npy'}:/cloud"
    assert "a cloud file has no topics" in told(["extract", source, "-o", tmp_path], capsys)


def test_scans_without_their_transforms_are_not_taken_for_maps_in_silence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    walk, bare, maps = (tmp_path / name for name in ("walk", "bare", "maps"))
    write_scan_bag(walk, flat())
    with Bag(walk) as bag, BagWriter(bare) as out:
        out.add_topic("/scan_cloud", CLOUD_TYPE)
        for entry in bag.messages(["/scan_cloud"]):
            out.write("/scan_cloud", entry.time, entry.message)
    with BagWriter(maps) as out:
        out.add_topic("/cloud_map", CLOUD_TYPE)
        for count in (2, 1):
            out.write("/cloud_map", START + count, cloud(flat()[::count], "map", START + count))
    for bag_path, warned in ((walk, False), (bare, True), (maps, False)):
        assert main(["extract", str(bag_path), "-o", str(tmp_path / "out")]) == 0
        out_text = capsys.readouterr().out
        assert ("if they are single scans, /tf or /tf_static lacks lidar" in out_text) == warned


def test_a_damaged_model_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    model = tmp_path / "model.npz"
    arrays = {"V": np.zeros((3, 3)), "F": np.zeros((1, 3), int), "face_element": np.zeros(1, int)}
    room = {"storey": "0", "name": "a", "long": "", "z0": 0, "z1": 3}
    ring = [[0, 0], [1e300, 0], [0, 1]]
    truth = {"storeys": [["0", 0]], "rooms": [{**room, "polygon": [{"ext": ring, "holes": []}]}]}
    np.savez(model, element_type=np.array(["IfcWall"]), **arrays)
    for text, what in (
        (json.dumps({**truth, "links": []}), "room 0: expected a polygon in metres"),
        (json.dumps({**truth, "rooms": []}), "the model has no 'links'"),
        ("[" * 100_000, "maximum recursion depth"),
    ):
        model.with_suffix(".json").write_text(text)
        assert what in told(["simulate", model, "-o", tmp_path], capsys)
    model.write_bytes(model.read_bytes()[:200])
    assert f"{model}: cannot be read" in told(["simulate", model, "-o", tmp_path], capsys)
