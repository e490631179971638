"""A clock for the stages of a pipeline."""

from __future__ import annotations

import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager


class Stopwatch:
    """CPU seconds by stage, of the thread that runs it: a node's other threads do not count."""

    def __init__(self) -> None:
        self.seconds: dict[str, float] = {}

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the CPU time of the block to a stage."""
        start = time.thread_time()
        try:
            yield
        finally:
            self.add({name: time.thread_time() - start})

    def add(self, seconds: Mapping[str, float], before: str = "") -> None:
        """Add seconds by stage, as measured elsewhere too, with `before` in front of the names."""
        for name, value in seconds.items():
            stage = f"{before}{name}"
            self.seconds[stage] = self.seconds.get(stage, 0.0) + value
