"""How many large clouds reach an extractor: best effort and reliable, with and without the profile.

    python scripts/measure_clouds.py [--clouds 20] [--points 1000000]

A publisher and an extractor are processes of their own on this machine; the clouds of 16 bytes a
point come at 2 Hz. Prints a Markdown table of the clouds that the extractor has counted as
received and as lost on the way.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from fleet_bench import ROOT

from test import helpers_ros
from test.helpers import box_room
from topometric_ros.runtime.fleet_processes import PROFILE, PROFILE_VARIABLE

RELIABILITIES = ("best effort", "reliable")


def arrived(reliability: str, clouds: int, points: int) -> str:
    """Publish clouds to an extractor; return how many it has received, and told as lost."""
    from diagnostic_msgs.msg import DiagnosticArray
    from rclpy.qos import QoSProfile, ReliabilityPolicy
    from sensor_msgs.msg import PointCloud2

    from topometric_ros.nodes import qos

    reliable = reliability == "reliable"
    policy = ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT
    room = box_room((0.0, 0.0, 0.0), (6.0, 5.0, 2.6))
    padded = np.zeros((points, 4), np.float32)
    padded[:, :3] = np.resize(room, (points, 3))
    message = helpers_ros.cloud_message(padded[:1, :3], "a/map", point_step=16)
    message.width, message.row_step = points, 16 * points
    message.data = padded.tobytes()
    arguments = ["--ros-args", "-r", "__ns:=/a", "-p", "mode:=map", "-p", "max_rate:=0.001"]
    with helpers_ros.graph() as own, tempfile.TemporaryDirectory() as folder:
        log = Path(folder) / "log"
        process = helpers_ros.NodeProcess("topometric_ros.nodes.extractor", arguments, log)
        told = own.subscribe(DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        publisher = own.node.create_publisher(
            PointCloud2, "/a/cloud", QoSProfile(depth=5, reliability=policy)
        )
        helpers_ros.wait_for(publisher.get_subscription_count, 60.0, "extractor", (process,))
        time.sleep(2.0)  # It takes the reliability that it finds.
        for _ in range(clouds):
            publisher.publish(message)
            time.sleep(0.5)
        time.sleep(5.0)
        (entry, *_) = told.last.status
        process.stop()
    told_of = {value.key: value.value for value in entry.values}
    return f"{told_of['received']}, {told_of['lost on the way']}"


def main() -> None:
    """Run the script."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--clouds", type=int, default=20)
    parser.add_argument("--points", type=int, default=1_000_000)
    parser.add_argument("--only", choices=RELIABILITIES, help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.only:
        print(arrived(options.only, options.clouds, options.points))
        return
    print(f"| {options.clouds} clouds of {options.points:,} points | without | with the profile |")
    print("|---|---:|---:|")
    sizes = ["--clouds", str(options.clouds), "--points", str(options.points)]
    for reliability in RELIABILITIES:
        row = [reliability]
        for profile in ({}, {PROFILE_VARIABLE: str(ROOT / "config" / PROFILE)}):
            # Fast DDS reads its profiles when a process begins.
            command = [sys.executable, __file__, "--only", reliability, *sizes]
            environment = {k: v for k, v in os.environ.items() if k != PROFILE_VARIABLE}
            done = subprocess.run(
                command, env=environment | profile, check=True, text=True, stdout=subprocess.PIPE
            )
            row.append(done.stdout.strip().splitlines()[-1])
        print("| " + " | ".join(row) + " |", flush=True)


if __name__ == "__main__":
    main()
