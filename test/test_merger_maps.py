"""Maps that nobody publishes: of files, and of agents that are off when the merger starts again."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest

from test import helpers_ros
from test.helpers_io import random_map
from test.helpers_ros import Graph, NodeProcess, service, wait_for
from topometric_ros.io.map_files import save_map

pytestmark = [
    pytest.mark.dds,
    pytest.mark.skipif(bool(helpers_ros.missing()), reason=helpers_ros.missing()),
]

MERGER = "topometric_ros.nodes.merger"
WORK_S = 600.0


def test_a_map_of_another_day_stays_and_who_is_off_after_a_restart_is_told_with_its_map(
    own: Graph, start: Any, tmp_path: Path
) -> None:
    from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
    from topometric_msgs.msg import TopometricMap

    from topometric_ros.nodes import qos
    from topometric_ros.nodes.messages import message_classes
    from topometric_ros.runtime.message_codec import map_to_message

    save_map(tmp_path / "monday.tmap", random_map(3, "robot7"))
    save_map(tmp_path / "loaded.tmap", random_map(5, "b"))
    diagnostics = own.subscribe(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)

    def statuses() -> dict[str, tuple[Any, str, dict[str, str]]]:
        """Return level, message and values of each agent and of the merge, by the last word."""
        newest = list(diagnostics.messages)[-1:]
        return {
            s.name.split()[-1]: (s.level, s.message, {v.key: v.value for v in s.values})
            for entry in newest
            for s in entry.status
        }

    def told(process: NodeProcess, name: str, key: str, value: str) -> Any:
        def found() -> Any:
            status = statuses().get(name, (0, "", {}))
            return status if status[2].get(key) == value else None

        return wait_for(found, WORK_S, f"{key} {value} of {name}", (process,))

    def merged() -> int:
        request = service("MergeNow").Request()
        return int(own.call(service("MergeNow"), "/merger/merge_now", request).agents)

    files = [f"old={tmp_path / 'monday.tmap'}", f"gone={tmp_path / 'gone.tmap'}"]
    arguments = ("-p", f"agents:=[{files[0]}, /a, /b, {files[1]}]", "-p", "stale_after:=1.0")
    arguments += ("-p", f"state_file:={tmp_path / 'state'}")
    first = start(MERGER, *arguments, "-p", "forget_after:=2.0")
    publisher = own.node.create_publisher(TopometricMap, "/a/topometric_map", qos.SNAPSHOT)
    publisher.publish(map_to_message(random_map(4, "a"), message_classes()))
    told(first, "/a/topometric_map", "agent", "a")
    request = service("LoadMap").Request(path=str(tmp_path / "loaded.tmap"))
    assert own.call(service("LoadMap"), "/merger/load_map", request).code == 0
    assert merged() == 3
    own.node.destroy_publisher(publisher)
    wait_for(lambda: "a: gone for 2 s, forgotten" in first.log, WORK_S, "a to go", (first,))
    of_a = lambda: statuses().get("/a/topometric_map", (0, "", {}))  # noqa: E731
    off = lambda: "nobody publishes" in of_a()[1]  # noqa: E731
    wait_for(off, WORK_S, "a without a map", (first,))
    told(first, str(tmp_path / "monday.tmap"), "agent", "old")
    level, message, values = told(first, "/b/topometric_map", "file", str(tmp_path / "loaded.tmap"))
    assert level == DiagnosticStatus.WARN, "not aligned, but neither stale nor forgotten"
    assert (level, message.split(":")[0]) == (DiagnosticStatus.WARN, "unaligned")
    assert "map of gone refused" in first.log
    assert statuses()[str(tmp_path / "gone.tmap")][0] == DiagnosticStatus.ERROR
    publisher = own.node.create_publisher(TopometricMap, "/a/topometric_map", qos.SNAPSHOT)
    publisher.publish(map_to_message(random_map(4, "a"), message_classes()))
    told(first, "/a/topometric_map", "received", "2")
    assert merged() == 3, "who comes back is not forgotten at once again"
    first.stop(signal.SIGKILL)
    own.node.destroy_publisher(publisher)

    # A last word of the first one may still be under way: of it two maps had been received.
    second = start(MERGER, *arguments)
    _, message, values = told(second, "/a/topometric_map", "received", "0")
    assert values["agent"] == "a", "its map is that of the state file"
    assert "no map yet" not in message
    told(second, "/b/topometric_map", "file", str(tmp_path / "loaded.tmap"))
    stale = lambda: of_a()[0] == DiagnosticStatus.STALE  # noqa: E731
    wait_for(stale, WORK_S, "a to be stale", (second,))
    assert statuses()["/b/topometric_map"][0] != DiagnosticStatus.STALE
    merges = lambda: statuses()["merge"][1].startswith("1 of 4 agents")  # noqa: E731
    wait_for(merges, WORK_S, "1 of 4 agents", (second,))
    assert second.stop(signal.SIGTERM) == 0
