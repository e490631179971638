"""An agent on one side of a bad radio, the merger on the other: what was said arrives at last."""

from __future__ import annotations

import os
import re
import signal
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from test import helpers_network, helpers_ros
from test.helpers import box_room
from test.helpers_ros import wait_for

pytestmark = [
    pytest.mark.dds,
    pytest.mark.skipif(bool(helpers_ros.missing()), reason=helpers_ros.missing()),
    pytest.mark.skipif(bool(helpers_network.missing()), reason=helpers_network.missing()),
]

WORK_S = 600.0
PARTITION_S = float(os.environ.get("TOPOMETRIC_PARTITION_S", "0"))
"""How much longer the radio stays down than it takes to miss a map: `make soak` says 600."""


def bag_of_rooms(path: Path, rooms: int) -> Path:
    """Write a bag of one agent's latched map cloud: rooms in a row, with doors between them."""
    from topometric_ros.simulation.recording import START, MapRecording, write_maps

    doors = (("x+", 2.0), ("x-", 2.0))
    clouds = [box_room((4.1 * i, 0.0, 0.0), (4.0, 5.0, 2.6), doors=doors) for i in range(rooms)]
    write_maps(path, [MapRecording("a", [(START, np.concatenate(clouds).astype(np.float32))])])
    return path


def test_maps_cross_a_radio_that_loses_delays_overtakes_and_fails(
    start: Any, tmp_path: Path
) -> None:
    from topometric_ros.runtime.merger_state import load_state

    state = tmp_path / "state"
    with helpers_network.namespaces() as ((far, near), radio):
        radio.loss, radio.delay_s, radio.jitter_s, radio.rate_bps = 0.2, 0.3, 0.1, 1e6
        merger = start(
            "topometric_ros.nodes.merger", "-p", "agents:=[/a]", "-p", "max_rate:=20.0",
            "-p", f"state_file:={state}", namespace=near,
        )  # fmt: skip
        extractor = start(
            "topometric_ros.nodes.extractor", "-r", "__ns:=/a", "-r", "cloud:=cloud_map",
            "-p", "mode:=map", "-p", "max_rate:=20.0", namespace=far,
        )  # fmt: skip

        def play(rooms: int) -> Any:
            bag = bag_of_rooms(tmp_path / f"bag{rooms}", rooms)
            return start("topometric_ros.nodes.player", "-p", f"bag:={bag}", namespace=far)

        def made() -> int:
            return max(map(int, re.findall(r"map (\d+): \d+ rooms", extractor.log)), default=0)

        def arrived() -> int:
            return load_state(state).maps["a"].sequence if state.exists() else 0

        processes = [merger, extractor, play(1)]
        wait_for(lambda: arrived() == made() == 1, WORK_S, "map over the radio", processes)
        radio.cut = True
        processes.append(play(3))
        wait_for(lambda: made() == 2, WORK_S, "map while the radio is down", processes)
        assert arrived() == 1
        time.sleep(PARTITION_S)
        radio.cut = False
        wait_for(lambda: arrived() == 2, WORK_S, "what was missed", processes)
        assert radio.lost > 0
        assert [process.stop(signal.SIGTERM, WORK_S) for process in processes] == [0] * 4
    assert len(load_state(state).maps["a"].rooms) == 3
