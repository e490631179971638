"""Real processes over DDS for tests: a private graph, node processes, and a bag player.

Import this only where rclpy is known to be there; :func:`missing` says whether it is.
"""

from __future__ import annotations

import array
import contextlib
import functools
import importlib
import importlib.util
import os
import signal
import socket
import subprocess
import sys
import threading
import time
import traceback
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

ROOT = Path(__file__).resolve().parent.parent

_LEAKS = ("ROS_DISCOVERY_SERVER", "ROS_STATIC_PEERS", "ROS_LOCALHOST_ONLY")
"""What a developer's shell may say of the graph, and the private one must not hear."""


@functools.cache
def _domain() -> tuple[int, socket.socket]:
    """Return a domain of this test run alone, and the socket that keeps it from other runs.

    A domain is free where nobody has the port by which runs claim it, TCP's of that number, and
    nobody the first participant's own, as what an ended run may have left behind has.
    """
    for attempt in range(100):
        domain = 1 + (os.getpid() + attempt) % 100
        claim = socket.socket()
        try:
            claim.bind(("127.0.0.1", 7400 + 250 * domain))
            with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as metatraffic:
                metatraffic.bind(("", 7410 + 250 * domain))
        except OSError:
            claim.close()
            continue
        return domain, claim
    raise AssertionError("no DDS domain is free")


def missing() -> str:
    """Return why tests that need ROS cannot run here, or an empty string."""
    for module in ("rclpy", "topometric_msgs", "tf2_msgs"):
        if importlib.util.find_spec(module) is None:
            return f"{module} is not installed (`make` installs it)"
    return ""


def environment() -> dict[str, str]:
    """Return the environment of every process of the private graph."""
    return {
        **{name: value for name, value in os.environ.items() if name not in _LEAKS},
        "ROS_DOMAIN_ID": str(_domain()[0]),
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]),
        "PYTHONUNBUFFERED": "1",
        "PYTHONFAULTHANDLER": "1",
    }


_AGAIN_S = 60.0


class NodeProcess:
    """One node of this package as a process of its own, its output in a file."""

    def __init__(self, module: str, arguments: list[str], log: Path, namespace: str = "") -> None:
        """Start it, in a network namespace where one is named; there it talks to all it reaches."""
        self.log_path = log
        self._log = log.open("a")
        within = ["ip", "netns", "exec", namespace] if namespace else []
        reach = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET"} if namespace else {}
        self._process = subprocess.Popen(
            [*within, sys.executable, "-m", module, *arguments],
            env={**environment(), **reach},
            stdout=self._log,
            stderr=subprocess.STDOUT,
        )

    @property
    def pid(self) -> int:
        """The process's number."""
        return self._process.pid

    @property
    def alive(self) -> bool:
        """Whether the process is still running."""
        return self._process.poll() is None

    @property
    def log(self) -> str:
        """What the process has said so far."""
        # What is being written may end within a letter.
        return self.log_path.read_text(errors="replace")

    def send(self, number: int) -> None:
        """Send a signal to the process."""
        self._process.send_signal(number)

    def stop(self, number: int = signal.SIGTERM, limit_s: float = 120.0) -> int:
        """Send a signal and return the exit status; a process that stays is killed."""
        if self.alive:
            self._process.send_signal(number)
        return self.wait(limit_s)

    def wait(self, limit_s: float) -> int:
        """Return the exit status of a process that ends by itself."""
        try:
            return self._process.wait(limit_s)
        except subprocess.TimeoutExpired:
            # The fault handler then writes where every thread stands.
            self._process.send_signal(signal.SIGABRT)
            self._process.wait()
            raise AssertionError(f"still running after {limit_s} s:\n{self.log}") from None
        finally:
            self._log.close()


class Received:
    """The messages that a subscription got, in order."""

    def __init__(self) -> None:
        self.messages: list[Any] = []

    @property
    def last(self) -> Any:
        """The newest message."""
        return self.messages[-1]

    def __len__(self) -> int:
        return len(self.messages)


class Graph:
    """The test's own node on the private graph, spun in the background."""

    def __init__(self, name: str = "test") -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        self._context = private_context()
        self.node = rclpy.create_node(name, context=self._context)
        self._executor = SingleThreadedExecutor(context=self._context)
        self._executor.add_node(self.node)
        self._stopping = False
        self._thread = threading.Thread(target=self._spin, daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        while not self._stopping:
            try:
                self._executor.spin_once(timeout_sec=0.1)
            except (
                Exception
            ):  # A damaged message, such as a text that is no UTF-8, ends itself only.
                traceback.print_exc()

    def close(self) -> None:
        """Leave the graph."""
        self._stopping = True
        self._thread.join()
        self._executor.shutdown()
        self.node.destroy_node()
        self._context.shutdown()

    def subscribe(self, message_type: Any, topic: str, profile: Any) -> Received:
        """Collect the messages of a topic."""
        received = Received()
        self.node.create_subscription(message_type, topic, received.messages.append, profile)
        return received

    def call(self, service_type: Any, name: str, request: Any, limit_s: float = 600.0) -> Any:
        """Call a service and return its response.

        The call is made again every `_AGAIN_S`: a request may go to a process that has ended and
        whose end was not noticed yet.
        """
        client = self.node.create_client(service_type, name)
        assert client.wait_for_service(limit_s), f"no service {name} within {limit_s} s"
        futures: list[Any] = []
        begin = time.monotonic()

        def answered() -> Any:
            if time.monotonic() - begin >= _AGAIN_S * len(futures):
                futures.append(client.call_async(request))
            return next((future for future in futures if future.done()), None)

        future = wait_for(answered, limit_s, f"answer of {name}")
        self.node.destroy_client(client)
        return future.result()


@contextlib.contextmanager
def graph(name: str = "test") -> Iterator[Graph]:
    """Yield a node of the test's own on the private graph."""
    own = Graph(name)
    try:
        yield own
    finally:
        own.close()


def private_context() -> Any:
    """Return an initialised rclpy context on the private graph."""
    import rclpy

    context = rclpy.Context()
    # These are read when a participant is made; the tests want no other.
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    for name in _LEAKS:
        os.environ.pop(name, None)
    rclpy.init(context=context, domain_id=_domain()[0])
    return context


def wait_for(
    condition: Callable[[], Any],
    limit_s: float,
    what: str,
    processes: Sequence[NodeProcess] = (),
) -> Any:
    """Return the first true value of `condition`; fail with the processes' logs after `limit_s`."""
    end = time.monotonic() + limit_s
    while time.monotonic() < end:
        value = condition()
        if value:
            return value
        time.sleep(0.05)
    logs = "".join(f"\n--- {process.log_path.name}\n{process.log}" for process in processes)
    raise AssertionError(f"no {what} within {limit_s} s{logs}")


def play_bag(
    own: Graph, bag: Path, rate: float, limit_s: float, listeners: Mapping[str, int]
) -> list[Any]:
    """Publish a recorded bag with its recorded quality of service and in its recorded rhythm.

    Waits until every topic has a subscriber, or as many as `listeners` says. Returns the
    publishers: latched topics need them to stay, and the caller destroys them.
    """
    from rosbags.highlevel import AnyReader
    from rosbags.typesys import Stores, get_typestore

    with AnyReader([bag], default_typestore=get_typestore(Stores.ROS2_JAZZY)) as reader:
        publishers = {c.id: _publisher(own.node, c) for c in reader.connections}
        for connection in reader.connections:
            wanted = listeners.get(connection.topic, 1)
            read = functools.partial(_is_read, publishers[connection.id], wanted)
            wait_for(read, limit_s, f"{wanted} readers of {connection.topic}")
        begin, first = time.monotonic(), None
        for connection, stamp, raw in reader.messages():
            first = stamp if first is None else first
            delay = begin + (stamp - first) / 1e9 / rate - time.monotonic()
            time.sleep(max(delay, 0.0))
            publishers[connection.id].publish(bytes(raw))
    return list(publishers.values())


def _is_read(publisher: Any, readers: int) -> bool:
    return bool(publisher.get_subscription_count() >= readers)


def _publisher(node: Any, connection: Any) -> Any:
    from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

    (offered, *_) = connection.ext.offered_qos_profiles
    profile = QoSProfile(
        depth=max(offered.depth, 200),  # On a starved machine nothing is to be lost here.
        reliability=ReliabilityPolicy(int(offered.reliability.value)),
        durability=DurabilityPolicy(int(offered.durability.value)),
    )
    package, _, name = connection.msgtype.split("/")
    message_type = getattr(importlib.import_module(f"{package}.msg"), name)
    return node.create_publisher(message_type, connection.topic, profile)


def service(name: str) -> Any:
    """Return a service type of topometric_msgs."""
    import topometric_msgs.srv

    return getattr(topometric_msgs.srv, name)


def cloud_message(points: np.ndarray, frame_id: str, point_step: int = 12) -> Any:
    """Return points (N, 3), m, as a PointCloud2 of rclpy's classes."""
    from sensor_msgs.msg import PointCloud2, PointField

    message = PointCloud2(height=1, width=len(points), point_step=point_step)
    message.header.frame_id = frame_id
    message.header.stamp.sec = 1_700_000_000
    message.fields = [
        PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
        for i, name in enumerate("xyz")
    ]
    message.row_step = 12 * len(points)
    message.data = array.array("B", points.astype("<f4").tobytes())
    return message


def transform_matrix(transform: Any) -> np.ndarray:
    """Return a geometry_msgs/Transform as (4, 4)."""
    from scipy.spatial.transform import Rotation

    T = np.eye(4)
    q, t = transform.rotation, transform.translation
    T[:3, :3] = Rotation.from_quat([q.x, q.y, q.z, q.w]).as_matrix()
    T[:3, 3] = t.x, t.y, t.z
    return T


def set_parameters(own: Graph, node: str, values: dict[str, float]) -> list[str]:
    """Set parameters one by one over the node's service; return why each was refused."""
    from rcl_interfaces.srv import SetParameters
    from rclpy.parameter import Parameter

    changes = [Parameter(n, value=v).to_parameter_msg() for n, v in values.items()]
    request = SetParameters.Request(parameters=changes)
    results = own.call(SetParameters, f"{node}/set_parameters", request).results
    return ["" if result.successful else result.reason for result in results]
