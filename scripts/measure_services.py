"""How many service calls go unanswered over a bad radio, each from a process not seen before.

    python scripts/measure_services.py [--seconds 900] [--plain]

A node that offers a service runs in one network namespace, callers in another; between them frames
are lost, late and out of order. Every call comes from a new participant, as that of `ros2 service
call` does, and counts as unanswered after `--limit` seconds. `--plain` answers as rclpy does by
itself, at once. Needs root; prints a line of Markdown.
"""

from __future__ import annotations

import argparse
import statistics
import subprocess
import sys
import time

from rclpy.node import Node

from test import helpers_network, helpers_ros
from topometric_ros.nodes.running import TopometricNode, run
from topometric_ros.nodes.services import offer

NAME = "/server/extract_now"


class _Server(TopometricNode):
    """A node whose one service answers."""

    def __init__(self, plain: bool) -> None:
        super().__init__("server")
        self._plain = plain

    def _set_up(self) -> None:
        pass

    def _begin(self) -> None:
        kind = helpers_ros.service("ExtractNow")
        if self._plain:
            Node.create_service(self, kind, NAME, lambda _, response: response)
        else:
            offer(self, ((kind, NAME, lambda _, response: response),))

    def _stop_work(self, limit_s: float) -> bool:
        return True


def calls(seconds: float, limit_s: float) -> list[float]:
    """Return how long each call took, s; infinite where it was not answered."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor

    kind = helpers_ros.service("ExtractNow")
    took, end = [], time.monotonic() + seconds
    while time.monotonic() < end:
        context = rclpy.Context()
        rclpy.init(context=context)
        node = rclpy.create_node("caller", context=context)
        executor = SingleThreadedExecutor(context=context)
        executor.add_node(node)
        client = node.create_client(kind, NAME)
        while not client.service_is_ready():
            executor.spin_once(timeout_sec=0.01)
        begin = time.monotonic()
        future = client.call_async(kind.Request())
        executor.spin_until_future_complete(future, timeout_sec=limit_s)
        took.append(time.monotonic() - begin if future.done() else float("inf"))
        executor.shutdown()
        node.destroy_node()
        context.shutdown()
    return took


def measure(options: argparse.Namespace) -> str:
    """Return what came of the calls of `options.seconds`, a line of Markdown."""
    radio_of = ("loss", "delay_s", "jitter_s")
    given = [sys.executable, __file__, *sys.argv[1:], "--as"]
    reach = {**helpers_ros.environment(), "ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"}
    with helpers_network.namespaces() as ((far, near), radio):
        radio.loss, radio.delay_s, radio.jitter_s = (getattr(options, name) for name in radio_of)
        within = ["ip", "netns", "exec"]
        server = subprocess.Popen([*within, near, *given, "server"], env=reach)
        try:
            told = subprocess.run(
                [*within, far, *given, "caller"], env=reach, stdout=subprocess.PIPE, check=True
            )
        finally:
            server.terminate()
            server.wait()
    took = [float(text) for text in told.stdout.split()]
    lost = sum(seconds == float("inf") for seconds in took)
    return (
        f"| {'rclpy alone' if options.plain else 'these nodes'} | {lost} of {len(took)} | "
        f"{statistics.median(took):.1f} s |"
    )


def main() -> None:
    """Run the script."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--seconds", type=float, default=900.0)
    parser.add_argument("--limit", type=float, default=60.0, help="s that a call is waited for")
    parser.add_argument("--loss", type=float, default=0.2, help="share of frames lost")
    parser.add_argument("--delay_s", type=float, default=0.3)
    parser.add_argument("--jitter_s", type=float, default=0.1)
    parser.add_argument("--plain", action="store_true", help="answer as rclpy does by itself")
    parser.add_argument("--as", dest="part", choices=("server", "caller"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.part == "server":
        sys.exit(run(lambda: _Server(options.plain), sys.argv[:1]))
    if options.part == "caller":
        print(*calls(options.seconds, options.limit))
        return
    print(measure(options))


if __name__ == "__main__":
    main()
