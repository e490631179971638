"""Answers of services that wait until their caller can hear them.

A request and its answer are two topics in DDS, found apart from each other. Where a request comes
before it is known who reads the answer, as on a lossy radio, rmw_fastrtps waits a tenth of a second
and drops the answer, so that the caller waits for ever (ros2/rmw_fastrtps#842). What is known of
both topics tells when it is safe to answer.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable
from typing import Any

from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

Answer = Callable[[Any, Any], Any]

_LONGEST_S = 10.0
_LOOK_S = 0.02
_PARTICIPANT = 12
"""Bytes of an endpoint's id that it shares with all others of its process."""


def patient(node: Node, service: str, answer: Answer) -> Answer:
    """Return an answer that is given when every caller of a service is known to hear it.

    A caller of whom only one half is known after `_LONGEST_S` has most likely gone.

    Parameters
    ----------
    node : whose service it is
    service : its resolved name
    answer : from request and response to response
    """

    def answered(request: Any, response: Any) -> Any:
        found = answer(request, response)
        limit = time.monotonic() + _LONGEST_S
        while deaf(node, service) and time.monotonic() < limit:
            time.sleep(_LOOK_S)
        return found

    return answered


def deaf(node: Node, service: str) -> int:
    """Return how many callers of a service are known to ask and not yet to read answers."""
    asking = node.get_publishers_info_by_topic(f"rq{service}Request", no_mangle=True)
    reading = node.get_subscriptions_info_by_topic(f"rr{service}Reply", no_mangle=True)
    return (_by_participant(asking) - _by_participant(reading)).total()


def _by_participant(endpoints: Iterable[TopicEndpointInfo]) -> Counter[bytes]:
    return Counter(bytes(endpoint.endpoint_gid[:_PARTICIPANT]) for endpoint in endpoints)
