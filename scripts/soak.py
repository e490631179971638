"""A fleet under fire for a long time: what was done to it, what happened, and whether memory grows.

    python scripts/soak.py OUT [--minutes 30] [--agents 10] [--seed 0]

Extractors and a merger run as processes; every `--period` seconds one agent's cloud changes. In the
first half nothing else happens and memory is watched; in the second half a fault comes with every
change: processes are killed, stopped for a while and reset, old, repeated, damaged and made-up
messages are sent, the disk is full. At the end all must be well again. Prints a Markdown table;
exit status 1 where something was not as it should be.
"""

from __future__ import annotations

import argparse
import json
import random
import resource
import signal
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from fleet_bench import accepted, cpu_seconds, memory_mib, placed, processor, until

from test import helpers_ros
from test.helpers import box_room

EXTRACTOR, MERGER = "topometric_ros.nodes.extractor", "topometric_ros.nodes.merger"
RECOVERY_S = 900.0
GROWTH = 0.1
"""Share by which the memory of the last third of the quiet half may exceed that of the middle."""


def flat(agent: int, change: int) -> np.ndarray[Any, Any]:
    """Return an agent's part of a row of furnished rooms, every other time one room more."""
    rooms, x = [], 0.0
    for number in range(7):
        width, depth = 3.0 + 0.7 * (number * 5 % 7), 4.0 + 0.3 * (number * 3 % 5)
        shell = box_room((x, 0.0, 0.0), (width, depth, 2.6), doors=(("x-", 1.2), ("x+", 1.2)))
        place = (x + 0.5 + 0.2 * number, depth - 1.2 - 0.1 * number, 0.0)
        rooms.append(np.concatenate([shell, box_room(place, (0.9, 0.6, 0.7 + 0.1 * number))]))
        x += width + 0.1
    first = agent % 4
    points = np.concatenate(rooms[first : first + 3 + change % 2])
    yaw = 0.6 * agent
    R = np.array([[np.cos(yaw), -np.sin(yaw), 0], [np.sin(yaw), np.cos(yaw), 0], [0, 0, 1]])
    return points @ R.T + [agent, -agent, 0]


class Fleet:
    """The processes, what is sent to them, and what is done to them."""

    def __init__(self, own: Any, options: argparse.Namespace) -> None:
        from sensor_msgs.msg import PointCloud2
        from topometric_msgs.msg import AlignmentArray, TopometricMap

        from topometric_ros.nodes import qos

        self.own, self.out = own, options.out
        self.random = random.Random(options.seed)
        self.names = [f"r{number}" for number in range(options.agents)]
        self.state = options.out / "state"
        self.processes: dict[str, Any] = {}
        for name in (*self.names, "merger"):
            self.start(name)
        create = own.node.create_publisher
        self.clouds = {n: create(PointCloud2, f"/{n}/cloud", qos.SNAPSHOT) for n in self.names}
        self.liar = {n: create(TopometricMap, f"/{n}/topometric_map", qos.SNAPSHOT)
                     for n in self.names[:2]}  # fmt: skip
        self.alignments = own.subscribe(AlignmentArray, "/alignments", qos.SNAPSHOT)
        self.old: dict[str, list[Any]] = {n: [] for n in self.names}
        for name in self.names:
            own.node.create_subscription(
                TopometricMap, f"/{name}/topometric_map", self._keeper(name), qos.SNAPSHOT
            )
        self.changes: Counter[str] = Counter()
        self.passed: dict[str, tuple[str, int]] = {}
        """The version of each agent's map before its last change."""

    def _keeper(self, name: str) -> Callable[[Any], None]:
        def keep(message: Any) -> None:
            # What is sent as an older map comes back here and is no new one.
            if not any(message == known for known in self.old[name]):
                self.old[name] = [*self.old[name][-3:], message]

        return keep

    def start(self, name: str) -> None:
        """Start a process (again)."""
        if name == "merger":
            listed = ", ".join(f"/{n}" for n in self.names)
            module, arguments = MERGER, ["-p", f"agents:=[{listed}]"]
            arguments += ["-p", f"state_file:={self.state}"]
        else:
            module, arguments = EXTRACTOR, ["-r", f"__ns:=/{name}", "-p", "mode:=map"]
        log = self.out / f"{name}.log"
        self.processes[name] = helpers_ros.NodeProcess(module, ["--ros-args", *arguments], log)

    def change(self, name: str) -> None:
        """Publish another cloud of an agent."""
        self.changes[name] += 1
        points = flat(self.names.index(name), self.changes[name])
        if self.old[name]:
            self.passed[name] = version(self.old[name][-1])
        self.clouds[name].publish(helpers_ros.cloud_message(points, f"{name}/map"))

    def well(self) -> bool:
        """Whether every process is there and the merger knows every agent's newest map, which
        came after the last change."""
        if not (all(p.alive for p in self.processes.values()) and len(self.alignments)):
            return False
        known = {a.id: (a.session, a.sequence) for a in self.alignments.last.agents}
        newest = {n: version(self.old[n][-1]) for n in self.names if self.old[n]}
        return len(newest) == len(self.names) and all(
            known.get(name) == seen and seen != self.passed.get(name)
            for name, seen in newest.items()
        )

    def stop(self) -> list[int]:
        """End every process; return the exit statuses."""
        for process in self.processes.values():
            if process.alive:
                process.stop(signal.SIGTERM, 120.0)
        return [process.wait(1.0) for process in self.processes.values()]


def version(message: Any) -> tuple[str, int]:
    """Return which version of its agent's map a message is."""
    return message.session, message.sequence


def faults(fleet: Fleet) -> dict[str, Callable[[], str]]:
    """Return what can be done to a fleet, by name; each returns whom it was done to."""

    def kill(name: str) -> str:
        fleet.processes[name].stop(signal.SIGKILL)
        time.sleep(fleet.random.uniform(0.0, 3.0))
        fleet.start(name)
        return name

    def pause() -> str:
        name = fleet.random.choice([*fleet.names, "merger"])
        fleet.processes[name].send(signal.SIGSTOP)
        time.sleep(5.0)
        fleet.processes[name].send(signal.SIGCONT)
        return name

    def full_disk() -> str:
        pid = fleet.processes["merger"].pid
        before = resource.prlimit(pid, resource.RLIMIT_FSIZE, (4096, -1))
        for name in fleet.names[:2]:
            fleet.change(name)
        time.sleep(15.0)
        resource.prlimit(pid, resource.RLIMIT_FSIZE, before)
        return "merger"

    def send(make: Callable[[str, Any], Any]) -> str:
        name = fleet.random.choice(list(fleet.liar))
        if fleet.old[name]:
            fleet.liar[name].publish(make(name, fleet.random.choice(fleet.old[name])))
        return name

    def noise(_: str, message: Any) -> bytes:
        from rclpy.serialization import serialize_message

        raw = bytearray(serialize_message(message))
        for _number in range(20):
            raw[fleet.random.randrange(4, len(raw))] = fleet.random.randrange(256)
        return bytes(raw[: fleet.random.randrange(8, len(raw))])

    def reset() -> str:
        name = fleet.random.choice(fleet.names)
        request = helpers_ros.service("Reset").Request()
        fleet.own.call(helpers_ros.service("Reset"), f"/{name}/extractor/reset", request, 120.0)
        fleet.change(name)
        return name

    return {
        "kill -9 an extractor": lambda: kill(fleet.random.choice(fleet.names)),
        "kill -9 the merger": lambda: kill("merger"),
        "a process stands still for 5 s": pause,
        "an extractor is reset": reset,
        "the disk is full for 15 s": full_disk,
        "an older map once more": lambda: send(lambda _, m: m),
        "damaged bytes in place of a map": lambda: send(noise),
        "bytes that are nothing": lambda: send(lambda *_: bytes(fleet.random.randbytes(300))),
    }


def main() -> int:
    """Run the script; return the exit status."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--minutes", type=float, default=30.0)
    parser.add_argument("--agents", type=int, default=10)
    parser.add_argument("--period", type=float, default=10.0, help="s between two changes")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    with helpers_ros.graph() as own:
        fleet = Fleet(own, options)
        try:
            content = soak(fleet, options)
        finally:
            statuses = fleet.stop()
    content["exit statuses"] = sorted(set(statuses))
    content["ok"] = content["ok"] and set(statuses) == {0}
    (options.out / "soak.json").write_text(json.dumps(content, indent=1) + "\n")
    print(table(content))
    return 0 if content["ok"] else 1


def soak(fleet: Fleet, options: argparse.Namespace) -> dict[str, Any]:
    """Let the fleet run, quietly and then under fire; return what happened."""
    for name in fleet.names:
        fleet.change(name)
    begun = until(fleet.well, RECOVERY_S)
    half = options.minutes * 30.0
    memory: dict[str, list[float]] = {name: [] for name in fleet.processes}
    begin = time.monotonic()
    cpu = sum(cpu_seconds(p.pid) for p in fleet.processes.values())
    while time.monotonic() - begin < half:
        fleet.change(fleet.random.choice(fleet.names))
        time.sleep(options.period)
        for name, process in fleet.processes.items():
            memory[name].append(memory_mib(process.pid))
    quiet = sum(fleet.changes.values())
    cpu = sum(cpu_seconds(p.pid) for p in fleet.processes.values()) - cpu
    before = (accepted(fleet.alignments.last), placed(fleet.alignments.last)) if begun else (0, 0)
    done: Counter[str] = Counter()
    slowest: dict[str, float] = {}
    unwell: Counter[str] = Counter()
    ways = faults(fleet)
    while time.monotonic() - begin < 2 * half or len(done) < len(ways):
        least = min(done[name] for name in ways)
        fault = fleet.random.choice([name for name in ways if done[name] == least])
        whom = ways[fault]()
        fleet.change(fleet.random.choice(fleet.names))
        since = time.monotonic()
        if not until(fleet.well, RECOVERY_S):
            unwell[fault] += 1
        done[fault] += 1
        slowest[fault] = max(slowest.get(fault, 0.0), time.monotonic() - since)
        print(f"{fault}: {whom}: {time.monotonic() - since:.1f} s", file=sys.stderr, flush=True)
    after = (accepted(fleet.alignments.last), placed(fleet.alignments.last))
    growth = {name: grown(values) for name, values in memory.items()}
    crashes = sum(p.log.count("Traceback") for p in fleet.processes.values())
    return {
        "machine": processor(),
        "minutes": round((time.monotonic() - begin) / 60, 1),
        "changes in the quiet half": quiet,
        "CPU cores busy in the quiet half": round(cpu / half, 3),
        "MiB of the merger": [round(v) for v in memory["merger"]],
        "growth of memory, largest": max(growth.values()),
        "growth of memory, merger": growth["merger"],
        "accepted and placed before": before,
        "accepted and placed after": after,
        "faults": {n: [done[n], unwell[n], round(slowest[n], 1)] for n in ways},
        "tracebacks": crashes,
        "ok": begun and not unwell and crashes == 0 and max(growth.values()) < GROWTH,
    }


def grown(values: list[float]) -> float:
    """Return by what share the last third lies above the middle third."""
    third = len(values) // 3
    if third == 0:
        return 0.0
    middle, last = np.median(values[third : 2 * third]), np.median(values[-third:])
    return round(float(last / middle - 1.0), 4)


def table(content: dict[str, Any]) -> str:
    """Return the result as Markdown."""
    lines = [f"- {name}: {value}" for name, value in content.items() if name != "faults"]
    lines += ["", "| what was done | times | not well after | slowest to be well, s |"]
    lines += ["|---|---:|---:|---:|"]
    lines += [f"| {n} | {a} | {b} | {c} |" for n, (a, b, c) in content["faults"].items()]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
