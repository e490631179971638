"""What changed is aligned again; an accepted alignment changes only for a better one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from test.helpers import yaw_transform
from test.helpers_io import random_map
from test.helpers_sessions import flat_map
from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.fusion.align import Prepared
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.runtime import merger_session
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.stability import steadier
from topometric_ros.runtime.transforms import TransformError
from topometric_ros.topometric_map import TopometricMap


def test_two_maps_of_one_place_are_merged() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    with pytest.raises(SessionError, match="no map was received yet"):
        merger.merge()
    assert merger.add_map(flat_map("b", 1), "b.bag")
    assert merger.add_map(flat_map("a"), "a.bag")
    assert not merger.add_map(flat_map("a"))
    result = merger.merge()
    assert [agent.id for agent in result.agents] == ["a", "b"]
    assert [agent.source for agent in result.agents] == ["a.bag", "b.bag"]
    assert [x.agents for x in result.alignments] == [("a", "b")]


def test_nothing_is_aligned_twice_and_nothing_published_before_it_is_known() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    assert merger.transforms() == {}
    merger.add_map(flat_map("a"))
    merger.add_map(random_map(3, "b"))
    first = merger.merge()
    assert list(merger.transforms()) == ["a"]
    told: list[str] = []
    again = merger.merge(told.append)
    assert not [text for text in told if text.startswith("aligning")]
    assert again.alignments[0] is first.alignments[0] or again.alignments == first.alignments


def test_an_alignment_set_by_hand_holds_until_removed() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    merger.add_map(flat_map("a"))
    merger.add_map(random_map(3, "b"))
    T = yaw_transform(0.3, (1, 2, 0))
    merger.set_alignment("b", "a", np.linalg.inv(T))
    result = merger.merge()
    assert result.alignments[0].status is AlignmentStatus.ACCEPTED
    assert result.alignments[0].reason == "set by hand"
    np.testing.assert_allclose(result.alignments[0].T_a_b, T, atol=1e-12)
    np.testing.assert_allclose(merger.transforms()["b"], T, atol=1e-9)
    assert merger.remove_alignment("a", "b")
    assert not merger.remove_alignment("a", "b")
    assert merger.merge().alignments[0].reason != "set by hand"


def test_an_impossible_alignment_by_hand_is_refused() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    for a, b, T, error, text in (
        ("a", "c", np.eye(4), SessionError, "no agent 'c'; known: a, b"),
        ("a", "a", np.eye(4), SessionError, "needs two agents"),
        ("a", "b", np.zeros((4, 4)), TransformError, "not a rotation"),
        ("a", "b", np.full((4, 4), np.nan), TransformError, "finite"),
    ):
        with pytest.raises(error, match=text):
            merger.set_alignment(a, b, T)


def test_a_new_session_stops_the_transform_and_keeps_the_old_map_until_it_is_aligned() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    old = flat_map("b", 1)
    merger.add_map(flat_map("a"))
    merger.add_map(old)
    accepted = Alignment(("a", "b"), AlignmentStatus.ACCEPTED, "known", T_a_b=np.eye(4))
    merger.set_alignment("a", "b", accepted.T_a_b)
    merger.merge()
    assert set(merger.transforms()) == {"a", "b"}
    elsewhere = dataclasses.replace(random_map(9, "b"), session="new", sequence=1)
    assert merger.add_map(elsewhere)
    assert set(merger.transforms()) == {"a"}
    assert merger.stale == ("b",)
    result = merger.merge()
    assert merger.maps["b"] is old
    assert set(merger.transforms()) == {"a"}
    assert any("session new is not aligned yet" in warning for warning in result.warnings)
    with pytest.raises(SessionError, match="which has ended"):
        merger.add_map(dataclasses.replace(old, sequence=9))


def restarted(agent: str) -> TopometricMap:
    """Return a map of another place, of a session that follows the flat's."""
    return dataclasses.replace(random_map(9, agent), session="new", sequence=1)


def test_an_alignment_set_by_hand_after_a_restart_is_of_the_new_session() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    merger.add_map(flat_map("a"))
    merger.add_map(flat_map("b", 1))
    merger.set_alignment("a", "b", np.eye(4))
    merger.merge()
    merger.add_map(restarted("b"))
    T = yaw_transform(0.3, (1, 2, 0))
    merger.set_alignment("a", "b", T)
    merger.merge()
    assert (merger.maps["b"].session, merger.stale) == ("new", ())
    np.testing.assert_allclose(merger.transforms()["b"], T, atol=1e-12)


def test_a_new_session_that_did_not_align_is_tried_again_only_with_another_map() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    merger.add_map(flat_map("a"))
    merger.add_map(flat_map("b", 1))
    merger.set_alignment("a", "b", np.eye(4))
    merger.merge()
    merger.add_map(restarted("b"))
    told: list[str] = []
    for sequence in (1, 1, 2):
        told.append("|")
        merger.add_map(dataclasses.replace(restarted("b"), sequence=sequence))
        merger.merge(told.append)
    tried = [text.count("aligning a and b") for text in "".join(told).split("|")[1:]]
    assert tried == [2, 0, 1]


def test_an_alignment_that_was_withdrawn_may_change_freely(monkeypatch: pytest.MonkeyPatch) -> None:
    merger = MergerSession(MergeConfig(check="none"), ["a", "b"])
    merger.add_map(flat_map("a"))
    merger.add_map(flat_map("b", 1))
    result = merger.merge()
    asked: list[Alignment] = []

    def steady(old: Alignment, held: float, new: Alignment, *_: object) -> tuple[Alignment, float]:
        asked.append(old)
        return new, held

    monkeypatch.setattr(merger_session, "steadier", steady)
    (accepted,) = result.alignments
    assert accepted.accepted
    withdrawn = dataclasses.replace(accepted, status=AlignmentStatus.WITHDRAWN)
    merger.result = dataclasses.replace(result, alignments=(withdrawn,))
    merger.add_map(dataclasses.replace(flat_map("b", 1), sequence=2))
    merger.merge()
    assert asked == []
    merger.add_map(dataclasses.replace(flat_map("b", 1), sequence=3))
    merger.merge()
    assert len(asked) == 1


def test_an_accepted_alignment_changes_only_for_a_better_one() -> None:
    a, b = flat_map("a"), flat_map("b")
    config = MergeConfig(check="none")
    one, two = (Prepared(m, config.search.scoring, config.matching) for m in (a, b))
    right = Alignment(("a", "b"), AlignmentStatus.ACCEPTED, "", np.eye(4), overlap=0.9, score=1.0)
    held, support = steadier(right, 1e9, right, one, two, config)
    value = held.score
    assert support == 1e9
    assert value > 0
    slightly = dataclasses.replace(right, T_a_b=yaw_transform(0.01), score=1.05 * value)
    np.testing.assert_array_equal(
        steadier(right, 1e9, slightly, one, two, config)[0].T_a_b, np.eye(4)
    )
    clearly = dataclasses.replace(slightly, score=1.2 * value)
    assert steadier(right, 1e9, clearly, one, two, config)[0] is clearly
    # More evidence counts as better where the answer stays the same.
    assert steadier(right, 100.0, slightly, one, two, config)[0] is slightly
    refused = Alignment(("a", "b"), AlignmentStatus.AMBIGUOUS, "two poses")
    np.testing.assert_array_equal(
        steadier(right, 1e9, refused, one, two, config)[0].T_a_b, np.eye(4)
    )


def test_an_alignment_that_no_longer_holds_gives_way() -> None:
    config = MergeConfig()
    one, two = (
        Prepared(flat_map(name), config.search.scoring, config.matching) for name in ("a", "b")
    )
    wrong = Alignment(
        ("a", "b"), AlignmentStatus.ACCEPTED, "", yaw_transform(0.8, (3, 1, 0)), overlap=0.9
    )
    refused = Alignment(("a", "b"), AlignmentStatus.AMBIGUOUS, "two poses")
    assert steadier(wrong, 1e9, refused, one, two, config)[0] is refused
