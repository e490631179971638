"""What a merger knows, as a file: maps, alignments, what was set by hand. Survives a restart.

The container is that of a .tmap file (`io/map_format.py`) with whole .tmap files as its sections:
sizes and checksums are verified before anything is believed. Written in one step.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import Alignment, AlignmentStatus, Alternative, Basis, RoomMatch
from topometric_ros.errors import one_line
from topometric_ros.fusion.merge import MOST_AGENTS
from topometric_ros.io.map_files import decode_map, encode_map
from topometric_ros.io.map_format import MapFileError, Section, encode, read_sections
from topometric_ros.io.packing import PackingError
from topometric_ros.io.summaries import matrix_rows, optional, write_atomically
from topometric_ros.runtime.transforms import TransformError, check_rigid
from topometric_ros.topometric_map import TopometricMap

SCHEMA = "topometric-state/1"

MOST_ENDED = 1000
"""Ended sessions of an agent that are remembered: a day's, of one that starts every two minutes."""

Version = tuple[str, int]
"""Session and sequence of a map."""


def version_of(m: TopometricMap) -> Version:
    """Return which version of its agent's map this is."""
    return m.session, m.sequence


@dataclass(frozen=True)
class Known:
    """An alignment and the versions (session, sequence) of the two maps that it was made from."""

    alignment: Alignment
    versions: tuple[Version, Version]
    support: float
    """Voxels that both maps held when the alignment was made."""
    parameters: str = ""
    """Mark of the parameters that it was made with, see :mod:`pair_parameters`; empty: the present
    ones, as far as is known."""


@dataclass(frozen=True)
class MergerState:
    """A merger's memory: see :class:`MergerSession` for what the parts mean.

    `newer` are maps of sessions that are not aligned yet, `ended` the sessions that each agent has
    left behind, `fixed` the alignments that were set by hand, `removed` the pairs that were taken
    back.
    """

    order: tuple[str, ...] = ()
    maps: Mapping[str, TopometricMap] = field(default_factory=dict)
    newer: Mapping[str, TopometricMap] = field(default_factory=dict)
    sources: Mapping[str, str] = field(default_factory=dict)
    ended: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    known: tuple[Known, ...] = ()
    fixed: tuple[Alignment, ...] = ()
    removed: tuple[tuple[str, str], ...] = ()


class EncodedMaps:
    """The bytes of the maps in a state file, kept so that only maps that are new are encoded."""

    def __init__(self) -> None:
        self._held: dict[str, tuple[TopometricMap, bytes]] = {}

    def of(self, maps: Mapping[str, TopometricMap]) -> dict[str, bytes]:
        """Return the bytes of each map, by its name; those of maps that are gone are dropped."""
        known = {name: held for name, held in self._held.items() if maps.get(name) is held[0]}
        self._held = {name: known.get(name) or (m, encode_map(m)) for name, m in maps.items()}
        return {name: data for name, (_, data) in self._held.items()}


def save_state(path: Path, state: MergerState, encoded: EncodedMaps | None = None) -> None:
    """Write a state in one step: an older file stays until the new one is whole, on the disk.

    Parameters
    ----------
    path, state : where to, and what
    encoded : what was encoded for the file before; the bytes that are written do not depend on it

    Raises
    ------
    MapFileError
        The file cannot be written.
    """
    named = {
        f"{kind}[{agent}]": held[agent]
        for kind, held in (("maps", state.maps), ("newer", state.newer))
        for agent in sorted(held)
    }
    fields = {
        "schema": SCHEMA,
        "order": list(state.order),
        "sources": dict(state.sources),
        "ended": {agent: list(sessions) for agent, sessions in state.ended.items()},
        "maps": sorted(state.maps),
        "newer": sorted(state.newer),
        "known": [
            {
                "alignment": _fields(entry.alignment),
                "versions": [list(version) for version in entry.versions],
                "support": float(entry.support),
                "parameters": entry.parameters,
            }
            for entry in state.known
        ],
        "fixed": [_fields(alignment) for alignment in state.fixed],
        "removed": [list(pair) for pair in state.removed],
    }
    try:
        sections = [
            Section(name, "array", np.frombuffer(data, np.int8))
            for name, data in (encoded or EncodedMaps()).of(named).items()
        ]
        data = encode(fields, sections)
    except (PackingError, ValueError) as error:
        raise MapFileError(f"{path}: the state cannot be packed: {error}") from error
    write_atomically(path, data, durable=True)


def load_state(path: Path) -> MergerState:
    """Read a state.

    Raises
    ------
    MapFileError
        The file is missing, damaged, or of another kind or version.
    """
    fields, arrays = read_sections(path, SCHEMA)
    try:
        state = MergerState(
            order=tuple(str(agent) for agent in fields["order"]),
            maps=_maps(fields["maps"], "maps", arrays, path),
            newer=_maps(fields["newer"], "newer", arrays, path),
            sources={str(agent): str(source) for agent, source in fields["sources"].items()},
            ended={str(a): tuple(map(str, sessions)) for a, sessions in fields["ended"].items()},
            known=tuple(_known(entry) for entry in fields["known"]),
            fixed=tuple(_alignment(entry, Basis.OPERATOR) for entry in fields["fixed"]),
            removed=tuple((str(a), str(b)) for a, b in fields.get("removed", ())),
        )
        _check(state)
        return state
    except (KeyError, IndexError, TypeError, ValueError, AttributeError, TransformError) as error:
        raise MapFileError(f"{path}: the state makes no sense: {one_line(error)}") from error


def _check(state: MergerState) -> None:
    """Raise ValueError where the parts of a state contradict each other."""
    for held in (state.maps, state.newer):
        for agent, m in held.items():
            if agent not in state.order or agent not in state.maps or m.agent != agent:
                raise ValueError(f"a map of {m.agent!r} in the place of {agent!r}")
    if len(state.maps) > MOST_AGENTS:
        raise ValueError(f"maps of {len(state.maps)} agents, at most {MOST_AGENTS} can be merged")
    for x in (*(entry.alignment for entry in state.known), *state.fixed):
        if x.agents[0] == x.agents[1] or (x.accepted and x.T_a_b is None):
            raise ValueError(f"an alignment of {' and '.join(x.agents)} without a transform")


def _maps(
    agents: list[str], kind: str, arrays: Mapping[str, NDArray[Any]], path: Path
) -> dict[str, TopometricMap]:
    return {
        str(agent): decode_map(arrays[f"{kind}[{agent}]"].tobytes(), f"{path}: {kind} of {agent}")[
            0
        ]
        for agent in agents
    }


def _known(entry: Mapping[str, Any]) -> Known:
    (session_a, sequence_a), (session_b, sequence_b) = entry["versions"]
    versions = ((str(session_a), int(sequence_a)), (str(session_b), int(sequence_b)))
    parameters = str(entry.get("parameters", ""))
    return Known(_alignment(entry["alignment"]), versions, float(entry["support"]), parameters)


def _fields(alignment: Alignment) -> dict[str, Any]:
    return {
        "agents": list(alignment.agents),
        "status": str(alignment.status),
        "reason": alignment.reason,
        "T_a_b": matrix_rows(alignment.T_a_b),
        "alternatives": [[matrix_rows(x.T_a_b), float(x.score)] for x in alignment.alternatives],
        "confidence": float(alignment.confidence),
        "overlap": float(alignment.overlap),
        "rmse": float(alignment.rmse),
        "matches": [[int(m.room_a), int(m.room_b), float(m.distance)] for m in alignment.matches],
        "covariance": matrix_rows(alignment.covariance),
        "score": float(alignment.score),
        "inliers": optional(alignment.inliers),
    }


def _alignment(entry: Mapping[str, Any], basis: Basis = Basis.MAPS) -> Alignment:
    a, b = entry["agents"]
    T = _matrix(entry["T_a_b"], 4)
    if T is not None:
        check_rigid(T, f"alignment of {a} and {b}")
    alternatives = ((_matrix(rows, 4), float(score)) for rows, score in entry["alternatives"])
    return Alignment(
        agents=(str(a), str(b)),
        status=AlignmentStatus(entry["status"]),
        reason=str(entry["reason"]),
        T_a_b=T,
        alternatives=tuple(Alternative(pose, s) for pose, s in alternatives if pose is not None),
        confidence=float(entry["confidence"]),
        overlap=float(entry["overlap"]),
        rmse=float(entry["rmse"]),
        matches=tuple(RoomMatch(int(i), int(j), float(d)) for i, j, d in entry["matches"]),
        covariance=_matrix(entry["covariance"], 6),
        score=float(entry["score"]),
        inliers=optional(entry.get("inliers")),  # Older files have none.
        basis=basis,
    )


def _matrix(rows: list[list[float]] | None, size: int) -> NDArray[np.float64] | None:
    if rows is None:
        return None
    matrix = np.array(rows, np.float64)
    if matrix.shape != (size, size):
        raise ValueError(f"expected a matrix of {size} x {size} numbers, got {matrix.shape}")
    return matrix
