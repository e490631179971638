"""What changed is aligned again; an accepted alignment changes only for a better one."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from test.helpers import yaw_transform
from test.helpers_io import random_map
from test.helpers_sessions import flat_map, restarted
from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.fusion.align import Prepared
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.merge import MOST_AGENTS
from topometric_ros.io.bag_messages import message_classes
from topometric_ros.runtime import pair_aligner, pairs
from topometric_ros.runtime.alignment_codec import alignments_to_message, offers_from_message
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.merger_state import Known, version_of
from topometric_ros.runtime.stability import steadier


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


def test_a_map_that_moves_as_a_whole_is_noticed_aligned_anew_and_told() -> None:
    merger = MergerSession(MergeConfig(check="none"), ["a", "b"])
    merger.add_map(flat_map("a"))
    b = flat_map("b", 1)
    merger.add_map(b)
    merger.merge()
    before = merger.transforms()["b"]
    moved_b = flat_map("b", 2)
    merger.add_map(dataclasses.replace(moved_b, session=b.session, sequence=b.sequence + 1))
    result = merger.merge()
    assert any("b: its whole map has moved" in w for w in result.warnings)
    # The flat itself has not moved: both maps lie on a's.
    now = merger.transforms()["b"]
    assert np.abs(now - before).max() > 0.5
    for m, T in ((b, before), (moved_b, now)):
        middle = T[:3, :3] @ m.surface().mean(axis=0) + T[:3, 3]
        np.testing.assert_allclose(middle, flat_map("a").surface().mean(axis=0), atol=0.1)
    grown = dataclasses.replace(moved_b, session=b.session, sequence=b.sequence + 2)
    merger.add_map(grown)
    assert not any("whole map" in w for w in merger.merge().warnings)


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

    monkeypatch.setattr(pairs, "steadier", steady)
    (accepted,) = result.alignments
    assert accepted.accepted
    withdrawn = dataclasses.replace(accepted, status=AlignmentStatus.WITHDRAWN)
    assert merger.placed is not None
    merger.placed = dataclasses.replace(merger.placed, alignments=(withdrawn,))
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
    refused = Alignment(("a", "b"), AlignmentStatus.AMBIGUOUS, "two poses")
    held, support = steadier(right, 1e9, refused, one, two, config)
    np.testing.assert_array_equal(held.T_a_b, np.eye(4))
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
    # What no map could tell apart is one: a fleet's result depends on its maps alone.
    same = dataclasses.replace(right, T_a_b=yaw_transform(0.001), score=0.95 * value)
    assert steadier(right, 1e9, same, one, two, config)[0] is same


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


def test_pairs_that_are_aligned_in_turns_and_side_by_side_come_out_the_same() -> None:
    results = []
    for threads, limit in ((1, None), (3, 2)):
        merger = MergerSession(MergeConfig(), ["a", "b", "c"], threads)
        for index, agent in enumerate("abc"):
            merger.add_map(flat_map(agent, index))
        merger.align(limit)
        assert merger.waiting == (0 if limit is None else 1)
        merger.align(limit)
        results.append(merger.fuse())
    one, three = results
    assert [x.agents for x in three.alignments] == [("a", "b"), ("a", "c"), ("b", "c")]
    for x, y in zip(one.alignments, three.alignments, strict=True):
        assert (x.status, x.reason, x.score) == (y.status, y.reason, y.score)
        np.testing.assert_array_equal(x.T_a_b, y.T_a_b)


def test_a_pair_that_cannot_be_aligned_for_no_known_reason_costs_the_others_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    real = pair_aligner.align

    def fails_with_c(a: Prepared, b: Prepared, *more: object) -> Alignment:
        if "c" in (a.map.agent, b.map.agent):
            raise IndexError("a fault")
        return real(a, b, *more)

    monkeypatch.setattr(pair_aligner, "align", fails_with_c)
    merger = MergerSession(MergeConfig(check="none"), ["a", "b", "c"])
    for index, agent in enumerate("abc"):
        merger.add_map(flat_map(agent, index))
    result = merger.merge()
    assert [x.accepted for x in result.alignments] == [True, False, False]
    assert "aligning them failed: IndexError('a fault')" in result.alignments[1].reason


def offers_of(merger: MergerSession) -> list[Known]:
    """Return what a late joiner would read on the topic `alignments`."""
    assert merger.result is not None
    message = alignments_to_message(merger.result, message_classes(), 1, merger.maps)
    return offers_from_message(message)


def test_a_late_joiner_takes_over_what_it_can_check_and_ends_with_the_same_map() -> None:
    config = MergeConfig(check="none")
    first = MergerSession(config, ["a", "b"])
    late = MergerSession(config, ["b", "a"])
    for merger in (first, late):
        merger.add_map(flat_map("a"))
        merger.add_map(flat_map("b", 1))
    there_all_along = first.merge()
    late.offer(offers_of(first))
    told: list[str] = []
    joined = late.merge(told.append)
    assert not [text for text in told if text.startswith("aligning")]
    np.testing.assert_allclose(
        joined.alignments[0].T_a_b, np.linalg.inv(there_all_along.alignments[0].T_a_b), atol=1e-12
    )


def test_an_offer_of_other_maps_or_against_the_maps_is_not_taken() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    a, b = flat_map("a"), flat_map("b", 1)
    merger.add_map(a)
    merger.add_map(b)
    wrong = Alignment(
        ("a", "b"), AlignmentStatus.ACCEPTED, "told so", yaw_transform(0.9, (5, 1, 0)), overlap=0.5
    )
    impossible = dataclasses.replace(wrong, T_a_b=np.zeros((4, 4)))
    versions = (version_of(a), version_of(b))
    older = ((a.session, a.sequence + 1), versions[1])
    for offer in (Known(wrong, versions, 0.0), Known(impossible, versions, 0.0)):
        merger.offer([offer])
        assert merger.merge().alignments[0].reason != "told so"
        merger.add_map(dataclasses.replace(a, sequence=merger.maps["a"].sequence + 1))
    merger.offer([Known(wrong, older, 0.0)])
    assert merger.merge().alignments[0].reason != "told so"


def test_an_agent_that_is_forgotten_leaves_and_may_come_back() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    merger.add_map(flat_map("a"))
    merger.add_map(flat_map("b", 1))
    merger.set_alignment("a", "b", np.eye(4))
    merger.merge()
    merger.forget("b")
    result = merger.merge()
    assert [agent.id for agent in result.agents] == ["a"]
    assert merger.by_hand.fixed == {}
    assert merger.add_map(flat_map("b", 1))
    assert len(merger.merge().agents) == 2


def test_there_is_room_for_so_many_agents_and_no_more() -> None:
    merger = MergerSession(MergeConfig())
    for number in range(MOST_AGENTS):
        merger.add_map(dataclasses.replace(random_map(), agent=f"robot{number}"))
    with pytest.raises(SessionError, match="at most 32 agents"):
        merger.add_map(dataclasses.replace(random_map(), agent="one_more"))
    assert len(merger.maps) == MOST_AGENTS
