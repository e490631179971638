"""Whether a merger's memory grows where agents begin a new session again and again.

    python scripts/measure_restarts.py [--sessions 240] [--threads 2]

Three agents in one flat take turns in starting again; each new session is aligned, the maps are
fused and the state is saved, as the node does it. Prints the resident memory after every 15.
"""

from __future__ import annotations

import os

os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import argparse
import dataclasses
import gc
import tempfile
from pathlib import Path

from fleet_bench import memory_mib

from test.helpers_sessions import flat_map
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.io.map_files import decode_map, encode_map
from topometric_ros.runtime.merger_session import MergerSession
from topometric_ros.runtime.merger_state import EncodedMaps, save_state

_AGENTS = "abc"
_EVERY = 15


def main() -> None:
    """Run the script."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n\n")[0])
    parser.add_argument("--sessions", type=int, default=240)
    parser.add_argument("--threads", type=int, default=2)
    options = parser.parse_args()
    files = {agent: encode_map(flat_map(agent, i)) for i, agent in enumerate(_AGENTS)}
    session = MergerSession(MergeConfig(), _AGENTS, options.threads)
    encoded = EncodedMaps()
    with tempfile.TemporaryDirectory() as folder:
        for number in range(options.sessions):
            agent = _AGENTS[number % len(_AGENTS)]
            m = decode_map(files[agent], agent)[0]  # Arrays of its own, as a message has.
            session.add_map(dataclasses.replace(m, session=f"s{number}", sequence=1))
            session.align(options.threads)
            while session.waiting:
                session.align(options.threads)
            session.fuse()
            save_state(Path(folder) / "state", session.state(), encoded)
            if number % _EVERY == _EVERY - 1:
                gc.collect()
                size = (Path(folder) / "state").stat().st_size
                print(f"{number + 1} sessions: {memory_mib(os.getpid()):.1f} MiB, state {size} B")


if __name__ == "__main__":
    main()
