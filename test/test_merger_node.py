"""The merger's process: what it publishes of what it knows, and how it obeys its operator."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from test import helpers_ros
from test.helpers import box_room
from test.helpers_ros import Graph, NodeProcess, service, set_parameters, transform_matrix, wait_for

pytestmark = [
    pytest.mark.dds,
    pytest.mark.skipif(bool(helpers_ros.missing()), reason=helpers_ros.missing()),
]

MERGER = "topometric_ros.nodes.merger"
WORK_S = 600.0
ROOMS = {"a": (4.0, 5.0, 2.6), "b": (7.0, 3.0, 2.9)}
"""The one room of each agent, m."""


def small_map(agent: str) -> Any:
    """One room, extracted here; its map frame is called `map`, as on every robot."""
    from topometric_ros.extraction.config import extraction_preset
    from topometric_ros.matching.config import matching_preset
    from topometric_ros.runtime.extract_map import extract_map

    points = box_room((0.0, 0.0, 0.0), ROOMS[agent])
    presets = extraction_preset("default"), matching_preset("default")
    identity = {"agent": agent, "session": "s1", "sequence": 1, "frame_id": "map", "stamp": 1}
    return extract_map(points, *presets, **identity).map


def saved_map(folder: Path, agent: str) -> str:
    from topometric_ros.io.map_files import save_map

    save_map(folder / f"{agent}.tmap", small_map(agent))
    return str(folder / f"{agent}.tmap")


class Operator:
    """What somebody at the merger calls and sees: its services, and whom it places on /tf."""

    def __init__(self, own: Graph, process: NodeProcess) -> None:
        from tf2_msgs.msg import TFMessage

        from topometric_ros.nodes import qos

        self._own, self._process = own, process
        self._transforms = own.subscribe(TFMessage, "/tf", qos.TRANSFORMS)

    def call(self, name: str, **fields: Any) -> Any:
        """Return what a service of the merger answers."""
        snake = "".join(f"_{c.lower()}" if c.isupper() else c for c in name)[1:]
        request = service(name).Request(**fields)
        return self._own.call(service(name), f"/merger/{snake}", request)

    def places(self, *frames: str) -> dict[str, Any]:
        """Wait until the newest message on /tf places these frames and no others; return it."""

        def found() -> Any:
            entries = self._transforms.last.transforms if len(self._transforms) else []
            placed = {entry.child_frame_id: entry.transform for entry in entries}
            return placed if set(placed) == set(frames) else None

        return wait_for(found, WORK_S, f"/tf of {frames}", (self._process,))


def test_a_merger_publishes_what_is_known_and_refuses_what_cannot_be(
    own: Graph, start: Any
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from nav_msgs.msg import OccupancyGrid
    from topometric_msgs.msg import TopometricMap

    from topometric_ros.nodes import qos
    from topometric_ros.nodes.messages import message_classes
    from topometric_ros.runtime.message_codec import map_to_message

    process = start(MERGER, "-p", "agents:=[/a, /b]", "-p", "max_rate:=10.0")
    operator = Operator(own, process)
    diagnostics = own.subscribe(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
    grids = own.subscribe(OccupancyGrid, "/global_grid", qos.SNAPSHOT)
    publisher = own.node.create_publisher(TopometricMap, "/a/topometric_map", qos.SNAPSHOT)
    assert operator.call("MergeNow").code == 1, "nothing has arrived yet"
    message, wrong = (map_to_message(small_map("a"), message_classes()) for _ in range(2))
    wrong.voxel_count += 1
    publisher.publish(wrong)
    refused = lambda: any(  # noqa: E731
        "/a/topometric_map" in status.name and "refused" in status.message
        for entry in list(diagnostics.messages)
        for status in entry.status
    )
    wait_for(refused, WORK_S, "diagnostics entry of the refused map", (process,))
    publisher.publish(message)
    operator.places("map")
    assert process.log.count("refused") == 1
    grid = wait_for(lambda: grids.last if len(grids) else None, WORK_S, "global_grid", (process,))
    assert grid.header.frame_id == "global"
    seen = np.array(grid.data).reshape(grid.info.height, grid.info.width)
    floor = (seen == 0).sum() * grid.info.resolution**2
    assert floor == pytest.approx(4.0 * 5.0, rel=0.2), "the free floor of a room of 4 m x 5 m"
    assert (seen[:, [0, -1]] != 0).all(), "closed off by walls"
    before = len(grids)
    assert set_parameters(own, "/merger", {"grid_storey": 0}) == [""]
    wait_for(lambda: len(grids) > before, WORK_S, "global_grid of the storey asked for", (process,))
    assert set_parameters(own, "/merger", {"grid_storey": 7}) == [""]
    wait_for(lambda: "no storey 7; known: 0" in process.log, WORK_S, "what there is", (process,))
    assert process.stop(signal.SIGTERM) == 0


def test_a_merger_obeys_its_operator(own: Graph, start: Any, tmp_path: Path) -> None:
    from topometric_ros.io.map_files import load_global_map

    process = start(MERGER, "-p", "agents:=[/a, /b]", "-p", "max_rate:=10.0")
    operator = Operator(own, process)
    call, path = operator.call, saved_map(tmp_path, "b")
    assert call("LoadMap", path=saved_map(tmp_path, "a"), agent="a").code == 0
    assert call("LoadMap", path=path, agent="c").code == 4
    assert call("LoadMap", path=str(tmp_path / "none.tmap"), agent="b").code == 3
    assert call("LoadMap", path=path, agent="").agent == "b"
    response = call("MergeNow")
    assert (response.code, response.agents, response.aligned) == (0, 2, 1)
    operator.places("a/map")  # b is not aligned, so nothing is said of it.
    assert "is in use already" in process.log

    T = np.eye(4)
    T[0, 3] = 10.0
    assert call("SetAlignment", agent_a="a", agent_b="c", t_a_b=T.ravel()).code == 4
    assert call("SetAlignment", agent_a="a", agent_b="b", t_a_b=2 * T.ravel()).code == 5
    pair = {"agent_a": "a", "agent_b": "b", "t_a_b": T.ravel()}
    assert call("SetAlignment", **pair, covariance=-np.eye(6).ravel()).code == 7
    assert call("SetAlignment", **pair, covariance=0.01 * np.eye(6).ravel()).code == 0
    assert call("MergeNow").aligned == 2
    of_b = operator.places("a/map", "b/map")["b/map"]
    np.testing.assert_allclose(transform_matrix(of_b), T, atol=1e-9)
    assert call("SaveMap", path=str(tmp_path / "global.tmap")).code == 0
    assert load_global_map(tmp_path / "global.tmap")[2] == ("a", "b")
    takes_back_what_was_set(operator, process)
    assert call("Reset").code == 0
    assert call("SaveMap", path=str(tmp_path / "none.tmap")).code == 1
    assert process.stop(signal.SIGTERM) == 0


def takes_back_what_was_set(operator: Operator, process: NodeProcess) -> None:
    """Assert that an alignment is removed by hand, stays so, and is allowed again."""
    call, pair = operator.call, {"agent_a": "a", "agent_b": "b"}
    assert call("RemoveAlignment", **pair).code == 0
    assert call("MergeNow").aligned == 1
    removed = call("RemoveAlignment", **pair)
    told = "a and b: removed by hand, until it is allowed"
    assert (removed.code, removed.message) == (0, told)
    assert call("RemoveAlignment", agent_a="b", agent_b="a").code == 6
    assert call("MergeNow").aligned == 1
    assert "a and b: withdrawn: removed by hand" in process.log
    assert call("RemoveAlignment", **pair, allow=True).code == 0
    assert call("RemoveAlignment", **pair, allow=True).code == 6
    operator.places("a/map")


def test_a_killed_merger_takes_up_what_it_knew(own: Graph, start: Any, tmp_path: Path) -> None:
    state = tmp_path / "state"
    arguments = ("-p", "agents:=[/a, /b]", "-p", "max_rate:=10.0", "-p", f"state_file:={state}")
    first = start(MERGER, *arguments)
    call = Operator(own, first).call
    for agent in ROOMS:
        assert call("LoadMap", path=saved_map(tmp_path, agent), agent=agent).code == 0
    T = np.eye(4)
    T[0, 3] = 10.0
    assert call("SetAlignment", agent_a="a", agent_b="b", t_a_b=T.ravel()).code == 0
    assert state.exists(), "what was set by hand is kept when the service has answered"
    assert call("MergeNow").aligned == 2
    first.stop(signal.SIGKILL)

    second = start(MERGER, *arguments)
    Operator(own, second).places("a/map", "b/map")  # Nothing was sent again.
    assert "took up the maps of a, b" in second.log
    assert second.stop(signal.SIGTERM) == 0
