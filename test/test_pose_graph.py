"""The examples carry the merger's alignments to a pose-graph back end in common messages alone."""

from __future__ import annotations

import importlib.util
from types import ModuleType

import numpy as np
import pytest

from test import helpers_ros
from test.helpers import yaw_transform

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
