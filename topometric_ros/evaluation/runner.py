"""Runs a suite on as many processes as there are cores and goes on where it stopped.

Rows are written as they come, in the suite's order, so what was done when a run was broken off is
kept. Rows, tables and report do not depend on the number of processes.
"""

from __future__ import annotations

import logging
import multiprocessing
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

from topometric_ros.errors import TopometricError
from topometric_ros.evaluation.case_result import CaseResult, Seconds
from topometric_ros.evaluation.rows import (
    read_rows,
    read_seconds,
    row_key,
    write_rows,
    write_seconds,
)
from topometric_ros.evaluation.suite import CaseSpec, Suite

logger = logging.getLogger(__name__)

_ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")


class RunError(TopometricError):
    """A run that cannot go on."""


@dataclass(frozen=True)
class Job:
    """A case with the presets to run and the keys of their rows."""

    spec: CaseSpec
    rows: tuple[tuple[str, str], ...]


@dataclass(frozen=True)
class Evaluation:
    """All rows of a suite in its order, with the CPU seconds that they took, by key."""

    rows: tuple[CaseResult, ...]
    seconds: dict[str, Seconds]


def run_suite(
    suite: Suite,
    out: Path,
    *,
    processes: int | None = None,
    progress: Callable[[str], None] = lambda text: None,
) -> Evaluation:
    """Compute the rows of a suite that `out` does not hold yet.

    Parameters
    ----------
    suite : cases and presets
    out : folder for rows, maps and what the report draws
    processes : at once; as many as this process may use cores by default, 1: none but this
    progress : told in words how far it is

    Raises
    ------
    RunError
        A process ended before its case, such as for want of memory; the rows so far are kept.
    """
    out.mkdir(parents=True, exist_ok=True)
    jobs = [
        Job(spec, tuple((preset, row_key(spec, preset)) for preset in suite.presets))
        for spec in suite.cases
    ]
    keys = [key for job in jobs for _, key in job.rows]
    rows = {key: row for key, row in read_rows(out).items() if key in set(keys)}
    seconds = {key: value for key, value in read_seconds(out).items() if key in rows}
    missing = [Job(j.spec, tuple(r for r in j.rows if r[1] not in rows)) for j in jobs]
    missing = [job for job in missing if job.rows]
    progress(f"{len(rows)} of {len(keys)} rows done")
    for results in _results(missing, out, processes or _cores()):
        for row, spent in results:
            rows[row.key], seconds[row.key] = row, spent
        _write(out, keys, rows, seconds)
        progress(f"{len(rows)} of {len(keys)} rows done, the last: {results[-1][0].case}")
    _write(out, keys, rows, seconds)
    return Evaluation(tuple(rows[key] for key in keys), seconds)


def compute(job: Job, out: Path) -> list[tuple[CaseResult, Seconds]]:
    """Compute the rows of one case; what fails gives rows that say why."""
    from topometric_ros.evaluation.evaluate_case import evaluate_case, load_case

    results = []
    try:
        case = load_case(job.spec)
        for preset, key in job.rows:
            results.append(evaluate_case(case, job.spec, preset, key, out))
    except (TopometricError, OSError) as error:
        reason = str(error)
    except Exception as error:
        # One broken case must not cost the others their hours; the row tells, the log says where.
        logger.exception("%s", job.spec.name)
        reason = f"{type(error).__name__}: {error}"
    for preset, key in job.rows[len(results) :]:
        results.append((_failed(job.spec, preset, key, reason), Seconds(0.0, 0.0)))
    return results


def _failed(spec: CaseSpec, preset: str, key: str, reason: str) -> CaseResult:
    reason = " ".join(reason.split())
    return CaseResult(key, spec.name, preset, spec.group, spec.building, spec.seed, reason)


def _results(
    jobs: Sequence[Job], out: Path, processes: int
) -> Iterator[list[tuple[CaseResult, Seconds]]]:
    """Yield the rows of the cases as they are done."""
    if processes == 1 or len(jobs) < 2:
        yield from (compute(job, out) for job in jobs)
        return
    # Libraries that start threads of their own would fight over the cores.
    os.environ.update(dict.fromkeys(_ONE_THREAD, "1"))
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(min(processes, len(jobs)), mp_context=context) as pool:
        futures = [pool.submit(compute, job, out) for job in jobs]
        try:
            for future in as_completed(futures):
                yield future.result()
        except BrokenProcessPool as error:
            raise RunError(
                "a process ended before its case was done, perhaps for want of memory; the rows so "
                "far are kept: run the same command again, with fewer --jobs"
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)


def _write(
    out: Path, keys: Sequence[str], rows: dict[str, CaseResult], seconds: dict[str, Seconds]
) -> None:
    """Write what there is in the suite's order."""
    write_rows(out, [rows[key] for key in keys if key in rows])
    write_seconds(out, {key: seconds[key] for key in keys if key in seconds})


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1
