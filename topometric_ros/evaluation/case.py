"""A case to score: what each agent saw, with the truth, from a folder or from simulation."""

from __future__ import annotations

import itertools
import json
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import with_values
from topometric_ros.errors import TopometricError, one_line
from topometric_ros.simulation.case import Case, SimulatedAgent
from topometric_ros.simulation.case_files import read_case

if TYPE_CHECKING:
    from topometric_ros.evaluation.suite import CaseSpec

Edge = tuple[int, int]


class EvaluationCaseError(TopometricError):
    """Folders that hold no cases."""


@dataclass(frozen=True)
class PairTruth:
    """Two agents: the share of their voxels in common, and `T_a_b` (4, 4) m; None: none exists."""

    overlap: float
    T_a_b: NDArray[np.float64] | None


@dataclass(frozen=True)
class EvaluationCase:
    """The agents and, for every two of them in `itertools.combinations` order, the truth.

    `links` are the pairs of true rooms that are joined, None where that is not known. With `rooms`
    False the rooms are not scored (they are in another case).
    """

    agents: tuple[SimulatedAgent, ...]
    pairs: tuple[PairTruth, ...]
    links: frozenset[Edge] | None
    rooms: bool = True


def of_case(case: Case) -> EvaluationCase:
    """Return what is needed of a simulated case or one read from its folder."""
    pairs = tuple(
        PairTruth(float(overlap), case.T_a_b(*pair))
        for pair, overlap in zip(case.pairs(), case.overlap, strict=True)
    )
    return EvaluationCase(case.agents, pairs, frozenset(case.edges) or None)


def crossed_case(folder_a: Path, folder_b: Path) -> EvaluationCase:
    """Take agent a of one building and agent b of another: nothing may be accepted."""
    a, b = read_case(folder_a).agents[0], read_case(folder_b).agents[1]
    return EvaluationCase((a, b), (PairTruth(0.0, None),), None, rooms=False)


def simulate_agents(spec: CaseSpec) -> Case:
    """Simulate the agents of a case.

    Raises
    ------
    TopometricError
        The building is not there, a parameter is unknown, or the building cannot be walked so.
    """
    from topometric_ros.simulation.cases import simulate  # Ray casting imports Open3D.

    values = {"agents": spec.agents, "overlap": spec.overlap, **spec.settings}
    prepared = _prepared(spec.building, json.dumps(values, sort_keys=True))
    return simulate(prepared, prepared.config, spec.seed)


def pair_folders(root: Path) -> list[Path]:
    """Return the folders of ready pairs below `root`, by name; raises EvaluationCaseError."""
    if not root.is_dir():
        raise EvaluationCaseError(
            f"{root}: no such folder of pairs (data is not part of this repository)"
        )
    folders = sorted(p for p in root.iterdir() if (p / "truth.json").is_file())
    if not folders:
        raise EvaluationCaseError(f"{root}: no pair in this folder: expected NAME/truth.json")
    return folders


def crossed_folders(folders: Sequence[Path], limit: int) -> list[tuple[Path, Path]]:
    """Return up to `limit` pairs of folders of different plans, in `check/score.py`'s order."""
    plans = {folder: _plan(folder) for folder in folders}
    shifts = (
        zip(folders, [*folders[n:], *folders[:n]], strict=True) for n in range(1, len(folders))
    )
    pairs = (pair for shift in shifts for pair in shift if plans[pair[0]] != plans[pair[1]])
    return list(itertools.islice(pairs, limit))


def cell_of(folder: Path) -> str:
    """Return the row of the tables that a pair belongs to: its truth's `cell`, else "pairs"."""
    return str(_truth(folder).get("cell", "pairs"))


def _plan(folder: Path) -> str:
    return str(_truth(folder)["plan"])


def _truth(folder: Path) -> dict[str, Any]:
    try:
        truth: dict[str, Any] = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
        truth["plan"]
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise EvaluationCaseError(
            f"{folder / 'truth.json'}: names no plan: {one_line(error)}"
        ) from error
    return truth


@lru_cache(maxsize=1)
def _prepared(building: str, values: str) -> Any:
    """Return a building ready to be walked through; cases in a row often share it."""
    from topometric_ros.simulation.buildings import load_building
    from topometric_ros.simulation.cases import SimulationConfig, prepare

    return prepare(load_building(building), with_values(SimulationConfig(), json.loads(values)))
