"""New maps: what was accepted holds or falls at once, and pairs are aligned as they are urgent."""

from __future__ import annotations

import dataclasses
from typing import Any

import numpy as np
import pytest

from test.helpers import yaw_transform
from test.helpers_io import random_map
from test.helpers_sessions import flat_map
from topometric_ros.alignment import Alignment, AlignmentStatus, Basis
from topometric_ros.configuration import with_values
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.prepared import Prepared
from topometric_ros.io.bag_messages import message_classes
from topometric_ros.matching.evidence import Evidence
from topometric_ros.runtime import stability
from topometric_ros.runtime.alignment_codec import (
    alignments_from_message,
    alignments_to_message,
    offers_from_message,
)
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.merger_state import Known, MergerState, version_of
from topometric_ros.runtime.pairs import Pairs
from topometric_ros.topometric_map import TopometricMap


def next_version(m: TopometricMap) -> TopometricMap:
    return dataclasses.replace(m, sequence=m.sequence + 1)


def merger_that_knows(T_a_b: np.ndarray) -> MergerSession:
    """Return a merger with two maps of the flat and an accepted alignment of them."""
    a, b = flat_map("a"), flat_map("b", 1)
    alignment = Alignment(("a", "b"), AlignmentStatus.ACCEPTED, "known", T_a_b, overlap=0.9)
    known = (Known(alignment, (version_of(a), version_of(b)), 1e9),)
    merger = MergerSession(MergeConfig(), ["a", "b"])
    merger.restore(MergerState(("a", "b"), {"a": a, "b": b}, known=known))
    merger.align()
    assert list(merger.transforms()) == ["a", "b"]
    return merger


RIGHT = np.linalg.inv(yaw_transform(0.4, (1.0, 2.0, 0.0)))


def test_what_was_accepted_holds_for_a_new_map_before_the_pair_has_its_turn() -> None:
    merger = merger_that_knows(RIGHT)
    merger.add_map(next_version(flat_map("b", 1)))
    placed = merger.align(limit=0)
    assert merger.waiting == 1
    (x,) = placed.alignments
    assert (x.accepted, x.reason) == (True, "known")
    assert x.score > 0.0
    np.testing.assert_array_equal(merger.transforms()["b"], RIGHT)
    merger.align(limit=1)
    assert merger.waiting == 0
    np.testing.assert_allclose(merger.transforms()["b"], RIGHT, atol=0.05)


def test_furniture_that_was_moved_takes_nothing_back(monkeypatch: pytest.MonkeyPatch) -> None:
    merger = merger_that_knows(RIGHT)
    real = stability.evaluate

    def seen(*arguments: Any) -> Evidence:
        return dataclasses.replace(
            real(*arguments), free_floor=60.0, agreed_wall=60.0, smallest_eigenvalue=20.0,
            furniture_judged=300, furniture_conflict_cells=75, furniture_conflict=0.25,
        )  # fmt: skip

    monkeypatch.setattr(stability, "evaluate", seen)
    merger.add_map(next_version(flat_map("b", 1)))
    (x,) = merger.align(limit=0).alignments
    assert x.accepted
    # Whether a rival comes near is only known once the maps were searched.
    config = MergeConfig()
    a, b = (
        Prepared(m, config.search.scoring, config.matching) for m in (flat_map("a"), flat_map("b"))
    )
    refused = Alignment(("a", "b"), AlignmentStatus.AMBIGUOUS, "another pose fits nearly as well")
    assert stability.steadier(x, 1e9, refused, a, b, config)[0] is refused


def test_what_a_new_map_contradicts_is_not_used_until_it_is_found_anew() -> None:
    merger = merger_that_knows(yaw_transform(1.1, (3.0, 0.0, 0.0)))
    merger.add_map(next_version(flat_map("b", 1)))
    placed = merger.align(limit=0)
    assert list(merger.transforms()) == ["a"]
    (x,) = placed.alignments
    assert x.status is AlignmentStatus.NONE
    assert x.reason.startswith("it no longer holds: ")
    # What waits is no verdict that another merger could take over.
    message = alignments_to_message(placed, message_classes(), 1, merger.maps)
    assert offers_from_message(message) == []
    assert alignments_from_message(message).alignments[0].basis is Basis.OLDER_MAPS


def test_agents_without_a_place_come_first_and_then_who_waited_longest() -> None:
    config = MergeConfig(check="none")
    maps = {agent: random_map(seed, agent) for seed, agent in enumerate("abcd")}
    pairs = Pairs()

    def due(*placed: str) -> list[str]:
        waiting = pairs.due(every, config, placed)
        return [x.agent + y.agent for x, y in waiting]

    every = [(maps[x], maps[y]) for x, y in ("ab", "ac", "ad", "bc", "bd", "cd")]
    assert due("a", "d") == ["ab", "ac", "bd", "cd", "bc", "ad"]

    def aligned(index: int, turn: int, status: AlignmentStatus) -> None:
        a, b = every[index]
        T = np.eye(4) if status is AlignmentStatus.ACCEPTED else None
        alignment = Alignment((a.agent, b.agent), status, "as before", T)
        pairs.known[a.agent, b.agent] = Known(alignment, (version_of(a), version_of(b)), 0.0)
        pairs._turns[a.agent, b.agent] = turn

    aligned(0, 1, AlignmentStatus.NONE)
    aligned(2, 2, AlignmentStatus.ACCEPTED)
    assert due("a", "d") == ["ac", "bd", "cd", "bc"]
    maps["a"] = next_version(maps["a"])
    every = [(maps[x], maps[y]) for x, y in ("ab", "ac", "ad", "bc", "bd", "cd")]
    assert due("a", "d") == ["ac", "bd", "cd", "ab", "bc", "ad"]


def test_new_parameters_are_asked_of_maps_that_have_not_changed() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    merger.add_map(flat_map("a"))
    merger.add_map(flat_map("b", 1))
    (found,) = merger.merge().alignments
    assert found.accepted

    # What comes after aligning asks no pair again, nor does what is known of other agents.
    elsewhere = "{between: [a, c], position: [0, 0, 0], yaw: 0}"
    merger.config = with_values(MergeConfig(), {"fuse.room_overlap": 0.4, "priors": [elsewhere]})
    merger.align(limit=0)
    assert merger.waiting == 0

    # What the new gates refuse is not used from now on, and no older verdict outlives them.
    merger.config = with_values(MergeConfig(), {"verification.free_floor": 1e4})
    (x,) = merger.align(limit=0).alignments
    assert merger.waiting == 1
    assert x.reason.startswith("it no longer holds: ")
    assert x.basis is Basis.OLDER_PARAMETERS
    assert x.reason.endswith("under the new parameters yet")
    (x,) = merger.align().alignments
    assert (x.accepted, merger.waiting, x.basis) == (False, 0, Basis.MAPS)
    kept = merger.state()

    merger.config = MergeConfig()
    (x,) = merger.merge().alignments
    assert x.accepted
    np.testing.assert_allclose(x.T_a_b, found.T_a_b, atol=1e-9)

    # A restart with other parameters asks again too.
    again = MergerSession(MergeConfig(), ["a", "b"])
    again.restore(kept)
    again.align(limit=0)
    assert again.waiting == 1


def test_a_prior_that_is_set_later_takes_back_what_it_does_not_allow() -> None:
    merger = merger_that_knows(RIGHT)
    wrong = "{between: [a, b], position: [50, 0, 0], yaw: 0, sigma: 0.5, yaw_sigma: 5}"
    merger.config = with_values(MergeConfig(), {"priors": [wrong]})
    (x,) = merger.align(limit=0).alignments
    assert not x.accepted
    assert "from the prior of a and b" in x.reason
    (x,) = merger.align().alignments
    assert x.status is AlignmentStatus.REJECTED
