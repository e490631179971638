"""Groups of agents: numbering, chained transforms and the withdrawal of what contradicts."""

from __future__ import annotations

import dataclasses
import itertools

import numpy as np
import pytest

from test.helpers import yaw_transform
from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.fusion.groups import GroupsConfig, group_agents
from topometric_ros.fusion.poses import inverse
from topometric_ros.fusion.priors import Prior, parse_priors

PLACES = {
    "a": np.eye(4),
    "b": yaw_transform(0.5, (4.0, 1.0, 0.0)),
    "c": yaw_transform(-2.0, (0.0, 9.0, 0.2)),
    "d": yaw_transform(3.0, (-7.0, 2.0, 0.0)),
}
AGENTS = tuple(PLACES)
HERE = {agent: np.zeros(3) for agent in PLACES}


def edge(x: str, y: str, confidence: float = 0.8, off: np.ndarray | None = None) -> Alignment:
    """Return the right alignment of two agents, turned off by `off`."""
    T = inverse(PLACES[x]) @ PLACES[y]
    return Alignment(
        (x, y),
        AlignmentStatus.ACCEPTED,
        "",
        T_a_b=T if off is None else T @ off,
        confidence=confidence,
    )


def test_everyone_aligned_is_one_group_in_the_first_agents_frame() -> None:
    alignments = [edge("a", "b"), edge("c", "b"), edge("c", "d")]
    groups = group_agents(AGENTS, alignments, GroupsConfig())
    assert groups.group == (0, 0, 0, 0)
    for agent, T in zip(AGENTS, groups.T_group_agent, strict=True):
        np.testing.assert_allclose(T, PLACES[agent], atol=1e-12)


def test_groups_are_numbered_by_their_first_agents() -> None:
    groups = group_agents(AGENTS, [edge("a", "c"), edge("b", "d")], GroupsConfig())
    assert groups.group == (0, 1, 0, 1)
    np.testing.assert_array_equal(groups.T_group_agent[1], np.eye(4))
    np.testing.assert_allclose(
        groups.T_group_agent[3], inverse(PLACES["b"]) @ PLACES["d"], atol=1e-12
    )


def test_alignments_that_are_not_accepted_join_nothing() -> None:
    refused = Alignment(("a", "b"), AlignmentStatus.AMBIGUOUS, "twins")
    assert group_agents(("a", "b"), [refused], GroupsConfig()).group == (0, 1)


def test_alignments_that_agree_are_averaged_by_their_covariance() -> None:
    slight = yaw_transform(0.0, (0.1, 0.0, 0.0))
    sure = np.diag([0.01**2] * 3 + [0.001**2] * 3)
    vague = 100.0 * sure
    for covariance, least, most in ((sure, 0.03, 0.095), (vague, 0.0, 0.02)):
        direct = dataclasses.replace(edge("a", "c", 0.6, slight), covariance=covariance)
        others = [dataclasses.replace(edge(*p), covariance=sure) for p in (("a", "b"), ("b", "c"))]
        groups = group_agents(AGENTS[:3], [direct, *others], GroupsConfig(), centres=HERE)
        off = np.linalg.norm(groups.T_group_agent[2][:3, 3] - PLACES["c"][:3, 3])
        assert least <= off < most
        assert all(x.accepted for x in groups.alignments)


def test_the_least_confident_edge_of_a_cycle_that_does_not_close_is_withdrawn() -> None:
    wrong = yaw_transform(np.pi, (1.0, 0.0, 0.0))
    alignments = [edge("a", "b"), edge("b", "c"), edge("a", "c", 0.55, wrong), edge("c", "d")]
    groups = group_agents(AGENTS, alignments, GroupsConfig())
    assert [x.status for x in groups.alignments].count(AlignmentStatus.WITHDRAWN) == 1
    withdrawn = groups.alignments[2]
    assert withdrawn.status is AlignmentStatus.WITHDRAWN
    assert "a - b - c - a" in withdrawn.reason
    assert groups.group == (0, 0, 0, 0)
    np.testing.assert_allclose(groups.T_group_agent[3], PLACES["d"], atol=1e-12)


def test_a_group_can_fall_apart_when_its_only_link_contradicts() -> None:
    wrong = yaw_transform(1.0)
    ring = [edge("b", "c", 0.9), edge("c", "d", 0.9), edge("b", "d", 0.5, wrong)]
    groups = group_agents(AGENTS, [edge("a", "b", 0.7), *ring], GroupsConfig())
    assert groups.group == (0, 0, 0, 0)
    assert groups.alignments[3].status is AlignmentStatus.WITHDRAWN


def test_an_alignment_set_by_hand_is_never_withdrawn() -> None:
    wrong = yaw_transform(np.pi)
    alignments = [edge("a", "b", 0.6), edge("b", "c", 0.7), edge("a", "c", 0.1, wrong)]
    groups = group_agents(
        AGENTS[:3], alignments, GroupsConfig(), frozenset({("a", "c"), ("c", "a")})
    )
    assert groups.alignments[2].accepted
    assert groups.alignments[0].status is AlignmentStatus.WITHDRAWN


def test_an_alignment_set_by_hand_weighs_as_much_as_is_said_of_it() -> None:
    """Rigid without a covariance; with a wide one the alignments of the maps place the agent."""
    ring = [edge("a", "b"), edge("b", "c"), edge("a", "c", 1.0, yaw_transform(0.0, (0.1, 0, 0)))]
    by_hand = frozenset({("a", "c")})
    rigid = group_agents(AGENTS[:3], ring, GroupsConfig(), by_hand)
    ring[2] = dataclasses.replace(ring[2], covariance=np.eye(6))
    wide = group_agents(AGENTS[:3], ring, GroupsConfig(), by_hand)
    off = [np.linalg.norm((g.T_group_agent[2] - PLACES["c"])[:3, 3]) for g in (rigid, wide)]
    assert off == pytest.approx([0.1, 0.0], abs=1e-3)


def prior(x: str, y: str, sigma: float, off: np.ndarray | None = None) -> Prior:
    """Return the right prior of two agents, turned off by `off`, or of y in the frame `site`."""
    T = (yaw_transform(1.0, (5.0, 5.0, 0.0)) if x == "site" else inverse(PLACES[x])) @ PLACES[y]
    spread = np.diag([sigma] * 3 + [sigma / 10.0] * 3) ** 2
    return Prior(x, y, T if off is None else T @ off, spread, name="GNSS")


@pytest.mark.parametrize("outer", [False, True])
def test_a_prior_is_an_edge_that_weighs_by_its_covariance(outer: bool) -> None:
    """Two alignments 10 cm off each put c 20 cm off; a marker says where it is, a rough fix not."""
    drift = yaw_transform(0.0, (0.0, 0.0, 0.1))
    chain = [
        dataclasses.replace(edge(*pair, off=drift), covariance=np.diag([0.1**2] * 6))
        for pair in (("a", "b"), ("b", "c"))
    ]
    off = []
    for sigma in (0.01, 10.0):
        known = [prior("site", "a", sigma), prior("site", "c", sigma)]
        known = known if outer else [prior("a", "c", sigma)]
        groups = group_agents(AGENTS[:3], chain, GroupsConfig(), centres=HERE, priors=known)
        assert all(x.accepted for x in groups.alignments)
        off.append(np.linalg.norm((groups.T_group_agent[2] - PLACES["c"])[:3, 3]))
    assert off[0] < 0.02
    assert off[1] == pytest.approx(0.2, abs=0.01)


def test_a_prior_tells_which_alignment_of_a_chain_is_wrong() -> None:
    wrong = yaw_transform(0.0, (5.0, 0.0, 0.0))
    chain = [edge("a", "b", 0.95), edge("b", "c", 0.6, wrong)]
    sure = prior("a", "c", 0.3)
    groups = group_agents(AGENTS[:3], chain, GroupsConfig(), centres=HERE, priors=[sure])
    assert groups.group == (0, 0, 1)
    assert "the cycle b - a - c - b with the GNSS" in groups.alignments[1].reason
    # A prior joins nobody, and one so rough that 5 m are within it contradicts nobody.
    rough = prior("a", "c", 5.0)
    groups = group_agents(AGENTS[:3], chain, GroupsConfig(), centres=HERE, priors=[rough])
    assert groups.group == (0, 0, 0)


def test_a_wrong_prior_that_alignments_outvote_moves_nobody() -> None:
    pairs = itertools.combinations(AGENTS, 2)
    wrong = prior("a", "c", 0.01, yaw_transform(0.0, (5.0, 0.0, 0.0)))
    alignments = [edge(*pair, 0.8) for pair in pairs if pair != ("a", "c")]
    groups = group_agents(AGENTS, alignments, GroupsConfig(), centres=HERE, priors=[wrong])
    assert all(x.accepted for x in groups.alignments)
    for agent, T in zip(AGENTS, groups.T_group_agent, strict=True):
        np.testing.assert_allclose(T, PLACES[agent], atol=1e-9)


def test_a_wrong_prior_of_a_lone_chain_parts_it() -> None:
    """Nobody can tell whether the prior or an alignment is wrong."""
    wrong = prior("a", "c", 0.01, yaw_transform(0.0, (5.0, 0.0, 0.0)))
    chain = [edge("a", "b", 0.97), edge("b", "c", 0.99)]
    groups = group_agents(AGENTS[:3], chain, GroupsConfig(), centres=HERE, priors=[wrong])
    assert groups.group == (0, 1, 2)


def test_height_says_nothing_where_a_prior_does_not_know_it() -> None:
    """A fix to 0.3 m in the plan and 20 m in height: 5 m of height are allowed, of the plan not."""
    spread = (
        "covariance: [0.09,0,0,0,0,0, 0,0.09,0,0,0,0, 0,0,400,0,0,0, 0,0,0,1,0,0, 0,0,0,0,1,0, "
    )
    rest = f"yaw: 0, {spread} 0,0,0,0,0,1]}}"
    chain = [edge("a", "b", 0.95), edge("b", "c", 0.6)]
    for position, group in (([0, 9, 5.2], (0, 0, 0)), ([5, 9, 0.2], (0, 0, 1))):
        known = parse_priors([f"{{between: [a, c], position: {position}, {rest}"])
        turned = [dataclasses.replace(known[0], T=known[0].T @ yaw_transform(-2.0))]
        found = group_agents(AGENTS[:3], chain, GroupsConfig(), centres=HERE, priors=turned)
        assert found.group == group


def test_the_gap_of_a_cycle_is_read_where_the_maps_are() -> None:
    """A turn of half a degree about a far origin is not a gap of a metre."""
    far = np.array([0.0, 150.0, 0.0])
    turn = yaw_transform(np.radians(0.5))
    turn[:3, 3] = far - turn[:3, :3] @ far
    alignments = [edge("a", "b"), edge("b", "c"), edge("a", "c", 0.5, turn)]
    assert not all(
        x.accepted for x in group_agents(AGENTS[:3], alignments, GroupsConfig()).alignments
    )
    groups = group_agents(AGENTS[:3], alignments, GroupsConfig(), centres={"c": far})
    assert all(x.accepted for x in groups.alignments)


def test_nobody_can_tell_which_of_three_like_alignments_is_wrong() -> None:
    wrong = yaw_transform(0.0, (2.0, 0.0, 0.0))
    alignments = [edge("a", "b", 0.8), edge("b", "c", 0.82), edge("a", "c", 0.81, wrong)]
    groups = group_agents(AGENTS[:3], alignments, GroupsConfig())
    assert groups.group == (0, 1, 2)
    assert "nothing else tells" in " ".join(x.reason for x in groups.alignments)
    sure = [edge("a", "b", 0.95), edge("b", "c", 0.95), edge("a", "c", 0.6, wrong)]
    assert group_agents(AGENTS[:3], sure, GroupsConfig()).group == (0, 0, 0)


@pytest.mark.parametrize("seed", [2, 5, 14])
def test_the_least_confident_link_of_a_long_lone_cycle_goes_and_no_other(seed: int) -> None:
    rng = np.random.default_rng(seed)
    places = {
        f"r{k}": yaw_transform(rng.uniform(-3, 3), (12.0 * k, rng.uniform(-4, 4), 0.0))
        for k in range(10)
    }
    ring = [(f"r{k}", f"r{(k + 1) % 10}") for k in range(10)]
    wrong = yaw_transform(rng.uniform(-3, 3), (rng.uniform(-9, 9), rng.uniform(-9, 9), 0.0))
    alignments = []
    for k, (a, b) in enumerate(ring):
        T = inverse(places[a]) @ places[b] @ (wrong if k == 9 else np.eye(4))
        confidence = 0.53 if k == 9 else 0.8 + 0.01 * k
        alignments.append(
            Alignment((a, b), AlignmentStatus.ACCEPTED, "", T_a_b=T, confidence=confidence)
        )
    centres = {agent: np.array([5.0, 3.0, 1.0]) for agent in places}
    groups = group_agents(tuple(places), alignments, GroupsConfig(), centres=centres)
    assert [not x.accepted for x in groups.alignments] == [False] * 9 + [True]
    assert set(groups.group) == {0}


def fleet(noise: float, poisoned: dict[tuple[int, int], np.ndarray]) -> tuple[list, list, dict]:
    """Return (agents, alignments of all pairs, true places) of ten agents, some pairs wrong.

    `noise` is in m, and in rad by a tenth; what is poisoned is the most confident of all.
    """
    rng = np.random.default_rng(5)
    agents = [f"r{k}" for k in range(10)]
    places = {
        agent: yaw_transform(rng.uniform(-np.pi, np.pi), rng.uniform(-30, 30, 3) * (k > 0))
        for k, agent in enumerate(agents)
    }
    alignments = []
    for i, j in itertools.combinations(range(10), 2):
        T = inverse(places[agents[i]]) @ places[agents[j]]
        off = yaw_transform(rng.normal(0.0, noise / 10), rng.normal(0.0, noise, 3))
        T = T @ poisoned.get((i, j), off)
        confidence = 0.99 if (i, j) in poisoned else float(rng.uniform(0.6, 0.9))
        pair = (agents[i], agents[j])
        alignments.append(
            Alignment(pair, AlignmentStatus.ACCEPTED, "", T_a_b=T, confidence=confidence)
        )
    return agents, alignments, places


@pytest.mark.parametrize(
    "poisoned",
    [
        {
            (0, 1): yaw_transform(np.pi, (3.0, 1.0, 0.0)),
            (2, 7): yaw_transform(0.0, (0.0, 2.5, 0.0)),
            (4, 9): yaw_transform(0.0, (0.0, 0.0, 3.0)),
        },
        # Three that agree with each other: agent 9 one storey too high for 0, 1 and 2.
        {(k, 9): yaw_transform(0.0, (0.0, 0.0, 3.0)) for k in range(3)},
    ],
    ids=["apart", "conspiring"],
)
def test_three_poisoned_alignments_of_ten_agents_are_found(
    poisoned: dict[tuple[int, int], np.ndarray],
) -> None:
    agents, alignments, places = fleet(0.01, poisoned)
    groups = group_agents(agents, alignments, GroupsConfig())
    found = {x.agents for x in groups.alignments if x.status is AlignmentStatus.WITHDRAWN}
    assert found == {(agents[i], agents[j]) for i, j in poisoned}
    assert set(groups.group) == {0}
    for agent, T in zip(agents, groups.T_group_agent, strict=True):
        expected = inverse(places["r0"]) @ places[agent]
        assert np.linalg.norm((T - expected)[:3, 3]) < 0.05


def test_a_group_whose_input_is_not_z_up_turns_about_its_own_vertical() -> None:
    """The same building seen in frames with y up gives the same answer."""
    upright = np.eye(4)
    upright[:3, :3] = [[1, 0, 0], [0, 0, -1], [0, 1, 0]]
    agents, alignments, _ = fleet(0.01, {})
    tilted = [
        dataclasses.replace(x, T_a_b=inverse(upright) @ x.T_a_b @ upright) for x in alignments
    ]
    levels = dict.fromkeys(agents, upright)
    straight = group_agents(agents, alignments, GroupsConfig())
    turned = group_agents(agents, tilted, GroupsConfig(), levels=levels)
    for T, U in zip(straight.T_group_agent, turned.T_group_agent, strict=True):
        np.testing.assert_allclose(inverse(upright) @ T @ upright, U, atol=1e-9)
