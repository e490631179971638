"""The pictures of one case in an evaluation's report: rooms over truth, overlays, matches, the map.

Where nothing was accepted, or wrongly, the best pose considered, the true pose and the rooms that
the best grown hypothesis held to be the same are drawn too: a refusal is looked at to see why.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from topometric_ros.alignment import Alignment, GlobalMap
from topometric_ros.evaluation.case_result import CaseResult
from topometric_ros.evaluation.evaluate_case import TRUE_POSES, case_folder
from topometric_ros.evaluation.figures import rooms_over_truth
from topometric_ros.io.map_files import load_global_map, load_map
from topometric_ros.matching.propose import propose_from_rooms
from topometric_ros.runtime.config import preset_config
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.figures import global_figure, hex_colour
from topometric_ros.visualization.page import counted, details, picture, text
from topometric_ros.visualization.pair_figures import matches_figure, overlay_figure
from topometric_ros.visualization.report_pairs import best_alternative
from topometric_ros.visualization.stage_files import alignment_of
from topometric_ros.voxels.palette import agent_colour

Maps = Mapping[str, TopometricMap]


def case_card(row: CaseResult, out: Path, verdict: str) -> str:
    """Return the pictures of a case, drawn of what `evaluate_case` left in `out`.

    Parameters
    ----------
    row : of the case
    out : folder of the evaluation
    verdict : HTML that stands beside the title
    """
    folder = case_folder(out, row.case, row.preset)
    merged = json.loads((folder / "merge.json").read_text(encoding="utf-8"))
    agents = [agent["id"] for agent in merged["agents"]]
    maps = {agent["id"]: load_map(out / agent["source"]) for agent in merged["agents"]}
    rooms = [_rooms_card(name, maps[name], row, i, folder) for i, name in enumerate(agents)]
    parts = [
        f"<h3>{text(row.case)} ({text(row.preset)}) {verdict}</h3>",
        f'<div class="pair">{"".join(rooms)}</div>',
    ]
    true_poses = _true_poses(folder, len(merged["alignments"]))
    for k, entry in enumerate(merged["alignments"]):
        parts.append(_pair(entry, maps, agents))
        if not row.right[k]:
            parts.append(_missed(entry, true_poses[k], maps, agents, row.preset))
    placed = [a["id"] for a in merged["agents"] if a["T_global_agent"] is not None]
    if len(placed) > 1:
        fused, observed_by, _ = load_global_map(folder / "global.tmap")
        if observed_by is not None:
            png = global_figure(GlobalMap(fused, observed_by), agents, placed)
            parts.append(picture(png, "fused map", "The fused map; outlined: what each saw."))
    return f'<section class="card">{"".join(parts)}</section>'


def _true_poses(folder: Path, pairs: int) -> list[Any]:
    """Return the true pose of every pair, None where there is none or an older run kept none."""
    path = folder / TRUE_POSES
    return json.loads(path.read_text(encoding="utf-8")) if path.is_file() else [None] * pairs


def _rooms_card(name: str, m: TopometricMap, row: CaseResult, i: int, folder: Path) -> str:
    """Return one agent's rooms over the truth."""
    words = f"agent {name}: {counted(len(m.rooms), 'room')}"
    if row.miou_walked:
        words += f", {row.rooms_walked[i]:.0f} walked through, MIoU walked {row.miou_walked[i]:.2f}"
    true_room = np.load(folder / f"{name}.truth.npy")
    png = rooms_over_truth(m, true_room)
    return f"<div>{picture(png, f'rooms of {name} over truth', words)}</div>"


def _pair(entry: Mapping[str, Any], maps: Maps, agents: Sequence[str]) -> str:
    """Return what one alignment said, its overlay and its matches."""
    alignment = alignment_of(entry)
    words = f"{' and '.join(alignment.agents)}: {alignment.status}: {alignment.reason}"
    parts = [f"<p>{text(words)}</p>"]
    if alignment.T_a_b is not None:
        note = "Walls laid over each other; red: in conflict."
        parts.append(_overlay(alignment, alignment.T_a_b, maps, agents, "overlay", note))
    if alignment.matches:
        parts.append(_matches(alignment, maps, "matches", "matched"))
    return "".join(parts)


def _missed(
    entry: Mapping[str, Any], true_pose: Any, maps: Maps, agents: Sequence[str], preset: str
) -> str:
    """Return what stands behind a refusal or a false merge: other poses and grown matches."""
    alignment = alignment_of(entry)
    a, b = (maps[name] for name in alignment.agents)
    parts = []
    best = best_alternative(alignment)
    if alignment.T_a_b is None and best is not None:
        parts.append(_overlay(alignment, best[0], maps, agents, "best pose", best[1]))
    if true_pose is not None:
        parts.append(_overlay(alignment, true_pose, maps, agents, "true pose", "The true pose."))
    grown = propose_from_rooms(a, b, preset_config(preset).merge.matching)
    if grown and grown[0].matches:
        hypothesis = replace(alignment, matches=grown[0].matches)
        parts.append(_matches(hypothesis, maps, "best grown hypothesis", "grown"))
    return "".join(parts)


def _overlay(
    alignment: Alignment, pose: Any, maps: Maps, agents: Sequence[str], name: str, note: str
) -> str:
    """Return one map laid over the other by a pose (4, 4)."""
    a, b = (maps[agent] for agent in alignment.agents)
    colours = [hex_colour(agent_colour(agents.index(agent))) for agent in alignment.agents]
    png = overlay_figure(a, b, np.asarray(pose, np.float64), (colours[0], colours[1]))
    return picture(png, name, note)


def _matches(alignment: Alignment, maps: Maps, title: str, how: str) -> str:
    """Return the matched rooms of an alignment, folded away."""
    a, b = (maps[agent] for agent in alignment.agents)
    note = f"{counted(len(alignment.matches), 'pair')} of {how} rooms; the others are grey."
    return details(title, picture(matches_figure(a, b, alignment), title, note))
