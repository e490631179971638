"""Answers wait for callers of whom only the request is known; else these would wait for ever."""

from __future__ import annotations

import threading
import time
from typing import Any

import pytest

from test.helpers_ros import Graph, graph, missing, private_context, service, wait_for

if missing():
    pytest.skip(missing(), allow_module_level=True)

from rcl_interfaces.srv import GetParameters
from rclpy.executors import MultiThreadedExecutor

from topometric_ros.nodes import answers
from topometric_ros.nodes.managed import _Managed
from topometric_ros.nodes.running import TopometricNode, spin

NAME = "/waiting/extract_now"


def test_an_answer_waits_until_its_caller_is_known_to_read_it(
    own: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    kind = service("ExtractNow")
    answered: list[float] = []
    found = own.node.get_subscriptions_info_by_topic
    # The half of a caller that reads answers is found a second after the half that asks.
    shown = time.monotonic() + 1.0

    def half(topic: str, no_mangle: bool = False) -> Any:
        return found(topic, no_mangle) if time.monotonic() > shown else []

    monkeypatch.setattr(own.node, "get_subscriptions_info_by_topic", half)

    def answer(_request: Any, response: Any) -> Any:
        answered.append(time.monotonic())
        response.rooms = 7
        return response

    own.node.create_service(kind, NAME, answers.patient(own.node, NAME, answer))
    with graph("caller") as caller:
        assert caller.call(kind, NAME, kind.Request()).rooms == 7
        assert len(answered) == 1
        assert time.monotonic() > shown
    wait_for(lambda: answers.deaf(own.node, NAME) == 0, 60.0, "end of the caller")


class Node(_Managed):
    """A node that does nothing, with a managed life."""

    def __init__(self, context: Any) -> None:
        TopometricNode.__init__(self, "waiting", context=context, use_global_arguments=False)
        self._be_managed()


def test_the_services_of_parameters_and_of_a_managed_life_are_patient_too() -> None:
    context = private_context()
    node = Node(context)
    offered = {s.srv_name.rpartition("/")[2]: s.callback.__qualname__ for s in node.services}
    for name in ("set_parameters", "list_parameters", "change_state", "get_state"):
        assert offered[name].startswith("patient."), name
    node.destroy_node()
    context.shutdown()


def test_what_waits_for_a_caller_holds_up_no_timer(
    own: Graph, monkeypatch: pytest.MonkeyPatch
) -> None:
    context = private_context()
    node = TopometricNode("held", context=context, use_global_arguments=False)
    ticks: list[float] = []
    asked: list[int] = []
    node.every(0.02, lambda: ticks.append(time.monotonic()))

    def deaf(_node: Any, _service: str) -> bool:
        asked.append(len(ticks))
        return len(ticks) < asked[0] + 5

    monkeypatch.setattr(answers, "deaf", deaf)
    executor = MultiThreadedExecutor(num_threads=3, context=context)
    executor.add_node(node)
    told_to_end = threading.Event()
    spinning = threading.Thread(target=spin, args=(executor, told_to_end))
    spinning.start()
    try:
        own.call(GetParameters, "/held/get_parameters", GetParameters.Request(names=["rate"]))
    finally:
        told_to_end.set()
        spinning.join()
        executor.shutdown()
        node.destroy_node()
        context.shutdown()
    assert asked[-1] >= asked[0] + 5
