"""The extractor in scan mode over DDS: what is missing is named, what is unchanged is not sent."""

from __future__ import annotations

import signal
from pathlib import Path
from typing import Any

import pytest
import yaml

from test import helpers_ros
from test.helpers import box_room
from test.helpers_ros import Graph, cloud_message, set_parameters, wait_for

pytestmark = [
    pytest.mark.dds,
    pytest.mark.skipif(bool(helpers_ros.missing()), reason=helpers_ros.missing()),
]

EXTRACTOR = "topometric_ros.nodes.extractor"
NODE = "/scout/extractor"
WORK_S = 600.0


def static_transform(parent: str, child: str) -> Any:
    from geometry_msgs.msg import TransformStamped
    from tf2_msgs.msg import TFMessage

    entry = TransformStamped(child_frame_id=child)
    entry.header.frame_id = parent
    entry.transform.translation.x = 1.0
    return TFMessage(transforms=[entry])


def dumped(own: Graph) -> dict[str, Any]:
    """Return every parameter of the node, as `ros2 param dump` writes them."""
    from rcl_interfaces.srv import GetParameters, ListParameters
    from rclpy.parameter import parameter_value_to_python

    names = own.call(ListParameters, f"{NODE}/list_parameters", ListParameters.Request())
    names = [name for name in names.result.names if not name.startswith("qos_overrides")]
    request = GetParameters.Request(names=names)
    values = own.call(GetParameters, f"{NODE}/get_parameters", request).values
    found = [parameter_value_to_python(value) for value in values]
    listed = [value if isinstance(value, (str, bytes)) or not hasattr(value, "__len__") else
              list(value) for value in found]  # fmt: skip
    return dict(zip(names, listed, strict=True))


class Told:
    """What /diagnostics say of the extractor's input."""

    def __init__(self, own: Graph) -> None:
        from diagnostic_msgs.msg import DiagnosticArray

        from topometric_ros.nodes import qos

        self._diagnostics = own.subscribe(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)

    def newest(self) -> Any:
        """Return level, message and values of the newest status."""
        for message in reversed(list(self._diagnostics.messages)):
            for entry in message.status:
                if entry.name == f"{NODE}: input":
                    return entry.level, entry.message, {v.key: v.value for v in entry.values}
        return b"", "", {}

    def given_up(self) -> Any:
        """Return level and message once the first scan that lacked a transform was given up."""
        level, message, values = self.newest()
        gone = values.get("without transform") == "1" and "no scan could be placed" in message
        return (level, message) if gone else None


def test_a_missing_frame_is_named_and_an_unchanged_scan_makes_no_new_map(
    own: Graph, start: Any, tmp_path: Path
) -> None:
    from rclpy.duration import Duration
    from sensor_msgs.msg import PointCloud2
    from tf2_msgs.msg import TFMessage
    from topometric_msgs.msg import TopometricMap

    from topometric_ros.nodes import qos

    arguments = ("-r", "__ns:=/scout", "-p", "mode:=scan")
    process = start(
        EXTRACTOR, *arguments, "-p", "tf_timeout:=1.0", "-p", "max_rate:=20.0",
        "-p", "map_frame:=map", "-p", f"scans_file:={tmp_path / 'scans'}",
    )  # fmt: skip
    clouds = own.node.create_publisher(PointCloud2, "/scout/cloud", qos.CLOUD_RELIABLE)
    static = own.node.create_publisher(TFMessage, "/tf_static", qos.STATIC_TRANSFORMS)
    maps = own.subscribe(TopometricMap, "/scout/topometric_map", qos.SNAPSHOT)
    told = Told(own)
    for publisher in (clouds, static):
        wait_for(publisher.get_subscription_count, WORK_S, "extractor", (process,))
    static.publish(static_transform("odom", "lidar"))
    room = cloud_message(box_room((0.0, 0.0, 0.0), (4.0, 5.0, 2.6)), "lidar")
    clouds.publish(room)
    level, message = wait_for(told.given_up, WORK_S, "end of the scan's wait", (process,))
    assert level == b"\x01"
    assert "no frame map" in message
    wait_for(
        lambda: process.log.count("no frame map") == 1, WORK_S, "a line in the log", (process,)
    )
    assert len(maps) == 0, "no identity stands in for a transform that is missing"

    static.publish(static_transform("map", "odom"))
    # Lost beside a large cloud, a transform is sent again only after longer than a scan waits.
    assert static.wait_for_all_acked(Duration(seconds=WORK_S))
    clouds.publish(room)
    wait_for(lambda: len(maps), WORK_S, "map", (process,))
    assert (maps.last.header.frame_id, maps.last.sequence) == ("map", 1)
    clouds.publish(room)
    held = lambda: told.newest()[2].get("too little changed", "0") != "0"  # noqa: E731
    wait_for(held, WORK_S, "diagnostics entry of the unchanged scan", (process,))
    assert len(maps) == 1

    refusals = set_parameters(own, NODE, {"min_change": 7.0, "scans.core": 0.05, "tf_timeout": 2.5})
    assert "range" in refusals[0]
    assert "read-only" in refusals[1]
    assert refusals[2] == ""
    values = dumped(own)
    assert (values["tf_timeout"], values["max_rate"]) == (2.5, 20.0)
    process.stop(signal.SIGKILL)

    path = tmp_path / "dump.yaml"
    path.write_text(yaml.safe_dump({NODE: {"ros__parameters": values}}))
    first = maps.last
    again = start(EXTRACTOR, *arguments[:2], "--params-file", str(path))
    wait_for(lambda: maps.last.session != first.session, WORK_S, "map of before", (again,))
    assert (maps.last.header.frame_id, maps.last.voxel_count) == ("map", first.voxel_count)
    assert dumped(own) == values
    assert "unknown parameters" not in again.log
    assert again.stop(signal.SIGTERM) == 0


def test_scans_that_the_queue_has_no_room_for_are_told_as_lost(own: Graph, start: Any) -> None:
    from diagnostic_msgs.msg import DiagnosticArray
    from sensor_msgs.msg import PointCloud2

    from topometric_ros.nodes import qos

    # Nothing says where the lidar is, so scans wait, two at most, for longer than the test takes.
    arguments = ("-p", "scan_queue:=2", "-p", "mode:=scan", "-p", "tf_timeout:=1000.0")
    process = start(EXTRACTOR, "-r", "__ns:=/scout", *arguments)
    clouds = own.node.create_publisher(PointCloud2, "/scout/cloud", qos.CLOUD_RELIABLE)
    diagnostics = own.subscribe(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
    wait_for(clouds.get_subscription_count, WORK_S, "extractor", (process,))
    room = cloud_message(box_room((0.0, 0.0, 0.0), (4.0, 5.0, 2.6)), "lidar")
    for _ in range(5):
        clouds.publish(room)

    def lost() -> Any:
        entries = [e for m in list(diagnostics.messages) for e in m.status if "input" in e.name]
        values = [(e.level, {v.key: v.value for v in e.values}) for e in entries]
        kept = ("3", "2")
        keys = ("scans lost", "waiting for transforms")
        return [(level, v) for level, v in values if tuple(map(v.get, keys)) == kept]

    level, values = wait_for(lost, WORK_S, "lost scans in diagnostics", (process,))[-1]
    assert (level, values["superseded"]) == (b"\x01", "0")
    assert process.log.count("scans lost") == 1
    assert process.stop(signal.SIGTERM) == 0
