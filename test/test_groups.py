"""Groups of agents: numbering, chained transforms and the withdrawal of what contradicts."""

from __future__ import annotations

import numpy as np

from test.helpers import yaw_transform
from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.fusion.groups import GroupsConfig, group_agents
from topometric_ros.fusion.poses import inverse

PLACES = {
    "a": np.eye(4),
    "b": yaw_transform(0.5, (4.0, 1.0, 0.0)),
    "c": yaw_transform(-2.0, (0.0, 9.0, 0.2)),
    "d": yaw_transform(3.0, (-7.0, 2.0, 0.0)),
}
AGENTS = tuple(PLACES)


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


def test_the_tree_prefers_confident_alignments() -> None:
    slight = yaw_transform(0.0, (0.1, 0.0, 0.0))
    alignments = [edge("a", "b", 0.9), edge("a", "c", 0.6, slight), edge("b", "c", 0.9)]
    groups = group_agents(AGENTS[:3], alignments, GroupsConfig())
    np.testing.assert_allclose(groups.T_group_agent[2], PLACES["c"], atol=1e-12)
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
