"""Work in a process of its own, so that its peak of memory is its own and it may crash alone."""

from __future__ import annotations

import multiprocessing
import resource
import sys
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from topometric_ros.errors import TopometricError


class ProcessError(TopometricError):
    """Work that raised, died or ran out of time."""


def in_own_process(work: Callable[..., Any], *arguments: Any, timeout: float) -> Any:
    """Return what `work(*arguments)` returns in a fresh (spawned) process.

    Parameters
    ----------
    timeout : wall seconds after which the process is ended

    Raises
    ------
    ProcessError
        The work raised an exception, its process died, or it took too long.
    """
    context = multiprocessing.get_context("spawn")
    receiver, sender = context.Pipe(duplex=False)
    process = context.Process(target=_send, args=(sender, work, arguments), daemon=True)
    process.start()
    sender.close()
    try:
        if not receiver.poll(timeout):
            raise ProcessError(f"ended after {timeout:g} s")
        result, error = receiver.recv()
        process.join()
    except EOFError:
        process.join()
        raise ProcessError(f"the process ended with status {process.exitcode}") from None
    finally:
        if process.is_alive():
            process.kill()
            process.join()
        receiver.close()
    if error:
        raise ProcessError(error)
    return result


def peak_mb() -> float:
    """Return the largest memory that this process held, in MB of 2^20 bytes."""
    try:
        # Unlike ru_maxrss, this does not begin with what the process held before it was replaced.
        status = Path("/proc/self/status").read_text(encoding="ascii")
        line = next(line for line in status.splitlines() if line.startswith("VmHWM"))
        return float(line.split()[1]) / 1024
    except (OSError, StopIteration):
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
        return peak / (1024 * 1024 if sys.platform == "darwin" else 1024)


def _send(sender: Connection, work: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
    """Do the work and send its result, or in one line what went wrong; runs in the process."""
    try:
        answer = (work(*arguments), "")
    except Exception as error:
        # Whatever the work throws is its result, and costs nobody else theirs.
        answer = (None, " ".join(f"{type(error).__name__}: {error}".split()))
    sender.send(answer)
    sender.close()
