"""A merger's memory survives a restart exactly, and a damaged file is refused in one line."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import numpy as np
import pytest

from test.helpers import yaw_transform
from test.helpers_io import random_map
from test.helpers_sessions import flat_map
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.io.map_format import MapFileError
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.merger_state import EncodedMaps, load_state, save_state


def remembering() -> MergerSession:
    """Return a merger of three agents: two aligned by their maps, one by hand."""
    merger = MergerSession(MergeConfig(), ["a", "b"])
    merger.add_map(flat_map("a"), "a.bag")
    merger.add_map(flat_map("b", 1))
    merger.add_map(random_map(3, "c"))
    merger.set_alignment("a", "c", yaw_transform(0.3, (1, 2, 0)))
    merger.remove_alignment("c", "b")
    merger.merge()
    return merger


def test_a_restarted_merger_has_the_same_result_without_aligning_again(tmp_path: Path) -> None:
    before = remembering()
    save_state(tmp_path / "state", before.state())
    after = MergerSession(MergeConfig(), ["a", "b"])
    after.restore(load_state(tmp_path / "state"))
    told: list[str] = []
    result = after.merge(told.append)
    assert not [text for text in told if text.startswith("aligning")]
    assert [agent.source for agent in result.agents] == ["a.bag", "b", "c"]
    assert before.result is not None
    for one, two in zip(before.result.alignments, result.alignments, strict=True):
        assert (one.agents, one.status, one.reason) == (two.agents, two.status, two.reason)
        np.testing.assert_array_equal(one.T_a_b, two.T_a_b)
        np.testing.assert_array_equal(one.covariance, two.covariance)
        assert one.inliers == two.inliers
    assert 0.5 < (result.alignments[0].inliers or 0.0) <= 1.0
    np.testing.assert_array_equal(before.result.global_map.map.voxels, result.global_map.map.voxels)
    assert set(after.by_hand.fixed) == {("a", "c")}
    assert after.by_hand.removed == (("b", "c"),)
    assert result.alignments[2].reason == "removed by hand"


def test_the_same_memory_gives_the_same_bytes(tmp_path: Path) -> None:
    merger = remembering()
    save_state(tmp_path / "one", merger.state())
    save_state(tmp_path / "two", load_state(tmp_path / "one"))
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()


def test_only_maps_that_changed_are_encoded_anew(tmp_path: Path) -> None:
    merger, encoded = remembering(), EncodedMaps()
    save_state(tmp_path / "one", merger.state(), encoded)
    before = encoded.of(merger.maps)
    merger.add_map(dataclasses.replace(flat_map("b", 1), sequence=99))
    after = encoded.of(merger.maps)
    assert [agent for agent in after if after[agent] is not before[agent]] == ["b"]
    save_state(tmp_path / "one", merger.state(), encoded)
    save_state(tmp_path / "two", merger.state())
    assert (tmp_path / "one").read_bytes() == (tmp_path / "two").read_bytes()
    assert load_state(tmp_path / "one").maps["b"].sequence == 99
    merger.forget("b")
    assert set(encoded.of(merger.maps)) == {"a", "c"}


def test_ended_sessions_stay_ended_and_newer_ones_keep_waiting(tmp_path: Path) -> None:
    merger = remembering()
    newer = dataclasses.replace(random_map(9, "b"), session="later", sequence=1)
    merger.add_map(newer)
    merger.merge()
    assert merger.stale == ("b",)
    save_state(tmp_path / "state", merger.state())
    after = MergerSession(MergeConfig(), ["a", "b"])
    after.restore(load_state(tmp_path / "state"))
    assert after.stale == ("b",)
    with pytest.raises(SessionError, match="has ended"):
        after.add_map(dataclasses.replace(flat_map("b", 1), sequence=99))


@pytest.mark.parametrize("cut", [3, 40, 400])
def test_a_state_that_was_cut_off_is_refused(tmp_path: Path, cut: int) -> None:
    path = tmp_path / "state"
    save_state(path, remembering().state())
    path.write_bytes(path.read_bytes()[:-cut] if cut > 3 else path.read_bytes()[:cut])
    with pytest.raises(MapFileError, match="state"):
        load_state(path)


def test_a_map_file_is_no_state(tmp_path: Path) -> None:
    from topometric_ros.io.map_files import save_map

    save_map(tmp_path / "m.tmap", random_map())
    with pytest.raises(MapFileError, match="expected 'topometric-state/1'"):
        load_state(tmp_path / "m.tmap")
