"""One case under one preset, from clouds to a row: extract, merge, compare with the truth.

What the report draws is left in the output folder: maps below `maps/`, by their content's hash, so
that cases with the same cloud share them, and the merge with the voxels' true rooms below `cases/`.
"""

from __future__ import annotations

import hashlib
import itertools
import re
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

import topometric_ros
from topometric_ros.alignment import MergeResult
from topometric_ros.evaluation.case import (
    EvaluationCase,
    crossed_case,
    of_case,
    simulate_agents,
)
from topometric_ros.evaluation.case_result import CaseResult, Numbers, Seconds
from topometric_ros.evaluation.metrics_fusion import bytes_on_the_wire
from topometric_ros.evaluation.metrics_rooms import (
    edge_counts,
    room_scores,
)
from topometric_ros.evaluation.score_pair import ScoredAgent, score_pair, scored_agent
from topometric_ros.evaluation.suite import RELEASED, CaseSpec
from topometric_ros.fusion.merge import merge
from topometric_ros.fusion.poses import Transform, apply, inverse
from topometric_ros.io.map_files import load_map, save_map
from topometric_ros.io.merge_files import merge_summary
from topometric_ros.io.summaries import matrix_rows, write_json
from topometric_ros.runtime.config import ToolConfig, dump_config, preset_config
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.runtime.sources import session_id
from topometric_ros.simulation.case import SimulatedAgent
from topometric_ros.simulation.case_files import read_case
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.grid import voxelise

TRUE_POSES = "true_poses.json"
"""In a case's folder: the true T_a_b (4, 4) m of every pair in `merge.json`'s order, or null."""


def evaluate_case(
    case: EvaluationCase, spec: CaseSpec, preset: str, key: str, out: Path
) -> tuple[CaseResult, Seconds]:
    """Run a case and score it; raises TopometricError where nothing can be extracted.

    Parameters
    ----------
    case, spec : the case and where it is from
    preset : of extraction and merging
    key : of the row, see `rows.row_key`
    out : folder of the evaluation
    """
    config = preset_config(preset)
    start = time.process_time()
    extracted = [_map_of(agent, config, out) for agent in case.agents]
    maps = [m for m, _ in extracted]
    middle = time.process_time()
    result = merge(maps, config.merge, sources={m.agent: file for m, file in extracted})
    end = time.process_time()
    scored = [scored_agent(agent, m) for agent, m in zip(case.agents, maps, strict=True)]
    _keep(case_folder(out, spec.name, preset), case, result, scored)
    columns: dict[str, Any] = {
        "points": tuple(float(len(agent.points)) for agent in case.agents),
        "message_bytes": tuple(float(bytes_on_the_wire(m)) for m in maps),
        **(_room_columns(case, scored) if case.rooms else {}),
        **_pair_columns(case, scored, result, config),
    }
    row = CaseResult(key, spec.name, preset, spec.group, spec.building, spec.seed, **columns)
    return row, Seconds(middle - start, end - middle)


def load_case(spec: CaseSpec) -> EvaluationCase:
    """Read or simulate a case; raises TopometricError."""
    folders = [Path(folder) for folder in spec.folders]
    if len(folders) == 2:
        return crossed_case(folders[0], folders[1])
    if folders:
        return of_case(read_case(folders[0]))
    if spec.agents == RELEASED:
        from topometric_ros.simulation.released import released_case  # It imports Open3D.

        return of_case(released_case(Path(spec.building), spec.seed))
    return of_case(simulate_agents(spec))


def case_folder(out: Path, case: str, preset: str) -> Path:
    """Return where a case's files lie; names that differ give folders that differ."""
    short = re.sub(r"[^\w.=-]+", "_", case)[:80]
    return out / "cases" / f"{short}-{hashlib.sha256(case.encode()).hexdigest()[:8]}" / preset


def _map_of(agent: SimulatedAgent, config: ToolConfig, out: Path) -> tuple[TopometricMap, str]:
    """Extract an agent's map, or take the one that was extracted of the same cloud before."""
    text = f"{topometric_ros.__version__}\n{agent.id}\n{dump_config(config)}"
    digest = hashlib.sha256(text.encode())
    digest.update(np.ascontiguousarray(agent.points).tobytes())
    file = f"maps/{digest.hexdigest()[:16]}.tmap"
    if not (out / file).is_file():
        extraction = extract_map(
            agent.points,
            config.extraction,
            config.merge.matching,
            agent=agent.id,
            session=session_id(0, agent.id, 0),
            sequence=1,
        )
        (out / "maps").mkdir(parents=True, exist_ok=True)
        save_map(out / file, extraction.map)
    return load_map(out / file), file


def _room_columns(case: EvaluationCase, scored: Sequence[ScoredAgent]) -> dict[str, Numbers]:
    """Return the columns of the rooms, one number an agent."""
    scores, edges = [], []
    for i, entry in enumerate(scored):
        whole = _whole_sizes(case, i, entry.map)
        scores.append(room_scores(entry.overlap, entry.agent.rooms_walked, whole))
        if case.links is not None:
            passages = {p.rooms for p in entry.map.passages}
            edges.append(edge_counts(entry.overlap, passages, case.links))
    return {
        "rooms_walked": tuple(float(s.walked) for s in scores),
        "rooms_found": tuple(float(s.found) for s in scores),
        "miou_paper": tuple(s.miou_paper for s in scores),
        "left_over": tuple(float(s.left_over) for s in scores),
        "miou_whole": tuple(s.miou_whole for s in scores),
        "miou_walked": tuple(s.miou_walked for s in scores),
        "room_precision": tuple(s.precision for s in scores),
        "room_recall": tuple(s.recall for s in scores),
        "edges_found": tuple(float(e.found) for e in edges),
        "edges_right": tuple(float(e.right) for e in edges),
        "edges_true": tuple(float(e.true) for e in edges),
        "edges_covered": tuple(float(e.covered) for e in edges),
    }


def _whole_sizes(case: EvaluationCase, i: int, m: TopometricMap) -> dict[int, int]:
    """Return the voxels of each true room in what all agents together saw, on map i's lattice."""
    parts, labels = [], []
    for j, agent in enumerate(case.agents):
        T = np.eye(4) if i == j else _transform(case, i, j)
        if T is not None:
            inside = agent.room >= 0
            parts.append(apply(m.T_level_input @ T, agent.points[inside]))
            labels.append(agent.room[inside])
    points, label = np.concatenate(parts), np.concatenate(labels).astype(np.int64)
    if not len(points):
        return {}
    _, cell = voxelise(points, m.voxel_size, np.asarray(m.origin))
    # A voxel on a wall may be of two rooms: the one with the lower id has it.
    first = np.lexsort((label, cell))
    cell, label = cell[first], label[first]
    ids, counts = np.unique(label[np.unique(cell, return_index=True)[1]], return_counts=True)
    return dict(zip(ids.tolist(), counts.tolist(), strict=True))


def _transform(case: EvaluationCase, i: int, j: int) -> Transform | None:
    """Return the true T_i_j of two agents."""
    order = list(itertools.combinations(range(len(case.agents)), 2))
    T = case.pairs[order.index((min(i, j), max(i, j)))].T_a_b
    return T if T is None or i < j else inverse(T)


def _pair_columns(
    case: EvaluationCase, scored: Sequence[ScoredAgent], result: MergeResult, config: ToolConfig
) -> dict[str, Numbers]:
    """Return the columns of alignments and matches, one number for every two agents."""
    couples = itertools.combinations(scored, 2)
    rows = [
        score_pair(a, b, truth, alignment, config.merge.matching, case.rooms)
        for (a, b), truth, alignment in zip(couples, case.pairs, result.alignments, strict=True)
    ]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: tuple(row[name] for row in rows) for name in names}


def _keep(
    folder: Path, case: EvaluationCase, result: MergeResult, scored: Sequence[ScoredAgent]
) -> None:
    """Leave in a folder what the report draws."""
    folder.mkdir(parents=True, exist_ok=True)
    write_json(folder / "merge.json", merge_summary(result))
    write_json(folder / TRUE_POSES, [matrix_rows(pair.T_a_b) for pair in case.pairs])
    observers = tuple(agent.id for agent in result.agents)
    save_map(folder / "global.tmap", result.global_map.map, result.global_map.agents, observers)
    for entry in scored:
        np.save(folder / f"{entry.agent.id}.truth.npy", entry.true_room)
