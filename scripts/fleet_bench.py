"""A fleet of real processes for measuring: simulated clouds in, what the processes do and cost out.

Shared by scripts/measure_fleet.py and scripts/soak.py. Everything runs on one private graph.
"""

from __future__ import annotations

import os
import sys
import time
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from topometric_ros.io.bag_messages import CLOUD_TYPE, typestore  # noqa: E402
from topometric_ros.io.bags import Bag  # noqa: E402
from topometric_ros.simulation.buildings import load_building  # noqa: E402
from topometric_ros.simulation.case_bags import write_bag  # noqa: E402
from topometric_ros.simulation.cases import SimulationConfig, simulate  # noqa: E402

TICKS = os.sysconf("SC_CLK_TCK")


@dataclass(frozen=True)
class AgentClouds:
    """One agent's growing map clouds, serialized, the smallest first."""

    name: str
    clouds: list[bytes]
    """As CDR, for a publisher to send as they are."""
    points: list[int]


def simulated_clouds(
    folder: Path, building: str, agents: int, overlap: float, seed: int
) -> list[AgentClouds]:
    """Return the clouds of a simulated fleet; the bag is kept in `folder` for the next run."""
    path = folder / f"fleet_{agents}_{seed}"
    if not path.exists():
        wanted = SimulationConfig(agents=agents, overlap=overlap)
        write_bag(simulate(load_building(building), wanted, seed), path, "maps")
    with Bag(path) as bag:
        topics = [t.name for t in bag.topics().values() if t.type == CLOUD_TYPE]
        clouds: dict[str, list[bytes]] = {topic: [] for topic in topics}
        points: dict[str, list[int]] = {topic: [] for topic in topics}
        for entry in bag.messages(topics):
            points[entry.topic].append(entry.message.width)
            clouds[entry.topic].append(bytes(typestore().serialize_cdr(entry.message, entry.type)))
    return [AgentClouds(t.split("/")[1], clouds[t], points[t]) for t in topics]


def restamped(raw: bytes, stamp_ns: int) -> bytes:
    """Return a serialized message with another stamp in the header that it begins with."""
    message = bytearray(raw)
    seconds, nanoseconds = divmod(stamp_ns, 1_000_000_000)
    # Four bytes tell the encoding; the header's stamp, two 32-bit numbers, comes first.
    message[4:8] = seconds.to_bytes(4, "little")
    message[8:12] = nanoseconds.to_bytes(4, "little")
    return bytes(message)


def cpu_seconds(pid: int) -> float:
    """Return the CPU time that a process has used so far; 0 where it is gone."""
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
    except OSError:
        return 0.0
    return (int(fields[11]) + int(fields[12])) / TICKS


def memory_mib(pid: int, what: str = "VmRSS") -> float:
    """Return a process's resident memory, or with VmHWM the most it ever was; 0 where gone."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    found = [line.split()[1] for line in lines if line.startswith(f"{what}:")]
    return int(found[0]) / 1024 if found else 0.0


def quantile(values: Iterable[float], share: float) -> float:
    """Return the value that this share of all does not exceed."""
    ordered = sorted(values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def processor() -> str:
    """Return what the numbers were measured on, and how busy it was."""
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    names = {line.split(":")[1].strip() for line in lines if line.startswith("model name")}
    load = os.getloadavg()[0]
    return f"{os.cpu_count()} cores ({', '.join(sorted(names))}), load {load:.1f}"


def accepted(alignments: Any) -> int:
    """Return how many pairs of an AlignmentArray are accepted."""
    return sum(x.status == x.ACCEPTED for x in alignments.alignments)


def placed(alignments: Any) -> int:
    """Return how many agents of an AlignmentArray have a place in the global frame."""
    return sum(bool(agent.has_global) for agent in alignments.agents)


def until(condition: Any, limit_s: float) -> bool:
    """Wait for something; return whether it came about in time."""
    end = time.monotonic() + limit_s
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.05)
    return True
