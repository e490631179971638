"""The `player` node: a simulated fleet, or a bag, as live topics stamped with the time of day.

For trying the other nodes without robots, and for measuring them. It waits until somebody listens
to every cloud, plays once in the recorded rhythm, and stays, so that what is latched stays too.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
import threading
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from rclpy.publisher import Publisher
from rclpy.qos import QoSProfile
from sensor_msgs.msg import PointCloud2
from tf2_msgs.msg import TFMessage
from topometric_msgs.msg import TopometricMap

from topometric_ros.errors import TopometricError
from topometric_ros.io.bag_messages import CLOUD_TYPE, MAP_TYPE, TRANSFORM_TYPE, typestore
from topometric_ros.io.bags import Bag, TopicInfo
from topometric_ros.nodes import parameters, qos
from topometric_ros.nodes.config import PlayerNodeConfig
from topometric_ros.nodes.running import TopometricNode, describe_failure, log_to, run
from topometric_ros.nodes.worker import Worker
from topometric_ros.runtime.agents_file import simulated_names

_TYPES = {CLOUD_TYPE: PointCloud2, TRANSFORM_TYPE: TFMessage, MAP_TYPE: TopometricMap}
_LOOK_S = 0.2
_SECOND = 1_000_000_000


class Player(TopometricNode):
    """Plays one recording; `done` is set when the last message was published."""

    def __init__(self) -> None:
        super().__init__("player", automatically_declare_parameters_from_overrides=True)
        log_to(self)
        config = (PlayerNodeConfig(),)
        fixed = [info.name for info in parameters.infos(config)]
        (self._own,) = parameters.declare(self, config, fixed)
        self.done = threading.Event()
        self._stopping = threading.Event()

    def _set_up(self) -> None:
        """Everything is made once it is known what the recording holds."""

    def _begin(self) -> None:
        self._worker = Worker(self._play, self._failed)
        self._worker.wake()

    def _stop_work(self, limit_s: float) -> bool:
        self._stopping.set()
        return self._worker.stop(limit_s)

    def _failed(self, error: Exception) -> None:
        self.get_logger().error(f"nothing is played: {describe_failure(error)}")

    def _play(self) -> None:
        if self._own.bag:
            self._play_bag(Path(self._own.bag).expanduser())
            return
        with tempfile.TemporaryDirectory(prefix="topometric-") as folder:
            path = Path(folder) / "bag"
            self.get_logger().info(f"simulating {self._own.agents} agents in {self._own.building}")
            simulate_fleet(self._own, path)
            self._play_bag(path)

    def _play_bag(self, path: Path) -> None:
        with Bag(path) as bag:
            topics = [topic for topic in bag.topics().values() if topic.type in _TYPES]
            if not topics:
                raise PlayerError(f"{path}: no topic of {', '.join(_TYPES)}")
            publishers = {topic.name: self._publisher(topic) for topic in topics}
            self._wait_for_listeners([publishers[t.name] for t in topics if t.type == CLOUD_TYPE])
            first, begin = None, time.time_ns()
            for entry in bag.messages(list(publishers)):
                first = entry.time if first is None else first
                if self._stopping.wait(self._ahead(entry.time - first, begin)):
                    return
                for header in _headers(entry.message):
                    self._stamp(header, first, begin)
                raw = typestore().serialize_cdr(entry.message, entry.type)
                publishers[entry.topic].publish(bytes(raw))
        self.get_logger().info(f"played {', '.join(sorted(publishers))}")
        self.done.set()

    def _publisher(self, topic: TopicInfo) -> Publisher:
        return self.create_publisher(_TYPES[topic.type], topic.name, profile(topic))

    def _wait_for_listeners(self, publishers: Sequence[Publisher]) -> None:
        limit = time.monotonic() + self._own.patience
        while any(publisher.get_subscription_count() == 0 for publisher in publishers):
            if time.monotonic() > limit:
                self.get_logger().warning("nobody listens to every cloud; played all the same")
                return
            if self._stopping.wait(_LOOK_S):
                return

    def _ahead(self, since_first: int, begin: int) -> float:
        """Return how long (s) to wait for a message."""
        return max(0.0, (begin - time.time_ns() + since_first / self._own.rate) / _SECOND)

    def _stamp(self, header: Any, first: int, begin: int) -> None:
        """Move a stamp to the present, in the rhythm in which it is played."""
        recorded = header.stamp.sec * _SECOND + header.stamp.nanosec
        now = begin + round((recorded - first) / self._own.rate)
        header.stamp.sec, header.stamp.nanosec = divmod(now, _SECOND)


class PlayerError(TopometricError):
    """A recording in which there is nothing to play."""


def simulate_fleet(config: PlayerNodeConfig, path: Path) -> None:
    """Write the bag of a simulated fleet; raises TopometricError where the building has no way."""
    from topometric_ros.simulation.buildings import load_building
    from topometric_ros.simulation.case_bags import write_bag
    from topometric_ros.simulation.cases import SimulationConfig, simulate

    wanted = SimulationConfig(agents=config.agents, overlap=config.overlap)
    case = simulate(load_building(config.building), wanted, config.seed)
    named = zip(case.agents, simulated_names(len(case.agents)), strict=True)
    agents = tuple(dataclasses.replace(agent, id=name) for agent, name in named)
    write_bag(dataclasses.replace(case, agents=agents), path, config.clouds)


def profile(topic: TopicInfo) -> QoSProfile:
    """Return the quality of service with which a recorded topic is played."""
    if topic.type == TRANSFORM_TYPE:
        return qos.STATIC_TRANSFORMS if topic.latched else qos.TRANSFORMS
    return qos.SNAPSHOT if topic.latched else qos.CLOUD_RELIABLE


def _headers(message: Any) -> list[Any]:
    transforms = getattr(message, "transforms", None)
    return [message.header] if transforms is None else [t.header for t in transforms]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the player until SIGINT or SIGTERM."""
    sys.exit(run(Player, arguments))


if __name__ == "__main__":
    main()
