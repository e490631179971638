"""E57 files, written by the library that surveyors' tools use: all scans, each in its pose."""

import sys
from pathlib import Path

import numpy as np
import pytest

from topometric_ros.io.clouds import CloudError, read_cloud

pye57 = pytest.importorskip("pye57")

POINTS = np.random.default_rng(1).uniform(-5.0, 5.0, (500, 3))
QUARTER_TURN = np.array([np.cos(np.pi / 4), 0.0, 0.0, np.sin(np.pi / 4)])
"""(w, x, y, z): x becomes y."""


def write(path: Path, invalid: int = 0) -> Path:
    """Write two scans of the same points, one turned and moved, one with invalid points."""
    cartesian = {f"cartesian{axis}": POINTS[:, k].copy() for k, axis in enumerate("XYZ")}
    state = np.zeros(len(POINTS), np.int8)
    state[:invalid] = 1
    with pye57.E57(str(path), mode="w") as file:
        file.write_scan_raw(cartesian, rotation=QUARTER_TURN, translation=np.array([10.0, 0, 2]))
        file.write_scan_raw({**cartesian, "cartesianInvalidState": state})
    return path


def test_scans_lie_in_their_poses_and_invalid_points_are_left_out(tmp_path: Path) -> None:
    points = read_cloud(write(tmp_path / "a.e57", invalid=40)).points
    turned = np.column_stack([10.0 - POINTS[:, 1], POINTS[:, 0], POINTS[:, 2] + 2.0])
    # The writer keeps coordinates in single precision.
    np.testing.assert_allclose(points, np.vstack([turned, POINTS[40:]]), atol=1e-5)


def test_scale_and_up_axis_hold_for_them_too(tmp_path: Path) -> None:
    path = write(tmp_path / "a.E57")
    np.testing.assert_allclose(
        read_cloud(path, up="y", scale=0.5).points[:, 2], read_cloud(path).points[:, 1] / 2
    )


@pytest.mark.parametrize("damage", ["empty", "another kind", "cut", "a bit", "no scan"])
def test_a_damaged_file_is_one_line_and_stays(tmp_path: Path, damage: str) -> None:
    path = write(tmp_path / "a.e57")
    content = path.read_bytes()
    if damage == "no scan":
        with pye57.E57(str(path), mode="w"):
            pass
    else:
        flipped = content[:3000] + bytes([content[3000] ^ 1]) + content[3001:]
        other = {"empty": b"", "another kind": b"ply\n" * 2000, "cut": content[:9000]}
        path.write_bytes(other.get(damage, flipped))
    with pytest.raises(CloudError, match=r"a\.e57: ") as caught:
        read_cloud(path)
    assert "\n" not in str(caught.value)
    assert path.exists()


def test_a_count_beyond_the_file_takes_no_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = write(tmp_path / "a.e57")
    monkeypatch.setattr(pye57.ScanHeader, "point_count", 10**15)
    with pytest.raises(CloudError, match="scan 0 claims 1000000000000000 points"):
        read_cloud(path)


def test_a_missing_reader_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.e57")
    monkeypatch.setitem(sys.modules, "pye57", None)
    with pytest.raises(CloudError, match='pip install "pye57"'):
        read_cloud(path)
