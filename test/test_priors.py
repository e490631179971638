"""Priors: rough starts, markers and known transforms narrow, vouch for, and veto alignments."""

from __future__ import annotations

import dataclasses
import re

import numpy as np
import pytest

from test.helpers import yaw_transform
from test.helpers_matching import (
    A_ROOMS,
    B_ROOMS,
    T_A_B,
    T_BUILDING_A,
    T_BUILDING_B,
    agent_map,
)
from test.helpers_sessions import flat_map
from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.configuration import with_values
from topometric_ros.errors import ConfigurationError
from topometric_ros.fusion.align import align
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.merge import place
from topometric_ros.fusion.poses import inverse
from topometric_ros.fusion.priors import contradicted, parse_priors, prior_between, reversed_prior

YAW = float(np.degrees(np.arctan2(T_A_B[1, 0], T_A_B[0, 0])))


def line(x: float, y: float, z: float, yaw: float, rest: str = "") -> str:
    return f"{{between: [a, b], position: [{x}, {y}, {z}], yaw: {yaw}{rest}}}"


RIGHT = line(*T_A_B[:3, 3], YAW, ", sigma: 0.3, yaw_sigma: 3")


def with_priors(*texts: str) -> MergeConfig:
    return dataclasses.replace(MergeConfig(), priors=texts)


def test_a_prior_is_read_and_turned_round() -> None:
    (prior,) = parse_priors([RIGHT])
    assert prior.allows(T_A_B)
    assert not prior.allows(T_A_B @ yaw_transform(0.0, (3.0, 0.0, 0.0)))
    back = prior_between([prior], "b", "a")
    assert back is not None
    np.testing.assert_allclose(back.T @ prior.T, np.eye(4), atol=1e-12)
    assert back.allows(inverse(T_A_B))
    np.testing.assert_allclose(reversed_prior(back).covariance, prior.covariance, atol=1e-9)
    assert prior_between([prior], "a", "c") is None


def test_two_fixes_in_one_outer_frame_make_a_prior_of_the_pair() -> None:
    priors = parse_priors(
        [
            "{agent: a, in: site, position: [1, 2, 0], yaw: 90, sigma: 0.1, yaw_sigma: 1}",
            "{agent: b, in: site, position: [1, 12, 0], yaw: 90, sigma: 0.1, yaw_sigma: 1}",
        ]
    )
    prior = prior_between(priors, "a", "b")
    assert prior is not None
    np.testing.assert_allclose(prior.T, yaw_transform(0.0, (10.0, 0.0, 0.0)), atol=1e-12)
    # Across the line of sight a's heading, 1° off, moves b 10 m away by 0.17 m.
    expected = np.sqrt(2 * 0.1**2 + (10.0 * np.radians(1.0)) ** 2)
    assert np.sqrt(prior.covariance[1, 1]) == pytest.approx(expected, rel=1e-6)
    assert np.sqrt(prior.covariance[0, 0]) == pytest.approx(np.sqrt(2) * 0.1, rel=1e-6)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("between", "expected {between"),
        ("{between: [a, a], position: [0, 0, 0], yaw: 0}", "expected two frames"),
        ("{between: [a, b], position: [0, 0], yaw: 0}", "position: expected 3 numbers"),
        ("{between: [a, b], position: [0, 0, 0]}", "yaw: expected a number, got none"),
        ("{between: [a, b], positon: [0, 0, 0], yaw: 0}", "unknown key 'positon'"),
        ("{agent: a, position: [0, 0, 0], yaw: 0}", "expected either between"),
        ("{between: [a, b], T: [1, 2]}", "T: expected 16 numbers"),
        ("{between: [a", "not YAML"),
    ],
)
def test_a_prior_that_says_nothing_is_told_in_one_line(text: str, told: str) -> None:
    with pytest.raises(ConfigurationError, match="priors: prior '") as caught:
        with_values(MergeConfig(), {"priors": [text]})
    assert told in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_prior_of_nobody_is_told() -> None:
    priors = [
        "{between: [alise, b], position: [0, 0, 0], yaw: 0}",
        "{agent: b, in: site, position: [0, 0, 0], yaw: 0, name: marker 7}",
        "{agent: a, in: sight, position: [0, 0, 0], yaw: 0}",
        "{agent: a, in: b, position: [0, 0, 0], yaw: 0, sigma: 100, yaw_sigma: 180}",
    ]
    a, b = (flat_map("a"), flat_map("b"))
    alone = Alignment(("a", "b"), AlignmentStatus.NONE, "-")
    placed = place([a, b], with_values(MergeConfig(), {"priors": priors}), {("a", "b"): alone})
    assert placed.warnings[:3] == (
        "the prior of alise and b names alise; agents are a, b",
        "the marker 7 tells nothing: no other agent has one in site",
        "the prior of sight and a tells nothing: no other agent has one in sight",
    )
    assert not any("the prior of b and a" in told for told in placed.warnings)


def test_a_right_prior_lets_a_right_alignment_pass() -> None:
    a = agent_map("a", A_ROOMS, T_BUILDING_A, noise=0.01)
    b = agent_map("b", B_ROOMS, T_BUILDING_B, noise=0.01, seed=1)
    found = align(a, b, with_priors(RIGHT))
    assert found.accepted
    assert "the prior allows" in found.reason


def test_maps_that_contradict_a_prior_are_not_merged_and_both_are_told() -> None:
    a = agent_map("a", A_ROOMS, T_BUILDING_A, noise=0.01)
    b = agent_map("b", B_ROOMS, T_BUILDING_B, noise=0.01, seed=1)
    x, y, z = T_A_B[:3, 3]
    found = align(a, b, with_priors(line(x + 6.0, y, z, YAW, ", sigma: 0.5, alone: true")))
    assert found.status is AlignmentStatus.REJECTED
    told = re.search(r"the maps fit ([0-9.]+) m", found.reason)
    assert told is not None
    assert float(told[1]) == pytest.approx(6.0, abs=0.1)
    assert "one of the two is wrong" in found.reason


def test_a_prior_that_may_stands_alone_where_maps_share_nothing() -> None:
    a = agent_map("a", (1,), T_BUILDING_A)
    b = agent_map("b", (5,), T_BUILDING_B)
    assert not align(a, b, with_priors(RIGHT)).accepted
    alone = RIGHT.replace("}", ", alone: true, name: marker 7}")
    found = align(a, b, with_priors(alone))
    assert found.accepted
    assert "by the marker 7 alone" in found.reason
    np.testing.assert_allclose(found.T_a_b, T_A_B, atol=1e-9)
    assert found.covariance is not None
    # The same rooms laid on others that were seen free: the maps contradict the prior.
    wrong = alone.replace(f"yaw: {YAW}", f"yaw: {YAW + 90}")
    c = agent_map("b", A_ROOMS, T_BUILDING_B)
    a_whole = agent_map("a", A_ROOMS, T_BUILDING_A)
    assert not align(a_whole, c, with_priors(wrong)).accepted


def test_a_prior_that_places_contradict_by_way_of_others_is_told() -> None:
    priors = parse_priors([RIGHT, "{between: [a, c], position: [90, 0, 0], yaw: 0, name: GNSS}"])
    placed = {"a": np.eye(4), "b": T_A_B, "c": yaw_transform(0.0, (5.0, 0.0, 0.0))}
    told = list(contradicted(priors, placed))
    assert told[0].startswith("a and c are placed 85.00 m and 0.0° from the GNSS")
    # b's place in a makes one of c's in b as well.
    assert [text[:7] for text in told] == ["a and c", "b and c"]
