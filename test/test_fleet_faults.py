"""What goes wrong in a fleet of real processes, in short; `make soak` does it for longer."""

from __future__ import annotations

import dataclasses
import resource
import signal
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest

from test import helpers_ros
from test.helpers import box_room
from test.helpers_ros import Graph, NodeProcess, cloud_message, service, wait_for

pytestmark = [
    pytest.mark.dds,
    pytest.mark.skipif(bool(helpers_ros.missing()), reason=helpers_ros.missing()),
]

EXTRACTOR = "topometric_ros.nodes.extractor"
MERGER = "topometric_ros.nodes.merger"
MANAGED = "topometric_ros.nodes.managed"
WORK_S = 600.0


@cache
def extracted_room(width: float) -> Any:
    """Return the map of one room."""
    from topometric_ros.extraction.config import extraction_preset
    from topometric_ros.matching.config import matching_preset
    from topometric_ros.runtime.extract_map import extract_map

    points = box_room((0.0, 0.0, 0.0), (width, 5.0, 2.6))
    presets = extraction_preset("default"), matching_preset("default")
    names = {"agent": "a", "session": "s1", "sequence": 1, "frame_id": "a/map"}
    return extract_map(points, *presets, **names, stamp=1).map


def room_map(agent: str, sequence: int = 1, session: str = "s1", width: float = 4.0) -> Any:
    """Return one room's map as a message of rclpy's classes."""
    from topometric_ros.nodes.messages import message_classes
    from topometric_ros.runtime.message_codec import map_to_message

    names = {"agent": agent, "session": session, "sequence": sequence, "frame_id": f"{agent}/map"}
    made = dataclasses.replace(extracted_room(width), **names)
    return map_to_message(made, message_classes())


class Fleet:
    """What the test sees of a merger: the newest alignments and diagnostics."""

    def __init__(self, own: Graph, process: Any) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from topometric_msgs.msg import AlignmentArray

        from topometric_ros.nodes import qos

        self._process = process
        self.alignments = own.subscribe(AlignmentArray, "/alignments", qos.SNAPSHOT)
        self._diagnostics = own.subscribe(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)

    def agent(self, name: str) -> Any:
        """Return an agent's place in the newest alignments, or None."""
        agents = self.alignments.last.agents if len(self.alignments) else []
        return next((agent for agent in agents if agent.id == name), None)

    def at(self, name: str, **fields: Any) -> Any:
        """Wait until an agent's place has these fields; return it."""

        def found() -> Any:
            agent = self.agent(name)
            good = agent and all(getattr(agent, key) == value for key, value in fields.items())
            return agent if good else None

        return wait_for(found, WORK_S, f"{name} with {fields}", (self._process,))

    def told(self, name: str, text: str) -> Any:
        """Wait until the newest diagnostics of something say a text; return the entry."""

        def found() -> Any:
            for message in reversed(list(self._diagnostics.messages)):
                for entry in message.status:
                    if name in entry.name:
                        return entry if text in entry.message else None
            return None

        return wait_for(found, WORK_S, f"{text!r} of {name}", (self._process,))


def refuses_lies(fleet: Fleet, publisher: Any) -> None:
    """Raw bytes that are no message, a message of another agent, and one of a whole fleet."""
    publisher.publish(b"\x00\x01\x00\x00" + bytes(range(256)))
    publisher.publish(room_map("a", sequence=7))
    fleet.told("/b/topometric_map", "whose maps come on another topic")
    whole = room_map("b", sequence=8)
    whole.observers = ["x", "y"]
    publisher.publish(whole)
    fleet.told("/b/topometric_map", "a global map, of x, y")


def keeps_its_state_on_a_full_disk(
    fleet: Fleet, merger: NodeProcess, publisher: Any, state: Path
) -> None:
    """What was saved before stays whole, the merger goes on, and saves again when it can."""
    from topometric_ros.runtime.merger_state import load_state

    kept = lambda: load_state(state).maps["b"].sequence  # noqa: E731
    wait_for(lambda: state.exists() and "b" in load_state(state).maps, WORK_S, "state file")
    wait_for(lambda: kept() == 2, WORK_S, "b's newest map in the state file")
    size = state.stat().st_size // 2
    before = resource.prlimit(merger.pid, resource.RLIMIT_FSIZE, (size, -1))
    publisher.publish(room_map("b", sequence=3, width=4.5))
    fleet.at("b", sequence=3)
    fleet.told("merge", "the state was not saved")
    assert kept() == 2
    left = lambda: list(state.parent.glob(".state.*.partial"))  # noqa: E731
    wait_for(lambda: not left(), WORK_S, "end of half a file, which takes what others need")
    resource.prlimit(merger.pid, resource.RLIMIT_FSIZE, before)
    publisher.publish(room_map("b", sequence=4))
    wait_for(lambda: kept() == 4, WORK_S, "state written again")


def test_agents_that_nobody_listed_come_lie_leave_and_come_back(
    own: Graph, start: Any, tmp_path: Path
) -> None:
    from topometric_msgs.msg import TopometricMap

    from topometric_ros.nodes import qos

    state = tmp_path / "state"
    merger = start(
        MERGER, "-p", "stale_after:=1.0", "-p", "max_rate:=20.0", "-p", f"state_file:={state}"
    )
    fleet = Fleet(own, merger)
    a, b = (
        own.node.create_publisher(TopometricMap, f"/{agent}/topometric_map", qos.SNAPSHOT)
        for agent in "ab"
    )
    a.publish(room_map("a"))
    fleet.at("a", sequence=1)
    b.publish(room_map("b"))
    fleet.at("b", sequence=1, stale=False)
    refuses_lies(fleet, b)

    # Newer, older, the same again: the newest stays.
    a.publish(room_map("a", sequence=5))
    fleet.at("a", sequence=5)
    for sequence in (3, 5, 4):
        a.publish(room_map("a", sequence=sequence))
    b.publish(room_map("b", sequence=2))
    fleet.at("b", sequence=2)
    assert fleet.agent("a").sequence == 5
    keeps_its_state_on_a_full_disk(fleet, merger, b, state)

    # An agent leaves: its map is kept and marked. It comes back as a new session.
    own.node.destroy_publisher(b)
    fleet.at("b", stale=True, sequence=4)
    assert fleet.told("/b/topometric_map", "has been gone for").level == b"\x03"
    again = own.node.create_publisher(TopometricMap, "/b/topometric_map", qos.SNAPSHOT)
    again.publish(room_map("b", session="s2"))
    fleet.at("b", stale=False, session="s2")
    again.publish(room_map("b", sequence=9))
    fleet.told("/b/topometric_map", "which has ended")

    # Replayed to a merger that knows nothing, killed in between, it comes to the same.
    merger.stop(signal.SIGKILL)
    second = start(MERGER, "-p", f"state_file:={state}")
    wait_for(lambda: "took up the maps of a, b" in second.log, WORK_S, "state", (second,))
    assert merger.log.count("Traceback") == 0, merger.log
    assert second.stop(signal.SIGTERM) == 0


def test_managed_nodes_listen_only_while_they_are_active(own: Graph, start: Any) -> None:
    from lifecycle_msgs.msg import Transition
    from lifecycle_msgs.srv import ChangeState, GetState
    from sensor_msgs.msg import PointCloud2
    from topometric_msgs.msg import TopometricMap

    from topometric_ros.nodes import qos

    extractor = start(MANAGED, "-r", "__ns:=/m", "-p", "mode:=map", first=("extractor",))
    merger = start(MANAGED, "-p", "agents:=[/m]", "-p", "max_rate:=20.0", first=("merger",))
    nodes = ("/m/extractor", "/merger")

    def change(node: str, transition: int) -> bool:
        request = ChangeState.Request(transition=Transition(id=transition))
        return own.call(ChangeState, f"{node}/change_state", request).success

    def states() -> list[str]:
        request = GetState.Request()
        return [own.call(GetState, f"{n}/get_state", request).current_state.label for n in nodes]

    assert states() == ["unconfigured"] * 2
    maps = own.subscribe(TopometricMap, "/m/topometric_map", qos.SNAPSHOT)
    merged = own.subscribe(TopometricMap, "/global_map", qos.SNAPSHOT)
    clouds = own.node.create_publisher(PointCloud2, "/m/cloud", qos.SNAPSHOT)
    clouds.publish(cloud_message(box_room((0.0, 0.0, 0.0), (4.0, 5.0, 2.6)), "m/map"))
    assert all(change(node, Transition.TRANSITION_CONFIGURE) for node in nodes)
    assert states() == ["inactive"] * 2
    assert own.node.count_subscribers("/m/cloud") == 0
    assert all(change(node, Transition.TRANSITION_ACTIVATE) for node in nodes)
    wait_for(lambda: len(merged), WORK_S, "global map of the latched cloud", (extractor, merger))
    session = maps.last.session

    assert all(change(node, Transition.TRANSITION_DEACTIVATE) for node in nodes)
    gone = lambda: own.node.count_subscribers("/m/cloud") == 0  # noqa: E731
    wait_for(gone, WORK_S, "end of the subscription", (extractor,))
    count = len(merged)
    clouds.publish(cloud_message(box_room((0.0, 0.0, 0.0), (4.5, 5.0, 2.6)), "m/map"))
    assert change(nodes[0], Transition.TRANSITION_ACTIVATE)
    wait_for(lambda: maps.last.sequence == 2, WORK_S, "map of the next cloud", (extractor,))
    assert (maps.last.session, len(merged)) == (session, count), "the inactive merger is quiet"

    for transition in ("DEACTIVATE", "CLEANUP", "CONFIGURE", "ACTIVATE"):
        assert change(nodes[0], getattr(Transition, f"TRANSITION_{transition}")), transition
    wait_for(lambda: maps.last.session != session, WORK_S, "map of a new session", (extractor,))
    assert own.call(service("ExtractNow"), "/m/extractor/extract_now",
                    service("ExtractNow").Request()).code == 0  # fmt: skip
    assert change(nodes[1], Transition.TRANSITION_INACTIVE_SHUTDOWN)
    assert states() == ["active", "finalized"]
    assert [process.stop(signal.SIGTERM) for process in (extractor, merger)] == [0, 0]


def allowed(enclave: str, verb: str, agent: str) -> set[str]:
    """Return the full names that the SROS 2 policies allow a node, with its agent's name."""
    tree = ElementTree.parse(helpers_ros.ROOT / "security" / "policies.xml")
    (profile,) = tree.iterfind(f".//enclave[@path='{enclave}']/profiles/profile")
    namespace = (profile.get("ns") or "").rstrip("/")
    kind, wanted = verb.split()
    names = set()
    for element in profile.iterfind(f"{kind}[@{wanted}='ALLOW']/*"):
        name = (element.text or "").replace("~", f"{namespace}/{profile.get('node')}")
        names.add(name if name.startswith("/") else f"{namespace}/{name}")
    return {name.replace("robot1", agent).replace("cloud_map", "cloud") for name in names}


def assert_nothing_more_than_the_policies_allow(own: Graph, agent: str) -> None:
    graph = own.node
    expected = {("extractor", f"/{agent}"), ("merger", "/")}
    wait_for(
        lambda: expected <= set(graph.get_node_names_and_namespaces()), WORK_S, "both nodes known"
    )
    for node, namespace, enclave in (
        ("extractor", f"/{agent}", "/robot1/extractor"),
        ("merger", "/", "/merger"),
    ):
        for verb, opened in (
            ("topics publish", graph.get_publisher_names_and_types_by_node(node, namespace)),
            ("topics subscribe", graph.get_subscriber_names_and_types_by_node(node, namespace)),
            ("services reply", graph.get_service_names_and_types_by_node(node, namespace)),
        ):
            assert {name for name, _ in opened} <= allowed(enclave, verb, agent), (node, verb)


def test_a_clock_that_jumps_stops_neither_maps_nor_transforms(own: Graph, start: Any) -> None:
    from rosgraph_msgs.msg import Clock
    from sensor_msgs.msg import PointCloud2
    from tf2_msgs.msg import TFMessage
    from topometric_msgs.msg import TopometricMap

    from topometric_ros.nodes import qos

    sim = ("-p", "use_sim_time:=true", "-p", "max_rate:=20.0")
    extractor = start(EXTRACTOR, "-r", "__ns:=/c", *sim, "-p", "mode:=map", "-p", "min_change:=0.0")
    merger = start(MERGER, "-p", "agents:=[/c]", *sim)
    clock = own.node.create_publisher(Clock, "/clock", qos.CLOUD_BEST_EFFORT)
    clouds = own.node.create_publisher(PointCloud2, "/c/cloud", qos.CLOUD_RELIABLE)
    maps = own.subscribe(TopometricMap, "/c/topometric_map", qos.SNAPSHOT)
    transforms = own.subscribe(TFMessage, "/tf", qos.TRANSFORMS)
    for publisher in (clock, clouds):
        wait_for(publisher.get_subscription_count, WORK_S, "reader", (extractor, merger))
    assert_nothing_more_than_the_policies_allow(own, "c")
    now = [1000.0]

    def tick() -> None:
        now[0] += 0.05
        message = Clock()
        message.clock.sec, message.clock.nanosec = int(now[0]), int(now[0] % 1 * 1e9)
        clock.publish(message)

    def stamped(low: float) -> bool:
        tick()
        stamps = [t.header.stamp.sec for m in transforms.messages[-3:] for t in m.transforms]
        return len(stamps) > 1 and all(low <= stamp <= now[0] for stamp in stamps)

    room = box_room((0.0, 0.0, 0.0), (4.0, 5.0, 2.6))
    for count, start_at in enumerate((1000.0, 90_000.0, 50.0), 1):
        now[0] = start_at
        tick()
        clouds.publish(cloud_message(room + np.array([0.01 * count, 0, 0]), "c/map"))
        wait_for(lambda n=count: len(maps) >= n, WORK_S, f"map {count}", (extractor, merger))
        wait_for(lambda low=start_at: stamped(low), WORK_S, f"/tf {count}", (extractor, merger))
    assert [process.stop(signal.SIGTERM) for process in (extractor, merger)] == [0, 0]
