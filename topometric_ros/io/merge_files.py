"""What merging writes: merge.json, global.ply and global.tmap (docs/formats.md)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from topometric_ros.alignment import MERGE_SCHEMA, Alignment, GlobalMap, MergeResult
from topometric_ros.io.map_files import save_map
from topometric_ros.io.ply import write_ply
from topometric_ros.io.summaries import matrix_rows, write_json, write_rooms_ply


def write_merge_files(folder: Path, result: MergeResult) -> None:
    """Write merge.json, global.ply and global.tmap into a folder.

    Where maps contradict each other changes.ply too: `agent` is the index of who holds a point.
    """
    write_json(folder / "merge.json", merge_summary(result))
    write_rooms_ply(folder / "global.ply", result.global_map.map, result.global_map.agents)
    observers = tuple(agent.id for agent in result.agents)
    save_map(folder / "global.tmap", result.global_map.map, result.global_map.agents, observers)
    if result.global_map.changes:
        _write_changes(folder / "changes.ply", result.global_map)


def _write_changes(path: Path, global_map: GlobalMap) -> None:
    """Write what has changed: red what is gone, green what has appeared, yellow where unknown."""
    T = np.linalg.inv(global_map.map.T_level_input)
    dtype = [(axis, "<f8") for axis in "xyz"] + [("agent", "<i4"), ("gone", "u1")]
    dtype += [(channel, "u1") for channel in ("red", "green", "blue")]
    parts = []
    for change in global_map.changes:
        part = np.zeros(len(change.points), dtype)
        points = change.points @ T[:3, :3].T + T[:3, 3]
        for axis, name in enumerate("xyz"):
            part[name] = points[:, axis]
        part["agent"], part["gone"] = change.holder, change.gone
        part["red"] = 0 if change.ordered and not change.gone else 220
        part["green"] = 0 if change.gone else 180
        parts.append(part)
    write_ply(path, np.concatenate(parts))


def merge_summary(result: MergeResult) -> dict[str, Any]:
    """Return the content of merge.json."""
    return {
        "schema": MERGE_SCHEMA,
        "global_frame": result.global_frame,
        "warnings": list(result.warnings),
        "agents": [
            {
                "id": agent.id,
                "source": agent.source,
                "status": str(agent.status),
                "reason": agent.reason,
                "group": int(agent.group),
                "T_group_agent": matrix_rows(agent.T_group_agent),
                "T_global_agent": matrix_rows(agent.T_global_agent),
            }
            for agent in result.agents
        ],
        "alignments": [_alignment(alignment) for alignment in result.alignments],
        "rooms": [
            {"id": int(room), "of": [[result.agents[k].id, int(own)] for k, own in keys]}
            for room, keys in result.global_map.rooms_of.items()
        ],
    }


def _alignment(alignment: Alignment) -> dict[str, Any]:
    return {
        "agents": list(alignment.agents),
        "status": str(alignment.status),
        "reason": alignment.reason,
        "T_a_b": matrix_rows(alignment.T_a_b),
        "alternatives": [
            {"T_a_b": matrix_rows(alternative.T_a_b), "score": float(alternative.score)}
            for alternative in alignment.alternatives
        ],
        "score": float(alignment.score),
        "confidence": float(alignment.confidence),
        "overlap": float(alignment.overlap),
        "rmse": float(alignment.rmse),
        "inliers": alignment.inliers if alignment.inliers is None else float(alignment.inliers),
        "covariance": matrix_rows(alignment.covariance),
        "matches": [
            [int(match.room_a), int(match.room_b), float(match.distance)]
            for match in alignment.matches
        ],
    }
