"""The examples carry the merger's alignments to a pose-graph back end in common messages alone."""

from __future__ import annotations

import importlib.util
from types import ModuleType

import numpy as np
import pytest

from test import helpers_ros
from test.helpers import yaw_transform
from test.helpers_io import random_map
from test.helpers_sessions import flat_map
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.runtime.merger_session import MergerSession

pytestmark = pytest.mark.skipif(bool(helpers_ros.missing()), reason=helpers_ros.missing())


def example(name: str) -> ModuleType:
    path = helpers_ros.ROOT / "examples" / f"{name}.py"
    spec = importlib.util.spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_alignments_become_constraints_and_the_surer_one_weighs_more() -> None:
    from topometric_msgs.msg import AgentPlacement, Alignment, AlignmentArray

    to_constraints, back_end = example("constraints"), example("pose_graph")
    truth = {"a": np.eye(4), "b": yaw_transform(0.5, (3, 1, 0)), "c": yaw_transform(-1, (0, 4, 0))}
    array = AlignmentArray()
    array.agents = [AgentPlacement(id=n, frame_id=f"{n}/map") for n in "abcd"]
    for a, b, sigma, off in (("a", "b", 0.01, 0.0), ("b", "c", 0.01, 0.0), ("a", "c", 1.0, 0.3)):
        T = np.linalg.inv(truth[a]) @ truth[b]
        T[0, 3] += off
        array.alignments.append(
            Alignment(
                agent_a=a, agent_b=b, status=Alignment.ACCEPTED, t_a_b=T.ravel(),
                has_covariance=True, covariance=(np.eye(6) * sigma**2).ravel(),
            )
        )  # fmt: skip
    refused = Alignment(agent_a="a", agent_b="d", status=Alignment.AMBIGUOUS, has_covariance=True)
    array.alignments.append(refused)
    edges = dict(map(back_end.edge_of, to_constraints.constraints(array)))
    assert sorted(edges) == [("a/map", "b/map"), ("a/map", "c/map"), ("b/map", "c/map")]
    found = back_end.solve(edges, "a/map")
    assert set(found) == {"a/map", "b/map", "c/map"}
    for name, T in truth.items():
        np.testing.assert_allclose(found[f"{name}/map"], T, atol=1e-3)


def test_an_alignment_by_hand_goes_along_and_one_that_is_removed_is_taken_out() -> None:
    from topometric_ros.nodes.messages import message_classes
    from topometric_ros.runtime.alignment_codec import alignments_to_message

    to_constraints, back_end = example("constraints"), example("pose_graph")
    merger = MergerSession(MergeConfig(), ["a", "b"])
    merger.add_map(flat_map("a"))
    merger.add_map(random_map(3, "b"))
    merger.set_alignment("a", "b", yaw_transform(0.3, (1, 2, 0)))
    sent, edges = {}, {}

    def send() -> int:
        array = alignments_to_message(merger.align(), message_classes(), 0, merger.maps)
        told = to_constraints.updates(sent, to_constraints.constraints(array))
        for pair, edge in map(back_end.edge_of, told):
            edges[pair] = edge
        return len(told)

    assert send() == 1
    ((_, root),) = edges.values()
    np.testing.assert_allclose(root[0, 0], 1 / 0.1, err_msg="the inverse of by_hand_sigma")
    assert send() == 0, "nothing has changed"
    merger.remove_alignment("a", "b")
    assert send() == 1
    assert list(edges.values()) == [None]
    assert send() == 0
