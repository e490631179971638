"""What merging writes: merge.json, global.ply and global.tmap (design, section 4)."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from topometric_ros.alignment import MERGE_SCHEMA, Alignment, MergeResult
from topometric_ros.io.map_files import save_map
from topometric_ros.io.summaries import matrix_rows, write_json, write_rooms_ply


def write_merge_files(folder: Path, result: MergeResult) -> None:
    """Write merge.json, global.ply, global.tmap and timings.json into a folder."""
    write_json(folder / "merge.json", merge_summary(result))
    write_rooms_ply(folder / "global.ply", result.global_map.map, result.global_map.agents)
    observers = tuple(agent.id for agent in result.agents)
    save_map(folder / "global.tmap", result.global_map.map, result.global_map.agents, observers)
    write_json(folder / "timings.json", rounded_timings(result.timings))


def rounded_timings(timings: dict[str, float]) -> dict[str, float]:
    """Return CPU seconds by stage to a tenth of a millisecond."""
    return {stage: round(float(seconds), 4) for stage, seconds in timings.items()}


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
        "confidence": float(alignment.confidence),
        "overlap": float(alignment.overlap),
        "rmse": float(alignment.rmse),
        "covariance": matrix_rows(alignment.covariance),
        "matches": [
            [int(match.room_a), int(match.room_b), float(match.distance)]
            for match in alignment.matches
        ],
    }
