"""A recording becomes live topics: the same clouds, stamped with the time of day."""

from __future__ import annotations

import signal
import time
from typing import Any

import numpy as np
import pytest

from test import helpers_ros
from test.helpers_ros import Graph, wait_for

pytestmark = [
    pytest.mark.dds,
    pytest.mark.skipif(bool(helpers_ros.missing()), reason=helpers_ros.missing()),
]

DEMO = helpers_ros.ROOT / "bags" / "demo"
PLAYER = "topometric_ros.nodes.player"
WORK_S = 600.0


def test_a_bag_is_played_as_if_it_happened_now(own: Graph, start: Any) -> None:
    from sensor_msgs.msg import PointCloud2
    from tf2_msgs.msg import TFMessage

    from topometric_ros.io.bags import Bag
    from topometric_ros.nodes import qos

    topics = ("/robot1/scan_cloud", "/robot2/scan_cloud")
    clouds = [own.subscribe(PointCloud2, topic, qos.CLOUD_RELIABLE) for topic in topics]
    moving = own.subscribe(TFMessage, "/tf", qos.TRANSFORMS)
    before = time.time()
    player = start(PLAYER, "-p", f"bag:={DEMO}", "-p", "rate:=20.0")
    wait_for(lambda: "played " in player.log, WORK_S, "end of the bag", (player,))
    late = own.subscribe(TFMessage, "/tf_static", qos.STATIC_TRANSFORMS)
    wait_for(lambda: len(late) and all(map(len, clouds)), WORK_S, "latched transforms", (player,))
    with Bag(DEMO) as bag:
        *_, last = bag.messages(topics[:1])
        assert bag.topics()["/tf_static"].latched
        assert not bag.topics()["/tf"].latched
    wait_for(lambda: clouds[0].last.width == last.message.width, WORK_S, "the last scan", (player,))
    np.testing.assert_array_equal(np.frombuffer(clouds[0].last.data, np.uint8), last.message.data)
    stamps = [c.header.stamp.sec + c.header.stamp.nanosec / 1e9 for c in clouds[0].messages]
    assert before < stamps[0] < stamps[-1]

    def fits() -> bool:
        placed = [t.header.stamp for m in list(moving.messages) for t in m.transforms]
        return any(abs(stamps[-1] - s.sec - s.nanosec / 1e9) < 1e-6 for s in placed)

    wait_for(fits, WORK_S, "/tf at the time of the last scan", (player,))
    assert player.stop(signal.SIGTERM) == 0


def test_a_bag_that_is_not_there_is_told_and_nothing_is_played(start: Any) -> None:
    player = start(PLAYER, "-p", "bag:=/nowhere/bag")
    wait_for(lambda: "nothing is played: /nowhere/bag" in player.log, WORK_S, "refusal", (player,))
    assert player.stop(signal.SIGTERM) == 0
