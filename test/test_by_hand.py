"""What an operator says of two agents holds, whatever the maps say."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from test.helpers import yaw_transform
from test.helpers_io import random_map
from test.helpers_sessions import flat_map, restarted
from topometric_ros.alignment import Alignment, AlignmentStatus, Basis
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.io.bag_messages import message_classes
from topometric_ros.runtime.alignment_codec import (
    alignments_from_message,
    alignments_to_message,
    offers_from_message,
)
from topometric_ros.runtime.by_hand import CovarianceError
from topometric_ros.runtime.extractor_session import SessionError
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.merger_state import Known, version_of
from topometric_ros.runtime.transforms import TransformError


def test_an_alignment_set_by_hand_holds_until_removed() -> None:
    merger = MergerSession(MergeConfig(), ["a", "b"])
    merger.add_map(flat_map("a"))
    merger.add_map(random_map(3, "b"))
    T = yaw_transform(0.3, (1, 2, 0))
    merger.set_alignment("b", "a", np.linalg.inv(T))
    result = merger.merge()
    assert result.alignments[0].status is AlignmentStatus.ACCEPTED
    assert result.alignments[0].reason == "set by hand"
    message = alignments_to_message(result, message_classes(), 1, merger.maps)
    assert alignments_from_message(message).alignments[0].basis is Basis.OPERATOR
    assert offers_from_message(message) == [], "another operator's word is not taken over"
    np.testing.assert_allclose(result.alignments[0].T_a_b, T, atol=1e-12)
    np.testing.assert_allclose(merger.transforms()["b"], T, atol=1e-9)
    assert result.alignments[0].covariance is not None
    np.testing.assert_allclose(result.alignments[0].covariance[0, 0], 0.1**2)
    covariance = np.diag([0.5, 0.5, 0.1, 0.02, 0.02, 0.1])
    merger.set_alignment("a", "b", T, covariance)
    np.testing.assert_array_equal(merger.merge().alignments[0].covariance, covariance)
    for wrong in (-covariance, covariance + np.eye(6)[::-1] * np.arange(6), covariance * np.nan):
        with pytest.raises(CovarianceError, match="covariance"):
            merger.set_alignment("a", "b", T, wrong)
    assert merger.remove_alignment("a", "b")
    again = merger.merge().alignments[0]
    assert again.reason not in {"set by hand", "removed by hand"}, "the maps decide again"


def accepted_pair() -> MergerSession:
    """Return a merger of two maps of one flat that has accepted their alignment."""
    merger = MergerSession(MergeConfig(), ["a", "b"])
    merger.add_map(flat_map("a"))
    merger.add_map(flat_map("b", 1))
    known = Alignment(("a", "b"), AlignmentStatus.ACCEPTED, "found", np.eye(4), confidence=0.9)
    versions = (version_of(merger.maps["a"]), version_of(merger.maps["b"]))
    merger.restore(dataclasses.replace(merger.state(), known=(Known(known, versions, 0.0),)))
    assert merger.merge().alignments[0].accepted
    return merger


def test_an_alignment_of_the_maps_that_is_removed_by_hand_stays_so_until_it_is_allowed() -> None:
    merger = accepted_pair()
    assert merger.remove_alignment("b", "a")
    assert not merger.remove_alignment("a", "b"), "it is removed already"
    merger.add_map(dataclasses.replace(merger.maps["b"], sequence=99))
    told: list[str] = []
    removed = merger.merge(told.append).alignments[0]
    assert (removed.status, removed.reason) == (AlignmentStatus.WITHDRAWN, "removed by hand")
    assert not [text for text in told if text.startswith("aligning")], "nor is it searched for"
    assert list(merger.transforms()) == ["a"]
    merger.forget("b")
    merger.add_map(flat_map("b", 1))
    assert not merger.merge().alignments[0].accepted, "whoever comes back is not forgiven"
    merger.set_alignment("a", "b", np.eye(4))
    assert merger.merge().alignments[0].accepted, "what is set by hand takes its place"
    merger = accepted_pair()
    assert not merger.remove_alignment("a", "b", allow=True), "nothing was said by hand"
    merger.remove_alignment("a", "b")
    assert merger.remove_alignment("a", "b", allow=True)
    assert merger.merge().alignments[0].reason == "found", "what was known counts again"


def test_a_new_session_does_not_wait_for_an_alignment_that_was_removed_by_hand() -> None:
    merger = accepted_pair()
    merger.remove_alignment("a", "b")
    merger.add_map(restarted("b"))
    merger.merge()
    assert (merger.maps["b"].session, merger.stale) == ("new", ())
    assert merger.merge().alignments[0].reason == "removed by hand"


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
