"""What tests share: cases made up alike in every run, a graph of their own, processes on it."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

from test import helpers_ros
from test.helpers_ros import Graph, NodeProcess

# A run on a starved machine comes to what any other does; `make soak` looks for new cases.
settings.register_profile(
    "suite", derandomize=True, deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile("suite")


@pytest.fixture
def own() -> Iterator[Graph]:
    with helpers_ros.graph() as graph:
        yield graph


@pytest.fixture
def start(tmp_path: Path) -> Iterator[Any]:
    """Start node processes; whatever is still there at the end of the test is killed."""
    processes: list[NodeProcess] = []

    def begin(
        module: str, *arguments: str, first: tuple[str, ...] = (), namespace: str = ""
    ) -> NodeProcess:
        log = tmp_path / f"{len(processes)}_{module.rsplit('.', 1)[-1]}.log"
        started = NodeProcess(module, [*first, "--ros-args", *arguments], log, namespace)
        processes.append(started)
        return processes[-1]

    yield begin
    for process in processes:
        if process.alive:
            process.stop(signal.SIGKILL)
