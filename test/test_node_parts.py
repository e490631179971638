"""What the nodes are made of: QoS, the worker, markers and clouds."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from test.helpers_ros import missing, private_context, wait_for
from topometric_ros.alignment import (
    AgentPlacement,
    AgentStatus,
    Alignment,
    AlignmentStatus,
    Alternative,
    Change,
    GlobalMap,
    MergeResult,
    Placed,
)
from topometric_ros.topometric_map import Passage, Room, Storey, StoreyLayers, TopometricMap

if missing():
    pytest.skip(missing(), allow_module_level=True)

import rclpy
from builtin_interfaces.msg import Time
from geometry_msgs.msg import TransformStamped
from rclpy.executors import MultiThreadedExecutor
from rclpy.parameter import Parameter
from tf2_msgs.msg import TFMessage
from visualization_msgs.msg import Marker

from topometric_ros.nodes import qos, tf
from topometric_ros.nodes.diagnostics import Level, Status, to_message
from topometric_ros.nodes.markers import map_markers
from topometric_ros.nodes.merger_output import MergerOutput
from topometric_ros.nodes.merger_report import InputReport, MergerReport
from topometric_ros.nodes.messages import message_classes
from topometric_ros.nodes.running import TopometricNode, spin
from topometric_ros.nodes.worker import Inbox, Worker


@pytest.fixture
def context() -> Iterator[Any]:
    own = private_context()
    yield own
    own.shutdown()


def profile(reliable: bool, latched: bool) -> Any:
    return qos._profile(reliable, latched, depth=1)


def test_the_cloud_takes_the_strongest_profile_that_all_publishers_offer() -> None:
    latched, plain, lossy = profile(True, True), profile(True, False), profile(False, False)
    assert qos.describe(qos.strongest_common([latched])) == "reliable, transient local"
    assert qos.describe(qos.strongest_common([latched, plain])) == "reliable, volatile"
    assert qos.describe(qos.strongest_common([plain, lossy])) == "best effort, volatile"
    assert qos.describe(qos.strongest_common([])) == "reliable, volatile"
    assert qos.describe(qos.cloud_profile("best_effort", [latched])) == "best effort, volatile"


def test_an_inbox_keeps_the_newest_and_counts_the_rest() -> None:
    inbox: Inbox[int] = Inbox(2)
    for item in range(5):
        inbox.put(item)
    assert (inbox.take_all(), inbox.dropped, len(inbox)) == ([3, 4], 3, 0)


def test_a_worker_goes_on_after_a_failure() -> None:
    done = threading.Event()
    failures: list[Exception] = []

    def work() -> None:
        if not failures:
            raise ValueError("once")
        done.set()

    worker = Worker(work, failures.append)
    worker.wake()
    wait_for(lambda: failures, 60.0, "the first failure")
    worker.wake()
    assert done.wait(60.0)
    assert worker.stop(60.0)


def test_a_callback_that_fails_does_not_end_the_node(context: Any) -> None:
    node = rclpy.create_node("failing", context=context, use_global_arguments=False)
    told_to_end = threading.Event()
    calls: list[int] = []

    def fail() -> None:
        calls.append(1)
        if len(calls) == 3:
            told_to_end.set()
        raise RuntimeError("one bad message")

    node.create_timer(0.01, fail)
    executor = MultiThreadedExecutor(num_threads=2, context=context)
    executor.add_node(node)
    spin(executor, told_to_end)
    assert len(calls) >= 3
    executor.shutdown()
    node.destroy_node()


def test_the_pace_is_kept_while_a_simulated_clock_stands_still(context: Any) -> None:
    node = TopometricNode(
        "pace",
        context=context,
        use_global_arguments=False,
        parameter_overrides=[Parameter("use_sim_time", value=True)],
    )
    told_to_end = threading.Event()
    node.create_timer(0.01, lambda: pytest.fail("no /clock was published"))
    node.every(0.05, told_to_end.set)
    executor = MultiThreadedExecutor(num_threads=2, context=context)
    executor.add_node(node)
    limit = threading.Timer(60.0, told_to_end.set)
    limit.start()
    spin(executor, told_to_end)
    assert limit.is_alive()
    limit.cancel()
    assert "nothing comes on /clock" in node.clock_silence()
    executor.shutdown()
    node.destroy_node()


def tilted_map() -> TopometricMap:
    """Two rooms of one voxel each with a passage; the level frame lies 1 m above the input's."""
    T = np.eye(4)
    T[2, 3] = -1.0

    def room(identifier: int, x: float) -> Room:
        return Room(identifier, 0, (x, 0.0, 0.0), ((x, 0.0, 0.0), (x, 0.0, 0.0)), 1, 0.01, False)

    empty = np.zeros((1, 1), bool)
    layers = StoreyLayers(0.05, (0.0, 0.0), empty, empty, empty, empty)
    return TopometricMap(
        agent="a",
        session="s",
        sequence=1,
        frame_id="a/map",
        stamp=0,
        voxel_size=0.1,
        origin=(0.0, 0.0, 0.0),
        voxels=np.array([[0, 0, 0], [10, 0, 0]], np.int32),
        offsets=np.zeros((2, 3), np.int8),
        room=np.array([4, 7], np.int32),
        navigable=np.empty((0, 3), np.int32),
        viewpoints=np.empty((0, 3), np.float32),
        rooms=(room(4, 0.0), room(7, 1.0)),
        passages=(Passage((4, 7), (0.5, 0.0, 0.0), 0.9),),
        storeys=(Storey(0, 0.0, None, layers),),
        T_level_input=T,
    )


def test_markers_show_every_room_and_passage_in_the_agents_own_frame() -> None:
    markers = map_markers(tilted_map(), Time()).markers
    assert markers[0].action == Marker.DELETEALL
    rooms = [m for m in markers if m.ns == "rooms"]
    assert [(m.id, m.pose.position.x, m.pose.position.z) for m in rooms] == [(4, 0, 1), (7, 1, 1)]
    (edges,) = (m for m in markers if m.ns == "edges")
    assert [(p.x, p.z) for p in edges.points] == [(0.0, 1.0), (0.5, 1.0), (1.0, 1.0), (0.5, 1.0)]
    assert {m.header.frame_id for m in markers} == {"a/map"}


def test_what_has_changed_between_visits_is_told_live(context: Any) -> None:
    node = TopometricNode("changes", context=context, use_global_arguments=False)
    agents = tuple(
        AgentPlacement(name, name, AgentStatus.ALIGNED, "", 0, np.eye(4), np.eye(4))
        for name in ("monday", "today")
    )
    change = Change(0, 1, gone=True, ordered=True, points=np.zeros((40, 3)))
    fused = GlobalMap(tilted_map(), np.ones(2, np.uint32), changes=(change,))
    told = MergerOutput(node, message_classes()).publish_map(
        MergeResult("global", agents, (), fused), -1
    )
    line = "changed: 40 voxels of monday stand where today saw the bare floor (older, so they are"
    assert [text.startswith(line) for text in told] == [True]
    report = MergerReport(placed=Placed("global", agents, ()), changes=told)
    assert report.statuses("merger", 0)[0].values["change 1"] == told[0]
    node.destroy_node()


def test_the_mergers_own_transforms_do_not_move_an_agents_map() -> None:
    message = TFMessage(transforms=[TransformStamped(child_frame_id=c) for c in ("map", "odom")])
    message.transforms[0].header.frame_id = "global"
    message.transforms[1].header.frame_id = "map"
    kept = tf.without_parent(message, "/global").transforms
    assert [entry.child_frame_id for entry in kept] == ["odom"]


def test_diagnostics_carry_level_and_numbers() -> None:
    status = Status("extractor: input", Level.ERROR, "refused", {"clouds": 3, "age": 0.25})
    (entry,) = to_message([status], "a", Time()).status
    assert (entry.level, entry.hardware_id) == (b"\x02", "a")
    assert {pair.key: pair.value for pair in entry.values} == {"clouds": "3", "age": "0.25"}


def test_diagnostics_of_a_pair_tell_what_is_known_of_it_and_no_more() -> None:
    def told(alignment: Alignment) -> tuple[str, dict[str, Any]]:
        placed = Placed("global", (), (alignment,))
        report = MergerReport({"a": InputReport("/a/topometric_map", newest=tilted_map())}, placed)
        entry = report.statuses("/merger", now=0)[-1]
        return entry.message, dict(entry.values)

    rivals = (Alternative(np.eye(4), 40.0), Alternative(np.eye(4), 30.0))
    pair, accepted = ("a", "b"), AlignmentStatus.ACCEPTED
    numbers = {"confidence": 0.8, "overlap": 0.6, "rmse": 0.02, "score": 90.0, "inliers": 0.75}
    message, values = told(
        Alignment(pair, accepted, "12 m of wall agree", np.eye(4), rivals, **numbers)
    )
    assert message == "accepted: 12 m of wall agree"
    assert (values["rooms"], values["candidates"]) == ("2 and 0", 3)
    assert (values["score"], values["score of the next best"]) == (90.0, 40.0)
    assert (values["confidence"], values["confidence needed"]) == (0.8, 0.5)
    assert (values["inliers"], values["overlap"], values["rmse [m]"]) == (0.75, 0.6, 0.02)
    _, values = told(
        Alignment(pair, AlignmentStatus.AMBIGUOUS, "twins", alternatives=rivals, score=40.0)
    )
    assert (values["candidates"], values["score of the next best"]) == (2, 30.0)
    assert not {"inliers", "overlap", "rmse [m]"} & set(values), "there is no pose"
    _, values = told(Alignment(pair, accepted, "adopted", np.eye(4), overlap=0.5))
    assert not {"inliers", "score of the next best"} & set(values)
