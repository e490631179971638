"""Scans outlive a restart of their extractor, and do not mix with those of a frame set up anew."""

from __future__ import annotations

import logging
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from test.helpers import yaw_transform
from test.test_scan_grid import walk
from topometric_ros.extraction.config import extraction_preset
from topometric_ros.io.map_format import MapFileError
from topometric_ros.matching.config import matching_preset
from topometric_ros.nodes.scan_keeper import ScanKeeper
from topometric_ros.runtime.extractor_session import ExtractorSession, SessionError
from topometric_ros.runtime.scan_state import load_scans, save_scans
from topometric_ros.voxels.scan_grid import ScanGrid

SCANS = list(walk(person=True))
HALF = len(SCANS) // 2


def session(name: str = "s", agent: str = "a") -> ExtractorSession:
    names = iter((name, f"{name} anew"))
    presets = extraction_preset("default"), matching_preset("default")
    return ExtractorSession(agent, *presets, lambda: next(names))


def gather(
    into: ExtractorSession, scans: Any, T_map_cloud: np.ndarray | None = None
) -> ExtractorSession:
    T = np.eye(4) if T_map_cloud is None else T_map_cloud
    for sensor, points in scans:
        at = T[:3, :3] @ sensor + T[:3, 3]
        into.add_scan(points, "map", into.counts.scans + 1, T, sensor=at)
    return into


def grid(of: ExtractorSession) -> ScanGrid:
    state = of.scan_state()
    assert state is not None
    return state.grid


def restarted(path: Path, T: np.ndarray | None = None) -> ExtractorSession:
    """Return a session that takes up the first half of the walk and hears the other."""
    first = gather(session(), SCANS[:HALF]).scan_state()
    assert first is not None
    save_scans(path, first)
    again = session("t")
    again.take_up(load_scans(path, again.extraction.scans))
    return gather(again, SCANS[HALF:], T)


def test_what_was_gathered_before_and_after_a_restart_is_as_without_one(tmp_path: Path) -> None:
    whole, again = gather(session(), SCANS), restarted(tmp_path / "scans")
    np.testing.assert_array_equal(grid(again).points(), grid(whole).points())
    one, two = whole.scan_state(), again.scan_state()
    assert one is not None
    assert two is not None
    assert (one.scans, one.stamp, one.frame_id) == (two.scans, two.stamp, two.frame_id)
    assert again.trajectory is not None
    assert again.trajectory.stamps[0] == 1
    assert again.session == "t", "it may not be known where sessions of another process lie"


def test_scans_of_a_frame_that_was_set_up_anew_are_not_mixed_with_those_before(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    T = yaw_transform(1.2, (1.0, -2.0, 0.0))
    with caplog.at_level(logging.WARNING):
        again = restarted(tmp_path / "scans", T)
    assert "was map set up anew?" in caplog.text
    assert again.session == "t anew"
    alone = gather(session(), SCANS[HALF:], T)
    np.testing.assert_array_equal(grid(again).points(), grid(alone).points())


def test_nothing_is_judged_where_nothing_was_known(tmp_path: Path) -> None:
    """A robot that has gone on into another part of the building is believed."""
    again = restarted(tmp_path / "scans", yaw_transform(0.3, (60.0, 0.0, 0.0)))
    assert again.session == "t"
    assert again.counts.scans == len(SCANS)


def test_files_of_others_and_files_that_lie_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "scans"
    state = gather(session(), SCANS[:2]).scan_state()
    assert state is not None
    save_scans(path, state)
    rules = state.grid.config
    with pytest.raises(SessionError, match="scans of agent 'a', expected 'b'"):
        session(agent="b").take_up(load_scans(path, rules))
    held = state.grid.held()
    for name, wrong in (
        ("cells", held["cells"][[0] * len(held["cells"])]),
        ("cells", held["cells"] + 2_000_000),
        ("sums", held["sums"] * np.float32(np.nan)),
        ("counts", held["counts"] * 0),
        ("evidence", held["evidence"][:, :4]),
    ):
        with pytest.raises(ValueError, match=r"cell|range|shapes|mean"):
            ScanGrid.of(0.05, np.zeros(3), rules, 2, {**held, name: wrong})
    whole = path.read_bytes()
    for cut in (3, 40, len(whole) // 2):
        path.write_bytes(whole[:cut])
        with pytest.raises(MapFileError, match="scans"):
            load_scans(path, rules)


def test_a_file_that_cannot_be_used_is_put_aside_and_so_is_one_of_an_older_session(
    tmp_path: Path,
) -> None:
    logger, path = logging.getLogger("test"), tmp_path / "scans"
    path.write_bytes(b"nothing")
    keeper = ScanKeeper(str(path), logger)
    one = session()
    keeper.restore(one)
    assert not one.has_input
    assert (tmp_path / "scans.damaged").read_bytes() == b"nothing"
    gather(one, SCANS[:2])
    assert keeper.keep(one) == ""
    kept = path.read_bytes()
    gather(one, SCANS[2:3])
    assert keeper.keep(one) == ""
    assert path.read_bytes() == kept, "not with every scan"
    one.reset()
    keeper.keep(one, at_once=True)
    assert (tmp_path / "scans.before").read_bytes() == kept
    assert not path.exists(), "what was reset does not come back"
    keeper.close()


def test_that_nothing_can_be_written_is_told_until_it_can(tmp_path: Path) -> None:
    folder = tmp_path / "disk"
    folder.mkdir()
    keeper = ScanKeeper(str(folder / "scans"), logging.getLogger("test"))
    one = gather(session(), SCANS[:2])
    shutil.rmtree(folder)
    failure = keeper.keep(one)
    assert failure.startswith("what was gathered was not saved: ")
    assert keeper.keep(one) == failure, "before it is tried again"
    folder.mkdir()
    assert keeper.keep(one, at_once=True) == ""
    assert keeper.keep(one) == ""
    keeper.close()
