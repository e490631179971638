"""The pairs that a benchmark runs on: folders that are there, or those that a suite gives.

Every method reads the same a.ply and b.ply. A suite's pairs are simulated as `topometric evaluate`
does it and kept: the folder's name ends in a hash of all that the case depends on but the code, so
a changed suite makes new pairs and rows by the same name are of the same clouds.
"""

from __future__ import annotations

import hashlib
import json
import re
import shutil
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from topometric_ros.errors import TopometricError
from topometric_ros.evaluation.case import simulate_agents
from topometric_ros.evaluation.suite import RELEASED, CaseSpec, SuiteError, read_suite
from topometric_ros.simulation.case_files import write_case
from topometric_ros.visualization.page import counted

PAIRS = "pairs"
"""Folder below the output that a suite's pairs are written to."""


class BenchmarkError(TopometricError):
    """Pairs that cannot be found or rows that cannot be read."""


@dataclass(frozen=True)
class PairFolder:
    """Two clouds with the true transform between them: a.ply, b.ply and truth.json.

    `cell` is the row of the tables that the pair belongs to.
    """

    path: Path
    overlap: float
    cell: str = ""

    @property
    def name(self) -> str:
        """The folder's name."""
        return self.path.name


@dataclass(frozen=True)
class FoundPairs:
    """Pairs, in words where they are from, and why cases of a suite could not be simulated."""

    pairs: tuple[PairFolder, ...]
    origin: str
    failed: dict[str, str]


def find_pairs(
    sources: Sequence[str],
    out: Path,
    limit: int = 0,
    progress: Callable[[str], None] = lambda text: None,
) -> FoundPairs:
    """Return the pairs of folders and suites; those of suites are written to `out`/pairs.

    Parameters
    ----------
    sources : folders of pairs or pairs themselves, and suites (YAML files or names)
    limit : at most this many, spread over the whole; 0: all

    Raises
    ------
    TopometricError
        There is no pair, a truth or a suite cannot be read, or a suite has more than two agents.
    """
    found: list[PairFolder | CaseSpec] = []
    for source in sources:
        found += _folders(Path(source)) if Path(source).is_dir() else _cases(source)
    if limit and limit < len(found):
        found = [found[k * len(found) // limit] for k in range(limit)]
    pairs, failed = [], {}
    for k, entry in enumerate(found):
        if isinstance(entry, PairFolder):
            pairs.append(entry)
            continue
        progress(f"pair {k + 1} of {len(found)}: {entry.name}")
        try:
            pairs.append(_written(entry, out / PAIRS))
        except TopometricError as error:
            failed[entry.name] = str(error)
    names = [pair.name for pair in pairs]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        raise BenchmarkError(f"two pairs have the name {twice[0]!r}: rows are kept by it")
    return FoundPairs(tuple(pairs), _origin(found), failed)


def read_truth(folder: Path) -> dict[str, Any]:
    """Return a pair's truth; raises BenchmarkError."""
    try:
        truth: dict[str, Any] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        float(truth["overlap"])
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise BenchmarkError(
            f"{folder / 'truth.json'}: not the truth of a pair: {error}"
        ) from error
    return truth


def _folders(root: Path) -> list[PairFolder | CaseSpec]:
    """Return the pairs below a folder, or the folder that is one, by name."""
    folders = [root] if (root / "truth.json").is_file() else sorted(root.glob("*/"))
    folders = [folder for folder in folders if (folder / "truth.json").is_file()]
    if not folders:
        raise BenchmarkError(f"no pair (a.ply, b.ply, truth.json) in {root}")
    return [_pair(folder, folder.resolve().parent.name) for folder in folders]


def _pair(folder: Path, cell: str) -> PairFolder:
    """Return a pair; its truth.json may name the cell, as those written here do."""
    truth = read_truth(folder)
    return PairFolder(folder, float(truth["overlap"]), str(truth.get("cell", cell)))


def _cases(source: str) -> list[PairFolder | CaseSpec]:
    """Return the cases of a suite; its ready pairs as the folders that they are."""
    try:
        suite = read_suite(source)
    except SuiteError as error:
        raise BenchmarkError(f"no folder of pairs, and no suite: {error}") from error
    # Released maps are no pairs: there are as many as the scene has.
    cases = [case for case in suite.cases if case.agents != RELEASED]
    more = next((case for case in cases if case.building and case.agents != 2), None)
    if more is not None:
        raise BenchmarkError(f"{source}: {more.agents} agents; the methods align two clouds")
    return [
        _pair(Path(case.folders[0]), case.group) if len(case.folders) == 1 else case
        for case in cases
    ]


def _written(spec: CaseSpec, out: Path) -> PairFolder:
    """Return the folder of a case, which is written unless it is there."""
    key = hashlib.sha256(json.dumps(asdict(spec), sort_keys=True, default=str).encode())
    short = re.sub(r"[^\w.=-]+", "_", spec.name)[:80]
    folder = out / f"{short}-{key.hexdigest()[:8]}"
    if not folder.is_dir():
        # A run may be broken off while it writes: the name is given when all is there.
        part = folder.with_name(f"{folder.name}.part")
        if spec.building:
            write_case(simulate_agents(spec), part)
        else:
            _write_crossed(spec, part)
        truth = json.dumps({**read_truth(part), "cell": spec.group}) + "\n"
        (part / "truth.json").write_text(truth, encoding="utf-8")
        part.rename(folder)
    return _pair(folder, spec.group)


def _write_crossed(spec: CaseSpec, folder: Path) -> None:
    """Write agent a of one pair with agent b of another building's, which have no transform."""
    folder.mkdir(parents=True, exist_ok=True)
    for source, name in zip(spec.folders, ("a.ply", "b.ply"), strict=True):
        shutil.copyfile(Path(source) / name, folder / name)
    (folder / "truth.json").write_text(json.dumps({"plan": spec.name, "overlap": 0.0}) + "\n")


def _origin(found: Sequence[PairFolder | CaseSpec]) -> str:
    """Return how many pairs there are and how many seeds stand behind a cell."""
    made = [entry for entry in found if isinstance(entry, CaseSpec) and entry.building]
    seeds = sorted({entry.seed for entry in made})
    parts = [counted(len(found), "pair")]
    if made:
        # A building may be another one for every seed, so those of one seed are counted.
        of_seed = [{entry.building for entry in made if entry.seed == seed} for seed in seeds]
        buildings = counted(max(map(len, of_seed)), "building")
        parts.append(
            f"{len(made)} simulated: {buildings}, {counted(len(seeds), 'seed')} of each in "
            f"every cell ({', '.join(map(str, seeds))})"
        )
    return "; ".join(parts)
