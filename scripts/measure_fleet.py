"""What a fleet costs and how fast it is: latency, CPU, memory, bytes; late joiners; replay.

    python scripts/measure_fleet.py OUT [--agents 10] [--building office:rooms=24,corridor=ring]

Starts an extractor for each simulated agent and one merger as processes. Every agent publishes its
growing map four times, one agent after the other, `--period` seconds apart. Then a second merger
joins late, and what was recorded is replayed. Prints what it measures and writes OUT/fleet.json.

An alignment counts as made with a cloud when alignments are published that are of the cloud's map:
what was accepted before is checked against it, what was not is searched anew a few pairs at a time.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
from fleet_bench import (
    ROOT,
    accepted,
    cpu_seconds,
    memory_mib,
    placed,
    processor,
    quantile,
    restamped,
    simulated_clouds,
    until,
)

from test import helpers_ros
from topometric_ros.io.bag_messages import ALIGNMENTS_TYPE, MAP_TYPE, typestore
from topometric_ros.io.bag_writer import BagWriter

EXTRACTOR, MERGER = "topometric_ros.nodes.extractor", "topometric_ros.nodes.merger"
WORK_S = 1800.0


class Recorder:
    """What came over the topics, as bytes with the time of arrival."""

    def __init__(self, own: Any, kind: Any, topic: str, profile: Any) -> None:
        from rclpy.serialization import deserialize_message

        self.topic, self._kind, self._read = topic, kind, deserialize_message
        self.raw: list[tuple[int, bytes]] = []
        own.node.create_subscription(kind, topic, self._take, profile, raw=True)

    def _take(self, raw: bytes) -> None:
        self.raw.append((time.time_ns(), bytes(raw)))

    def messages(self) -> list[tuple[int, Any]]:
        return [(at, self._read(raw, self._kind)) for at, raw in self.raw]

    def last(self) -> Any:
        return self._read(self.raw[-1][1], self._kind) if self.raw else None


class Run:
    """One fleet and what was seen of it."""

    def __init__(self, own: Any, options: argparse.Namespace) -> None:
        from diagnostic_msgs.msg import DiagnosticArray
        from sensor_msgs.msg import PointCloud2
        from topometric_msgs.msg import AlignmentArray, TopometricMap

        from topometric_ros.nodes import qos

        self.own, self.options = own, options
        self.fleet = simulated_clouds(
            options.out, options.building, options.agents, options.overlap, options.seed
        )
        self.names = [agent.name for agent in self.fleet]
        self.processes = {name: self._extractor(name) for name in self.names}
        self.processes["merger"] = self.merger("")
        self.maps = {
            name: Recorder(own, TopometricMap, f"/{name}/topometric_map", qos.SNAPSHOT)
            for name in self.names
        }
        self.alignments = Recorder(own, AlignmentArray, "/alignments", qos.SNAPSHOT)
        self.diagnostics = Recorder(own, DiagnosticArray, "/diagnostics", qos.DIAGNOSTICS)
        self.live: Any = None
        """The alignments that the fleet's own merger ended with."""
        self.publishers = {
            name: own.node.create_publisher(PointCloud2, f"/{name}/cloud", qos.CLOUD_RELIABLE)
            for name in self.names
        }
        self.sent: dict[tuple[str, int], int] = {}

    def _start(self, module: str, log: str, *arguments: str) -> Any:
        path = self.options.out / f"{log}.log"
        return helpers_ros.NodeProcess(module, ["--ros-args", *arguments], path)

    def _extractor(self, name: str) -> Any:
        return self._start(
            EXTRACTOR, name, "-r", f"__ns:=/{name}", "-p", "mode:=map", "-p", "max_rate:=5.0"
        )

    def merger(self, namespace: str, *more: str) -> Any:
        listed = ", ".join(f"/{name}" for name in self.names)
        arguments = ["-p", f"agents:=[{listed}]", "-p", "max_rate:=5.0", *more]
        if namespace:
            arguments += ["-r", f"__ns:={namespace}", "-r", "/tf:=tf"]
        return self._start(MERGER, f"merger{namespace.replace('/', '_')}", *arguments)

    def play(self) -> None:
        """Publish every cloud of every agent and wait until the merger has used them all."""
        ready = lambda: all(p.get_subscription_count() for p in self.publishers.values())  # noqa: E731
        assert until(ready, WORK_S), "not all extractors came up"
        versions = len(self.fleet[0].clouds)
        for version in range(versions - self.options.versions, versions):
            for agent in self.fleet:
                stamp = time.time_ns()
                self.sent[agent.name, stamp] = stamp
                self.publishers[agent.name].publish(restamped(agent.clouds[version], stamp))
                time.sleep(self.options.period)
        newest = {name: max(at for n, at in self.sent if n == name) for name in self.names}

        def finished() -> bool:
            last = self.alignments.last()
            used = {a.id: (a.session, a.sequence) for a in last.agents} if last else {}
            return all(
                self.maps[name].raw
                and stamp_of(m := self.maps[name].last()) == newest[name]
                and used.get(name) == (m.session, m.sequence)
                for name in self.names
            )

        assert until(finished, WORK_S), "the merger did not take every map"
        begin = time.time_ns()
        assert until(lambda: self.waiting(begin) == 0, WORK_S), "pairs went on waiting"
        self.live = self.alignments.last()

    def waiting(self, since: int) -> int | None:
        """Return how many pairs the merger has still to align, as last told since a time (ns)."""
        for at, message in reversed(self.diagnostics.messages()[-40:]):
            told = [s for s in message.status if s.name == "/merger: merge"]
            values = {entry.key: entry.value for status in told for entry in status.values}
            if "pairs waiting" in values and at > since + 1_500_000_000:
                return int(values["pairs waiting"])
        return None

    def latencies(self) -> tuple[list[float], list[float], int]:
        """Return the seconds from a cloud to its map, and to an alignment made with it; and how
        many clouds were passed over, since a newer one came before their turn."""
        arrays = self.alignments.messages()
        to_map, to_alignment = [], []
        for (name, stamp), sent in self.sent.items():
            made = [(at, m) for at, m in self.maps[name].messages() if stamp_of(m) == stamp]
            if not made:
                continue
            at, m = made[0]
            to_map.append((at - sent) / 1e9)
            used = [
                seen
                for seen, array in arrays
                for agent in array.agents
                if (agent.id, agent.session) == (name, m.session) and agent.sequence >= m.sequence
            ]
            if used:
                to_alignment.append((used[0] - sent) / 1e9)
        return to_map, to_alignment, len(self.sent) - len(to_map)

    def record(self, path: Path, alignments: bool) -> None:
        """Write what was received as a bag."""
        entries = [(at, r.topic, raw, MAP_TYPE) for r in self.maps.values() for at, raw in r.raw]
        if alignments:
            entries += [
                (at, "/alignments", raw, ALIGNMENTS_TYPE) for at, raw in self.alignments.raw
            ]
        with BagWriter(path) as bag:
            for topic, kind in sorted({(topic, kind) for _, topic, _, kind in entries}):
                bag.add_topic(topic, kind, latched=True)
            for at, topic, raw, kind in sorted(entries, key=lambda entry: entry[:2]):
                bag.write(topic, at, typestore().deserialize_cdr(raw, kind))


def stamp_of(message: Any) -> int:
    """Return a message's stamp, ns."""
    return message.header.stamp.sec * 1_000_000_000 + message.header.stamp.nanosec


def joined_late(run: Run, adopt: bool) -> dict[str, Any]:
    """Start another merger now; return how long it took to the same result, and how near it is."""
    from topometric_msgs.msg import AlignmentArray

    from topometric_ros.nodes import qos

    namespace = f"/late_{'adopting' if adopt else 'alone'}"
    there = run.live
    # It reads what the first one says, and publishes under the same name after that.
    remap = ("-r", "alignments:=/alignments") if adopt else ()
    seen: list[tuple[float, Any]] = []

    def take(message: Any) -> None:
        seen.append((time.monotonic(), message))

    topic = "/alignments" if adopt else f"{namespace}/alignments"
    subscription = run.own.node.create_subscription(AlignmentArray, topic, take, qos.SNAPSHOT)
    start = time.monotonic()
    process = run.merger(namespace, *remap, "-p", f"adopt:={str(adopt).lower()}")
    begin: list[float] = []

    def same() -> list[tuple[float, Any]]:
        if not begin and process_knows(run, namespace):
            begin.append(time.monotonic())
        return [
            (at, m)
            for at, m in list(seen)
            if stamp_of(m) > stamp_of(there)
            and len(m.agents) == len(there.agents)
            and accepted(m) >= accepted(there)
        ]

    done = until(same, WORK_S)
    at, array = (same() or seen)[0]
    whole = [t for t, m in seen if placed(m) >= placed(there) and stamp_of(m) > stamp_of(there)]
    cpu = cpu_seconds(process.pid)
    process.stop()
    run.own.node.destroy_subscription(subscription)
    return {
        "adopting": adopt,
        "same alignments": done and accepted(array) == accepted(there),
        "seconds from its first sight of the maps": round(at - (begin or [at])[0], 2),
        "seconds until all agents have places": round(min(whole) - (begin or [at])[0], 2),
        "seconds from the start of its process": round(at - start, 2),
        "CPU seconds of the merger, start included": round(cpu, 2),
        "largest difference mm": round(largest_difference(there, array), 4),
    }


def process_knows(run: Run, namespace: str) -> bool:
    """Whether a late merger has subscribed the maps, which are latched and so arrive at once."""
    infos = run.own.node.get_subscriptions_info_by_topic(f"/{run.names[0]}/topometric_map")
    return any(info.node_namespace == namespace for info in infos)


def poses(array: Any) -> dict[str, np.ndarray[Any, Any]]:
    """Return the place in the global frame of each agent that has one."""
    return {
        agent.id: np.array(agent.t_global_agent).reshape(4, 4)
        for agent in array.agents
        if agent.has_global
    }


def largest_difference(one: Any, two: Any) -> float:
    """Return by how many mm two results differ at most in where agents stand; inf: other agents."""
    a, b = poses(one), poses(two)
    if set(a) != set(b):
        return float("inf")
    return max((float(np.abs(a[k] - b[k])[:3].max()) * 1e3 for k in a), default=0.0)


def replayed(run: Run, alignments: bool) -> dict[str, Any]:
    """Replay what was recorded and compare it with what happened."""
    bag = run.options.out / ("recorded" if alignments else "recorded_maps")
    run.record(bag, alignments)
    out = run.options.out / f"{bag.name}_replayed"
    command = [sys.executable, "-m", "topometric_ros", "replay"]
    command += [f"{name}={bag}:/{name}/topometric_map" for name in run.names]
    subprocess.run([*command, "-o", str(out)], check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    told = json.loads((out / "merge.json").read_text())
    live = run.live
    pairs = {tuple(x["agents"]): x for x in told["alignments"]}
    same = sum(
        (x.status == x.ACCEPTED) == (pairs[x.agent_a, x.agent_b]["status"] == "accepted")
        for x in live.alignments
    )
    found = {
        a["id"]: np.array(a["T_global_agent"])
        for a in told["agents"]
        if a["T_global_agent"] is not None
    }
    here = poses(live)
    apart = max((np.abs(here[k] - found[k])[:3].max() * 1e3 for k in here if k in found), default=0)
    return {
        "bag": "maps and alignments" if alignments else "nothing but topometric_map",
        "pairs with the same verdict": f"{same} of {len(live.alignments)}",
        "agents placed live and replayed": f"{len(here)} and {len(found)}",
        "largest difference mm": round(float(apart), 4),
    }


def main() -> None:
    """Run the script."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("out", type=Path)
    parser.add_argument("--agents", type=int, default=10)
    parser.add_argument("--building", default="office:rooms=24,corridor=ring")
    parser.add_argument("--overlap", type=float, default=0.4)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--period", type=float, default=2.0, help="s between two clouds")
    parser.add_argument("--versions", type=int, default=4, help="maps an agent publishes, 1 to 4")
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    content: dict[str, Any] = {"machine": processor(), "agents": options.agents}
    with helpers_ros.graph() as own:
        run = Run(own, options)
        try:
            measure(run, content)
        finally:
            content["exit statuses"] = sorted({p.stop() for p in run.processes.values()})
    (options.out / "fleet.json").write_text(json.dumps(content, indent=1) + "\n")
    print(json.dumps(content, indent=1))


def measure(run: Run, content: dict[str, Any]) -> None:
    """Play, join late and replay; put what was seen into `content`."""
    begin = time.monotonic()
    run.play()
    wall = time.monotonic() - begin
    to_map, to_alignment, passed = run.latencies()
    sizes = [len(raw) for r in run.maps.values() for _, raw in r.raw]
    extractors = [run.processes[name].pid for name in run.names]
    merger = run.processes["merger"].pid
    content |= {
        "clouds": len(run.sent),
        "clouds passed over": passed,
        "points of a whole map": int(np.mean([agent.points[-1] for agent in run.fleet])),
        "wall s": round(wall, 1),
        "cloud to map s, median and 95 %": [quantile(to_map, q) for q in (0.5, 0.95)],
        "cloud to alignment s, median and 95 %": [quantile(to_alignment, q) for q in (0.5, 0.95)],
        "last cloud to all pairs aligned anew s": round(
            time.time() - max(run.sent.values()) / 1e9, 1
        ),
        "alignments published": len(run.alignments.raw),
        "CPU s an extractor": float(np.mean([cpu_seconds(pid) for pid in extractors])),
        "CPU s of the merger": cpu_seconds(merger),
        "MiB an extractor": float(np.mean([memory_mib(pid, "VmHWM") for pid in extractors])),
        "MiB of the merger": memory_mib(merger, "VmHWM"),
        "kB a map message": float(np.mean(sizes)) / 1e3,
        "kB an agent a minute": sum(sizes) / 1e3 / len(run.names) / (wall / 60),
        "pairs accepted": accepted(run.live),
        "agents placed": placed(run.live),
        "load at the end": processor(),
    }
    print(json.dumps(content, indent=1), flush=True)
    content["late"] = [joined_late(run, adopt) for adopt in (False, True)]
    content["replay"] = [replayed(run, alignments) for alignments in (True, False)]


if __name__ == "__main__":
    main()
