"""The real extractor and merger processes over DDS: what a user's robots would meet."""

from __future__ import annotations

import json
import signal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from test import helpers_ros
from test.helpers import box_room
from test.helpers_ros import (
    Graph,
    cloud_message,
    service,
    set_parameters,
    transform_matrix,
    wait_for,
)

pytestmark = [
    pytest.mark.dds,
    pytest.mark.skipif(bool(helpers_ros.missing()), reason=helpers_ros.missing()),
]

DEMO = helpers_ros.ROOT / "bags" / "demo"
EXTRACTOR = "topometric_ros.nodes.extractor"
MERGER = "topometric_ros.nodes.merger"
START_S = 600.0
WORK_S = 600.0


def flat() -> np.ndarray:
    """Two rooms with a door between them, (N, 3) m."""
    a = box_room((0.0, 0.0, 0.0), (4.0, 5.0, 2.6), doors=(("x+", 2.0),))
    b = box_room((4.1, 0.0, 0.0), (5.0, 5.0, 2.6), doors=(("x-", 2.0),))
    return np.concatenate([a, b])


def difference(T_found: np.ndarray, T_true: np.ndarray) -> tuple[float, float]:
    """Return how far two transforms are apart: metres and degrees."""
    D = np.linalg.inv(T_true) @ T_found
    angle = np.degrees(np.arccos(np.clip((np.trace(D[:3, :3]) - 1) / 2, -1, 1)))
    return float(np.linalg.norm(D[:3, 3])), float(angle)


def test_two_robots_recorded_scans_become_one_global_map(
    own: Graph, start: Any, tmp_path: Path
) -> None:
    from tf2_msgs.msg import TFMessage
    from topometric_msgs.msg import Alignment, AlignmentArray, TopometricMap

    from topometric_ros.io.trajectories import read_trajectories
    from topometric_ros.nodes import qos

    T_true = np.array(json.loads((DEMO.parent / "demo.truth.json").read_text())["T_robot1_robot2"])
    names = ("robot1", "robot2")
    extractors = [
        start(EXTRACTOR, "-r", f"__ns:=/{name}", "-r", "cloud:=scan_cloud", "-p", "max_rate:=0.1")
        for name in names
    ]
    merger = start(MERGER, "-p", "agents:=[/robot1, /robot2]")
    processes = (*extractors, merger)
    alignments = own.subscribe(AlignmentArray, "alignments", qos.SNAPSHOT)
    maps = own.subscribe(TopometricMap, "global_map", qos.SNAPSHOT)
    transforms = own.subscribe(TFMessage, "/tf", qos.TRANSFORMS)
    # Both extractors read these, and of the first this test does too.
    listeners = {"/tf": 3, "/tf_static": 2}
    helpers_ros.play_bag(own, DEMO, rate=4.0, limit_s=START_S, listeners=listeners)
    for name in names:
        request = service("ExtractNow").Request()
        response = own.call(service("ExtractNow"), f"/{name}/extractor/extract_now", request)
        assert response.code == 0, response.message
    saved = tmp_path / "robot1.tmap"
    request = service("SaveMap").Request(path=str(saved))
    assert own.call(service("SaveMap"), "/robot1/extractor/save_map", request).code == 0
    (way,) = read_trajectories(saved)
    assert way.agent == "robot1"
    assert np.ptp(way.positions, axis=0).max() > 5.0

    def accepted() -> Any:
        states = alignments.last.alignments if len(alignments) else []
        return next((a for a in states if a.status == Alignment.ACCEPTED), None)

    wait_for(accepted, WORK_S, "accepted alignment", processes)
    response = own.call(service("MergeNow"), "/merger/merge_now", service("MergeNow").Request())
    assert (response.code, response.agents, response.aligned) == (0, 2, 2), response.message
    alignment = wait_for(accepted, WORK_S, "accepted alignment", processes)
    metres, degrees = difference(np.array(alignment.t_a_b).reshape(4, 4), T_true)
    assert metres < 0.15
    assert degrees < 1.0
    both = lambda: len(maps) and set(maps.last.observers) == set(names)  # noqa: E731
    wait_for(both, WORK_S, "global map of both", processes)
    assert maps.last.voxel_count > 0
    assert len(maps.last.rooms) > 0

    placed = wait_for(lambda: placements(transforms, names), WORK_S, "/tf of both", processes)
    metres, degrees = difference(np.linalg.inv(placed["robot1"]) @ placed["robot2"], T_true)
    assert metres < 0.15
    assert degrees < 1.0
    assert [process.stop(signal.SIGTERM) for process in processes] == [0, 0, 0]


def placements(transforms: Any, agents: tuple[str, ...]) -> dict[str, Any] | None:
    """Return the newest transform of each agent to the global frame, once all are there."""
    found = {
        entry.child_frame_id.split("/")[0]: transform_matrix(entry.transform)
        for message in list(transforms.messages)
        for entry in message.transforms
        if entry.header.frame_id == "global"
    }
    return found if set(found) == set(agents) else None


def test_a_latched_map_that_was_published_before_the_extractor_started_is_received(
    own: Graph, start: Any
) -> None:
    from sensor_msgs.msg import PointCloud2
    from topometric_msgs.msg import TopometricMap

    from topometric_ros.nodes import qos

    publisher = own.node.create_publisher(PointCloud2, "/early/cloud_map", qos.SNAPSHOT)
    publisher.publish(cloud_message(flat(), "early/map"))
    maps = own.subscribe(TopometricMap, "/early/topometric_map", qos.SNAPSHOT)
    process = start(EXTRACTOR, "-r", "__ns:=/early", "-r", "cloud:=cloud_map")
    wait_for(lambda: len(maps), WORK_S, "map", (process,))
    assert (maps.last.agent, maps.last.header.frame_id) == ("early", "early/map")
    assert len(maps.last.rooms) == 2
    assert "transient local" in process.log
    # No other cloud comes, and other parameters make another map of the one that was latched.
    assert set_parameters(own, "/early/extractor", {"narrowings.smallest_area": 1e3}) == [""]
    wait_for(lambda: len(maps) >= 2, WORK_S, "map with the new parameters", (process,))
    assert maps.last.sequence == 2
    assert len(maps.last.rooms) < 2
    assert process.stop(signal.SIGINT) == 0


def test_a_cloud_that_cannot_be_right_is_refused_and_the_next_good_one_works(
    own: Graph, start: Any, tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import PointCloud2
    from topometric_msgs.msg import TopometricMap

    from topometric_ros.nodes import qos

    process = start(EXTRACTOR, "-r", "__ns:=/bad", "-p", "mode:=map")
    publisher = own.node.create_publisher(PointCloud2, "/bad/cloud", qos.CLOUD_RELIABLE)
    maps = own.subscribe(TopometricMap, "/bad/topometric_map", qos.SNAPSHOT)
    diagnostics = own.subscribe(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
    wait_for(publisher.get_subscription_count, START_S, "extractor", (process,))
    publisher.publish(cloud_message(flat(), "bad/map", point_step=16))

    def refused() -> bool:
        return any(
            status.level == b"\x02" and "row_step" in status.message
            for message in list(diagnostics.messages)
            for status in message.status
        )

    wait_for(refused, WORK_S, "diagnostics entry of the refused cloud", (process,))
    assert process.alive
    assert len(maps) == 0
    assert process.log.count("row_step") == 1
    publisher.publish(cloud_message(flat(), "bad/map"))
    wait_for(lambda: len(maps), WORK_S, "map of the good cloud", (process,))

    refusals = set_parameters(own, "/bad/extractor", {"voxel_size": 0.2, "storeys.headroom": 99.0})
    assert "read-only" in refusals[0]
    assert "range" in refusals[1]

    path = tmp_path / "saved.tmap"
    request = service("SaveMap").Request(path=str(path))
    response = own.call(service("SaveMap"), "/bad/extractor/save_map", request)
    assert (response.code, response.path) == (0, str(path)), response.message
    from topometric_ros.io.map_files import load_map

    assert load_map(path).sequence == maps.last.sequence
    session = maps.last.session
    response = own.call(service("Reset"), "/bad/extractor/reset", service("Reset").Request())
    assert response.code == 0
    assert response.session not in ("", session)
    assert process.stop(signal.SIGTERM) == 0


def test_a_wrong_parameter_ends_the_node_with_one_line_and_status_two(start: Any) -> None:
    process = start(EXTRACTOR, "-p", "voxel_size:=-1.0")
    assert process.wait(START_S) == 2
    assert process.log.count("voxel_size: expected") == 1
    assert "Traceback" not in process.log
