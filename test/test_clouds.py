"""Every cloud format gives the same points, and every bad file one line that says what is wrong."""

from __future__ import annotations

import io
import os
import struct
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from test.helpers import SHARED_DATA, needs_shared_data
from topometric_ros.io.clouds import CloudError, read_cloud
from topometric_ros.io.ply import write_ply

POINTS = np.random.default_rng(3).normal(size=(20, 3)).astype(np.float32).astype(np.float64)


def ply(points: NDArray[np.float64], encoding: str = "binary_little_endian") -> bytes:
    """Return a PLY file of float vertices with a colour before and after."""
    header = f"ply\nformat {encoding} 1.0\ncomment made by a test\nelement vertex {len(points)}\n"
    header += "property uchar red\nproperty float x\nproperty float y\nproperty double z\n"
    header += "property uchar green\nelement face 0\nproperty list uchar int vertex_indices\n"
    body = b""
    if encoding == "ascii":
        body = "".join(f"7 {x:.9g} {y:.9g} {z:.9g} 8\n" for x, y, z in points).encode()
    else:
        order = "<" if "little" in encoding else ">"
        layout = [("r", "u1"), ("x", order + "f4"), ("y", order + "f4"), ("z", order + "f8")]
        table = np.zeros(len(points), [*layout, ("g", "u1")])
        for axis, name in enumerate("xyz"):
            table[name] = points[:, axis]
        body = table.tobytes()
    return (header + "end_header\n").encode() + body


def pcd(points: NDArray[np.float64], encoding: str = "binary") -> bytes:
    header = "# .PCD v0.7\nVERSION 0.7\nFIELDS x y z\nSIZE 4 4 4\nTYPE F F F\nCOUNT 1 1 1\n"
    header += f"WIDTH {len(points)}\nHEIGHT 1\nVIEWPOINT 0 0 0 1 0 0 0\nPOINTS {len(points)}\n"
    if encoding == "ascii":
        body = "".join(f"{x:.9g} {y:.9g} {z:.9g}\n" for x, y, z in points).encode()
    else:
        body = points.astype("<f4").tobytes()
    return f"{header}DATA {encoding}\n".encode() + body


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_ply_of_any_encoding_is_read(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "a.ply").write_bytes(ply(POINTS, encoding))
    cloud = read_cloud(tmp_path / "a.ply")
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-7)
    assert (cloud.dropped, cloud.warnings) == (0, ())


def test_a_ply_with_lists_among_its_vertices_is_read(tmp_path: Path) -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    header = "ply\nformat ascii 1.0\nelement vertex 2\nproperty list uchar int extra\n"
    header += "property float x\nproperty float y\nproperty float z\nend_header\n"
    (tmp_path / "odd.ply").write_text(header + "2 5 6 1 2 3\n1 5 4 5 6\n")
    np.testing.assert_array_equal(read_cloud(tmp_path / "odd.ply").points, [[1, 2, 3], [4, 5, 6]])


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_pcd_is_read(tmp_path: Path, encoding: str) -> None:
    pytest.importorskip("open3d", exc_type=ImportError)
    (tmp_path / "a.pcd").write_bytes(pcd(POINTS, encoding))
    np.testing.assert_allclose(read_cloud(tmp_path / "a.pcd").points, POINTS, atol=1e-6)


def test_numpy_and_text_files_are_read(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    np.savez(tmp_path / "a.npz", points=POINTS, other=np.zeros(3))
    np.savetxt(tmp_path / "a.xyz", np.hstack([POINTS, POINTS]), fmt="%.17g")
    np.savetxt(tmp_path / "a.txt", POINTS, fmt="%.17g", delimiter=",", header="x y z")
    for name in ("a.npy", "a.npz", "a.xyz", "a.txt"):
        np.testing.assert_array_equal(read_cloud(tmp_path / name).points, POINTS, err_msg=name)


@needs_shared_data
def test_a_laz_file_is_read() -> None:
    pytest.importorskip("laspy")
    cloud = read_cloud(SHARED_DATA / "scans" / "indoor.laz", up="y")
    assert len(cloud.points) == 808_042
    assert np.ptp(cloud.points[:, 2]) < np.ptp(cloud.points[:, :2], axis=0).min()


def test_a_missing_las_reader_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "laspy", None)
    (tmp_path / "a.las").write_bytes(b"LASF")
    with pytest.raises(CloudError, match=r'pip install "laspy\[lazrs\]"'):
        read_cloud(tmp_path / "a.las")


@pytest.mark.parametrize(("up", "column"), [("x", 0), ("y", 1), ("z", 2)])
def test_the_up_axis_becomes_z_by_a_rotation(tmp_path: Path, up: str, column: int) -> None:
    np.save(tmp_path / "a.npy", POINTS)
    cloud = read_cloud(tmp_path / "a.npy", up=up)
    np.testing.assert_array_equal(cloud.points[:, 2], POINTS[:, column])
    assert np.linalg.det(cloud.T_up_input) == pytest.approx(1)
    np.testing.assert_allclose(cloud.points, POINTS @ cloud.T_up_input[:3, :3].T)


@pytest.mark.parametrize("suffix", [".ply", ".npy", ".xyz"])
def test_points_that_are_not_finite_are_counted_in_a_warning(tmp_path: Path, suffix: str) -> None:
    damaged = np.vstack([POINTS, [[np.nan, 0, 0], [0, np.inf, 0]]])
    path = tmp_path / f"a{suffix}"
    write_any(path, damaged)
    cloud = read_cloud(path)
    assert cloud.dropped == 2
    assert cloud.warnings == ("2 of 22 points were not finite and were dropped",)
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-7)


def test_an_ascii_ply_with_infinite_points_keeps_the_others(tmp_path: Path) -> None:
    damaged = np.vstack([[[np.inf, 0, 0], [np.nan, np.nan, np.nan]], POINTS])
    (tmp_path / "a.ply").write_bytes(ply(damaged, "ascii"))
    cloud = read_cloud(tmp_path / "a.ply")
    assert cloud.dropped == 2
    np.testing.assert_allclose(cloud.points, POINTS, atol=1e-7)


@pytest.mark.parametrize("suffix", [".ply", ".pcd", ".npy", ".npz", ".xyz"])
def test_an_empty_cloud_is_an_error(tmp_path: Path, suffix: str) -> None:
    path = tmp_path / f"a{suffix}"
    write_any(path, np.empty((0, 3)))
    with pytest.raises(CloudError, match=r"the cloud is empty \(0 points\)"):
        read_cloud(path)


def test_a_cloud_without_a_finite_point_is_an_error(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.full((7, 3), np.nan))
    with pytest.raises(CloudError, match="none of the cloud's 7 points is finite"):
        read_cloud(tmp_path / "a.npy")


def test_a_missing_file_and_an_unknown_kind_are_errors(tmp_path: Path) -> None:
    with pytest.raises(CloudError, match="no such file"):
        read_cloud(tmp_path / "missing.ply")
    (tmp_path / "a.stl").write_bytes(b"solid")
    with pytest.raises(CloudError, match=r"expected a cloud file \(\.ply .*got '\.stl'"):
        read_cloud(tmp_path / "a.stl")
    with pytest.raises(CloudError, match=r"up: expected one of x, y, z, -x, .* got 'w'"):
        read_cloud(tmp_path / "a.stl", up="w")


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_a_truncated_ply_names_the_file_and_the_numbers(tmp_path: Path, encoding: str) -> None:
    whole = ply(POINTS, encoding)
    path = tmp_path / "cut.ply"
    path.write_bytes(whole[:-60])
    with pytest.raises(CloudError, match=r"cut\.ply: the PLY file.*(expected \d+.*got \d+|read)"):
        read_cloud(path)
    path.write_bytes(whole[:40])
    with pytest.raises(CloudError, match="ends early: expected a line end_header, got 40 bytes"):
        read_cloud(path)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_a_truncated_pcd_names_the_file_and_the_numbers(tmp_path: Path, encoding: str) -> None:
    (tmp_path / "cut.pcd").write_bytes(pcd(POINTS, encoding)[:-40])
    with pytest.raises(CloudError, match=r"cut\.pcd: the PCD file ends early: expected .*got \d+"):
        read_cloud(tmp_path / "cut.pcd")


@pytest.mark.parametrize("name", ["a.npy", "a.npz"])
def test_a_truncated_numpy_file_is_one_line(tmp_path: Path, name: str) -> None:
    (np.save if name == "a.npy" else np.savez)(tmp_path / name, POINTS)
    whole = (tmp_path / name).read_bytes()
    (tmp_path / name).write_bytes(whole[: len(whole) // 2])
    with pytest.raises(CloudError, match="not a complete numpy file") as caught:
        read_cloud(tmp_path / name)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content"),
    [
        ("a.ply", b"solid nothing"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex two\nend_header\n"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n1\n"),
        ("a.pcd", b"VERSION 0.7\nFIELDS x y z\n"),
        ("a.pcd", b"FIELDS x y z\nSIZE 4 4\nPOINTS 1\nDATA ascii\n1 2 3\n"),
        ("a.xyz", b"1 2\n3 4\n"),
        ("a.npy", b"not numpy"),
        ("a.las", b"not las"),
        ("a.laz", b"LASF" + b"\0" * 300),
    ],
)
def test_a_file_of_another_kind_is_one_line(tmp_path: Path, name: str, content: bytes) -> None:
    (tmp_path / name).write_bytes(content)
    with pytest.raises(CloudError) as caught:
        read_cloud(tmp_path / name)
    assert "\n" not in str(caught.value)


def write_any(path: Path, points: NDArray[np.float64]) -> None:
    """Write points in the format that the suffix names."""
    if path.suffix == ".ply":
        vertices = np.zeros(len(points), [(axis, "<f8") for axis in "xyz"])
        for axis, name in enumerate("xyz"):
            vertices[name] = points[:, axis]
        write_ply(path, vertices)
    elif path.suffix == ".pcd":
        path.write_bytes(pcd(points))
    elif path.suffix == ".xyz":
        np.savetxt(path, points)
    else:
        (np.save if path.suffix == ".npy" else np.savez)(path, points)


def test_a_compressed_pcd_is_read(tmp_path: Path) -> None:
    o3d = pytest.importorskip("open3d", exc_type=ImportError)
    repeated = np.tile(POINTS, (50, 1))  # So that there is something to copy.
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(repeated))
    o3d.io.write_point_cloud(tmp_path / "a.pcd", cloud, compressed=True)
    np.testing.assert_allclose(read_cloud(tmp_path / "a.pcd").points, repeated, atol=1e-6)
    data = (tmp_path / "a.pcd").read_bytes()
    start = data.index(b"compressed\n") + 11
    for packed in (data[: start + 4] + b"\xff" * 4 + data[start + 8 :], data[: start + 8] + data):
        (tmp_path / "b.pcd").write_bytes(packed)
        with pytest.raises(CloudError, match="compressed PCD data"):
            read_cloud(tmp_path / "b.pcd")


def test_a_pcd_with_fields_of_several_numbers_is_read(tmp_path: Path) -> None:
    header = "FIELDS n x y z\nSIZE 4 8 8 8\nTYPE F F F F\nCOUNT 3 1 1 1\nWIDTH 10\nHEIGHT 2\n"
    table = np.zeros(20, [("n", "<f4", 3), ("p", "<f8", 3)])
    table["p"] = POINTS
    (tmp_path / "a.pcd").write_bytes(header.encode() + b"DATA binary\n" + table.tobytes())
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.pcd").points, POINTS)


@pytest.mark.parametrize(
    "text",
    [
        "x y z r g b\n1 2 3\n4 5 6\n",
        "//X Y Z\n1 2 3\n4 5 6\n",
        "2\n1 2 3\n4 5 6\n",
        "\ufeff1,2,3\r\n4,5,6\r\n",
        "1,0;2,0;3,0\n4,0;5,0;6,0\n",
    ],
)
def test_text_files_of_many_programs_are_read(tmp_path: Path, text: str) -> None:
    (tmp_path / "a.xyz").write_text(text, encoding="utf-8")
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.xyz").points, [[1, 2, 3], [4, 5, 6]])


def test_an_array_with_named_fields_is_read_and_a_transposed_one_is_told(tmp_path: Path) -> None:
    table = np.zeros(20, [("i", "u1"), ("x", "f4"), ("y", "f8"), ("z", "f8")])
    for axis, name in enumerate("xyz"):
        table[name] = POINTS[:, axis]
    np.save(tmp_path / "a.npy", table)
    np.testing.assert_array_equal(read_cloud(tmp_path / "a.npy").points, POINTS)
    np.save(tmp_path / "b.npy", np.zeros((3, 500)))
    with pytest.raises(CloudError, match=r"\(N, 3\), got float64 \(3, 500\)"):
        read_cloud(tmp_path / "b.npy")


def test_counts_that_a_file_cannot_hold_take_no_memory(tmp_path: Path) -> None:
    (tmp_path / "a.ply").write_bytes(
        ply(POINTS, "ascii").replace(b"vertex 20", b"vertex 99999999999")
    )
    head = io.BytesIO()
    shape = {"descr": "<f8", "fortran_order": False, "shape": (10**12, 3)}
    np.lib.format.write_array_header_1_0(head, shape)
    with zipfile.ZipFile(tmp_path / "b.npz", "w") as archive:
        archive.writestr("points.npy", head.getvalue() + bytes(100))
    with zipfile.ZipFile(tmp_path / "c.npz", "w") as archive:
        archive.writestr("readme.txt", "no array")
    las = bytearray(400)
    las[:4] = b"LASF"
    las[96:107] = struct.pack("<IIBH", 227, 0xFFFFFFFF, 3, 34)
    (tmp_path / "d.las").write_bytes(las)
    for name in ("a.ply", "b.npz", "c.npz", "d.las"):
        with pytest.raises(CloudError, match=r"ends early|expected an array|not a complete"):
            read_cloud(tmp_path / name)


def test_what_is_no_file_on_disk_is_not_waited_for(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "a.ply")
    with pytest.raises(CloudError, match="expected a file on disk"):
        read_cloud(tmp_path / "a.ply")
