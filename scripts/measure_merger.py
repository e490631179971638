"""How soon a merger uses a fleet's maps, on a clock that only its own work moves.

    python scripts/measure_merger.py BAG [--all]

BAG holds the `topometric_map` messages of a fleet as they arrived, as scripts/measure_fleet.py
records them. They are given to a session when its clock has come to their times of arrival; the
clock moves by the CPU seconds of what the session does, on one thread. So the numbers are those of
a core that nothing else uses, however busy the machine is; publishing and extraction are left out.
At the end another session adopts what was found.
`--all` aligns all pairs before anything is told, as mergers did before commit d23b2b0.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path

from topometric_ros.fusion.config import MergeConfig
from topometric_ros.io.bag_messages import MAP_TYPE, message_classes
from topometric_ros.io.bags import Bag
from topometric_ros.runtime.alignment_codec import alignments_to_message, offers_from_message
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.merger_state import Known
from topometric_ros.runtime.message_codec import map_from_message
from topometric_ros.topometric_map import TopometricMap

_FUSING_SHARE = 0.3
_PAIRS = 2


def recorded(path: Path) -> list[tuple[float, TopometricMap]]:
    """Return a bag's maps with the seconds from the first one's arrival."""
    with Bag(path) as bag:
        topics = [topic.name for topic in bag.topics().values() if topic.type == MAP_TYPE]
        entries = [(e.time, map_from_message(e.message).map) for e in bag.messages(topics)]
    return [((at - entries[0][0]) * 1e-9, m) for at, m in entries]


def offers_of(session: MergerSession) -> list[Known]:
    """Return what a late merger reads on the topic `alignments`."""
    if session.placed is None:
        return []
    message = alignments_to_message(session.placed, message_classes(), 1, session.maps)
    return offers_from_message(message)


class Clock:
    """Moves by the CPU time of what it is told to do."""

    def __init__(self) -> None:
        self.now = 0.0
        self.spent: dict[str, float] = {}

    def do(self, what: str, work: Callable[[], object]) -> float:
        """Do something; return how long it took."""
        begin = time.process_time()
        work()
        took = time.process_time() - begin
        self.now += took
        self.spent[what] = self.spent.get(what, 0.0) + took
        return took


def main() -> None:
    """Run the script."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("bag", type=Path)
    parser.add_argument("--all", action="store_true", help="align all pairs before telling")
    options = parser.parse_args()
    maps = recorded(options.bag)
    agents = sorted({m.agent for _, m in maps})
    warm = MergerSession(MergeConfig(), agents)
    for _, m in maps[-3:]:
        warm.add_map(m)
    warm.merge()  # what is compiled or loaded at the first call
    session, clock = MergerSession(MergeConfig(), agents), Clock()
    latencies: list[float] = []
    all_placed, fuse_at, fused = 0.0, 0.0, None
    waiting = list(maps)
    while waiting or session.waiting:
        if not session.waiting:
            clock.now = max(clock.now, waiting[0][0])
        arrived = [entry for entry in waiting if entry[0] <= clock.now]
        waiting = waiting[len(arrived) :]
        for _, m in arrived:
            session.add_map(m)
        if options.all:
            clock.do("align", session.align)
        elif arrived:
            clock.do("check", lambda: session.align(0))
        else:
            clock.do("align", lambda: session.align(_PAIRS))
        latencies += [clock.now - at for at, _ in arrived]
        placed = session.placed.agents if session.placed else ()
        if not all_placed and sum(a.T_global_agent is not None for a in placed) == len(agents):
            all_placed = clock.now
        versions = [(m.agent, m.sequence) for m in session.maps.values()]
        if versions != fused and clock.now >= fuse_at:
            took, fused = clock.do("fuse", session.fuse), versions
            fuse_at = clock.now + took * (1 / _FUSING_SHARE - 1)
    late, joining = MergerSession(MergeConfig(), agents), Clock()
    late.offer(offers_of(session))
    for m in session.maps.values():
        late.add_map(m)
    joining.do("adopt", late.align)
    joining.do("fuse", late.fuse)
    latencies.sort()
    told = {
        "maps": len(maps),
        "map to alignments s, median": round(latencies[len(latencies) // 2], 2),
        "map to alignments s, 95 %": round(latencies[int(0.95 * len(latencies))], 2),
        "all agents placed after s": round(all_placed, 1),
        "last map to all pairs aligned anew s": round(clock.now - maps[-1][0], 1),
        "CPU s": {what: round(seconds, 1) for what, seconds in clock.spent.items()},
        "a late merger that adopts: CPU s": {k: round(v, 1) for k, v in joining.spent.items()},
        "load": os.getloadavg()[0],
    }
    print(json.dumps(told, indent=1))


if __name__ == "__main__":
    main()
