"""This package and its peers on the same pairs, every run in a process of its own.

A process of its own makes the peak of memory that method's alone and lets one method crash or run
out of time without costing the others their rows. Rows are written as they come; the same command
goes on where it stopped.
"""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, fields, replace
from pathlib import Path

import numpy as np

from topometric_ros.evaluation.benchmark_pairs import BenchmarkError, PairFolder, read_truth
from topometric_ros.evaluation.metrics_fusion import NO_OVERLAP, RIGHT, STRICTLY_RIGHT
from topometric_ros.evaluation.peers.registry import make_peer
from topometric_ros.evaluation.processes import ProcessError, in_own_process, peak_mb
from topometric_ros.fusion.poses import angle, apart, inverse
from topometric_ros.io.clouds import read_cloud
from topometric_ros.io.summaries import write_atomically

ROWS = "rows.csv"
_EVERY = 97
"""Displacements are measured on every so many of b's points."""


@dataclass(frozen=True)
class BenchmarkRow:
    """One method on one pair.

    `displacement` (m) and `angle` (degrees) are of the best pose, accepted or not, NaN where there
    is none or no truth to compare with; `cpu` seconds are of all threads while aligning, without
    reading the files and importing; `peak_mb` is of the whole process; `error` says why a run gave
    nothing; `cell` is the row of the tables that the pair belongs to.
    """

    pair: str
    peer: str
    overlap: float
    accepted: bool
    displacement: float
    angle: float
    score: float
    cpu: float
    peak_mb: float
    error: str = ""
    cell: str = ""

    def within(self, limits: tuple[float, float]) -> bool:
        """Return whether the pose, accepted or not, is right within m and degrees."""
        shared = self.overlap >= NO_OVERLAP
        return shared and self.displacement < limits[0] and self.angle < limits[1]

    @property
    def right(self) -> bool:
        """Whether the pose is right."""
        return self.within(RIGHT)

    @property
    def strictly_right(self) -> bool:
        """Whether the pose is right by the strict limits."""
        return self.within(STRICTLY_RIGHT)

    @property
    def false_merge(self) -> bool:
        """Whether the method accepted a pose that is not right."""
        return self.accepted and not self.right


def run_benchmark(
    pairs: Sequence[PairFolder],
    peers: Sequence[str],
    out: Path,
    *,
    timeout: float = 600.0,
    progress: Callable[[str], None] = lambda text: None,
) -> list[BenchmarkRow]:
    """Run every method on every pair that `out` holds no row of yet; return all rows.

    What gave nothing before, such as for want of time, is tried again.

    Parameters
    ----------
    timeout : wall seconds after which one run is ended and counts as without a pose

    Raises
    ------
    PeerError
        A method is unknown or not installed; told before anything is run.
    """
    for peer in peers:
        make_peer(peer)
    out.mkdir(parents=True, exist_ok=True)
    rows = {key: row for key, row in read_benchmark(out / ROWS).items() if not row.error}
    wanted = [(pair, peer) for pair in pairs for peer in peers]
    for k, (pair, peer) in enumerate(wanted):
        if (pair.name, peer) not in rows:
            progress(f"{k + 1} of {len(wanted)}: {peer} on {pair.name}")
            rows[pair.name, peer] = replace(_run_apart(pair, peer, timeout), cell=pair.cell)
            write_benchmark(out / ROWS, list(rows.values()))
    return [rows[pair.name, peer] for pair, peer in wanted]


def read_benchmark(path: Path) -> dict[tuple[str, str], BenchmarkRow]:
    """Return the rows of an earlier run by pair and peer, none where there is no file.

    Raises
    ------
    BenchmarkError
        The file has other columns.
    """
    rows = {}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            for cells in csv.DictReader(file):
                row = _from_cells(cells)
                rows[row.pair, row.peer] = row
    except FileNotFoundError:
        return {}
    except (KeyError, TypeError, ValueError) as error:
        raise BenchmarkError(f"{path}: not the rows of this benchmark: {error}") from error
    return rows


def write_benchmark(path: Path, rows: Sequence[BenchmarkRow]) -> None:
    """Write rows as CSV in one step."""
    stream = io.StringIO()
    writer = csv.DictWriter(stream, [f.name for f in fields(BenchmarkRow)], lineterminator="\n")
    writer.writeheader()
    for row in rows:
        cells = {
            k: f"{v:.4f}" if isinstance(v, float) else int(v) if isinstance(v, bool) else v
            for k, v in asdict(row).items()
        }
        writer.writerow(cells)
    write_atomically(path, stream.getvalue().encode())


def _from_cells(cells: dict[str, str]) -> BenchmarkRow:
    numbers = ("overlap", "displacement", "angle", "score", "cpu", "peak_mb")
    return BenchmarkRow(
        pair=cells["pair"],
        peer=cells["peer"],
        accepted=cells["accepted"] == "1",
        error=cells["error"],
        cell=cells["cell"],
        **{name: float(cells[name]) for name in numbers},
    )


def _run_apart(pair: PairFolder, peer: str, timeout: float) -> BenchmarkRow:
    """Run one method on one pair in a fresh process."""
    try:
        row: BenchmarkRow = in_own_process(align_pair, pair, peer, timeout=timeout)
    except ProcessError as error:
        return _without_pose(pair, peer, str(error))
    return row


def align_pair(pair: PairFolder, peer: str) -> BenchmarkRow:
    """Run one method on one pair in this process and compare its pose with the truth."""
    truth = read_truth(pair.path)
    a, b = (read_cloud(pair.path / name).points for name in ("a.ply", "b.ply"))
    method = make_peer(peer)
    start = time.process_time()
    result = method.align(a, b)
    cpu = time.process_time() - start
    displacement = turn = float("nan")
    if result.T_a_b is not None and truth.get("a_from_b") is not None:
        T_true = np.array(truth["a_from_b"], float)
        displacement = apart(result.T_a_b, T_true, b[::_EVERY])
        turn = float(np.degrees(angle(inverse(T_true) @ result.T_a_b)))
    return BenchmarkRow(
        pair.name,
        peer,
        pair.overlap,
        result.accepted,
        displacement,
        turn,
        result.score,
        cpu,
        peak_mb(),
    )


def _without_pose(pair: PairFolder, peer: str, error: str) -> BenchmarkRow:
    nan = float("nan")
    return BenchmarkRow(pair.name, peer, pair.overlap, False, nan, nan, nan, nan, nan, error)
