"""What merging found to and from topometric_msgs/AlignmentArray, exactly.

As in :mod:`message_codec` the message classes come as a namespace with their bare names.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from topometric_ros.alignment import (
    MERGE_SCHEMA,
    TOLD_BASIS,
    AgentPlacement,
    AgentStatus,
    Alignment,
    AlignmentStatus,
    Alternative,
    Basis,
    MergeResult,
    Placed,
    RoomMatch,
)
from topometric_ros.runtime.merger_state import Known
from topometric_ros.runtime.message_codec import CodecError, header, matrix_field, matrix_from
from topometric_ros.topometric_map import TopometricMap

_ALIGNMENT_STATUS = tuple(AlignmentStatus)
_AGENT_STATUS = tuple(AgentStatus)


@dataclass(frozen=True)
class ReceivedAlignments:
    """The content of an AlignmentArray."""

    global_frame: str
    agents: tuple[AgentPlacement, ...]
    alignments: tuple[Alignment, ...]
    warnings: tuple[str, ...]


def alignments_to_message(
    result: MergeResult | Placed,
    classes: Any,
    stamp: int,
    maps: Mapping[str, TopometricMap],
    stale: Sequence[str] = (),
) -> Any:
    """Return a merge's result as topometric_msgs/AlignmentArray.

    Parameters
    ----------
    result : what merging found
    classes : namespace of message classes
    stamp : ns since the epoch
    maps : the map of each agent that the result was made of
    stale : agents whose extractors are gone or whose newer session is not aligned yet
    """
    return classes.AlignmentArray(
        header=header(classes, result.global_frame, stamp),
        schema=MERGE_SCHEMA,
        agents=[
            _placement_message(agent, classes, maps.get(agent.id), agent.id in stale)
            for agent in result.agents
        ],
        alignments=[_alignment_message(alignment, classes) for alignment in result.alignments],
        warnings=list(result.warnings),
    )


def alignments_from_message(message: Any) -> ReceivedAlignments:
    """Undo :func:`alignments_to_message`.

    Raises
    ------
    CodecError
        The message cannot be right.
    """
    if message.schema != MERGE_SCHEMA:
        raise CodecError(f"unknown schema {message.schema!r}; this version reads {MERGE_SCHEMA!r}")
    return ReceivedAlignments(
        global_frame=str(message.header.frame_id),
        agents=tuple(_placement(agent) for agent in message.agents),
        alignments=tuple(_alignment(alignment) for alignment in message.alignments),
        warnings=tuple(map(str, message.warnings)),
    )


def offers_from_message(message: Any) -> list[Known]:
    """Return what another merger found and of which maps, for those that it did not withdraw.

    What it set by hand is its own operator's word and not offered, nor is what waits for newer maps
    to be compared.

    Raises
    ------
    CodecError
        The message cannot be right.
    """
    received = alignments_from_message(message)
    versions = {str(a.id): (str(a.session), int(a.sequence)) for a in message.agents}
    return [
        Known(x, (versions[x.agents[0]], versions[x.agents[1]]), 0.0)
        for x in received.alignments
        if set(x.agents) <= set(versions)
        and x.status is not AlignmentStatus.WITHDRAWN
        and x.basis is Basis.MAPS
    ]


def _placement_message(
    agent: AgentPlacement, classes: Any, m: TopometricMap | None, stale: bool
) -> Any:
    return classes.AgentPlacement(
        id=agent.id,
        source=agent.source,
        status=_AGENT_STATUS.index(agent.status),
        reason=agent.reason,
        group=int(agent.group),
        t_group_agent=matrix_field(agent.T_group_agent),
        has_global=agent.T_global_agent is not None,
        t_global_agent=matrix_field(agent.T_global_agent),
        frame_id=m.frame_id if m else "",
        session=m.session if m else "",
        sequence=int(m.sequence) if m else 0,
        stale=stale,
    )


def _alignment_message(alignment: Alignment, classes: Any) -> Any:
    return classes.Alignment(
        agent_a=alignment.agents[0],
        agent_b=alignment.agents[1],
        status=_ALIGNMENT_STATUS.index(alignment.status),
        reason=alignment.reason,
        has_transform=alignment.T_a_b is not None,
        t_a_b=matrix_field(alignment.T_a_b),
        has_covariance=alignment.covariance is not None,
        covariance=matrix_field(alignment.covariance, 36),
        confidence=float(alignment.confidence),
        overlap=float(alignment.overlap),
        rmse=float(alignment.rmse),
        score=float(alignment.score),
        matches=[
            classes.RoomMatch(
                room_a=int(match.room_a), room_b=int(match.room_b), distance=float(match.distance)
            )
            for match in alignment.matches
        ],
        alternatives=[
            classes.Alternative(
                t_a_b=matrix_field(alternative.T_a_b), score=float(alternative.score)
            )
            for alternative in alignment.alternatives
        ],
    )


def _placement(message: Any) -> AgentPlacement:
    what = f"agent {message.id}"
    has_global = bool(message.has_global)
    return AgentPlacement(
        id=str(message.id),
        source=str(message.source),
        status=_status(_AGENT_STATUS, message.status, what),
        reason=str(message.reason),
        group=int(message.group),
        T_group_agent=matrix_from(message.t_group_agent, what=f"{what}: t_group_agent"),
        T_global_agent=(
            matrix_from(message.t_global_agent, what=f"{what}: t_global_agent")
            if has_global
            else None
        ),
    )


def _alignment(message: Any) -> Alignment:
    what = f"alignment {message.agent_a}-{message.agent_b}"
    numbers = (message.confidence, message.overlap, message.rmse, message.score)
    if not all(map(math.isfinite, numbers)):
        raise CodecError(f"{what}: expected finite numbers, got {numbers}")
    if message.agent_a == message.agent_b:
        raise CodecError(f"{what}: expected two agents")
    if message.status == message.ACCEPTED and not message.has_transform:
        raise CodecError(f"{what}: accepted, but without a transform")
    return Alignment(
        agents=(str(message.agent_a), str(message.agent_b)),
        status=_status(_ALIGNMENT_STATUS, message.status, what),
        reason=str(message.reason),
        T_a_b=matrix_from(message.t_a_b, what=f"{what}: t_a_b") if message.has_transform else None,
        alternatives=tuple(
            Alternative(matrix_from(a.t_a_b, what=f"{what}: alternative"), float(a.score))
            for a in message.alternatives
        ),
        confidence=float(message.confidence),
        overlap=float(message.overlap),
        rmse=float(message.rmse),
        matches=tuple(
            RoomMatch(int(m.room_a), int(m.room_b), float(m.distance)) for m in message.matches
        ),
        covariance=(
            matrix_from(message.covariance, 6, f"{what}: covariance")
            if message.has_covariance
            else None
        ),
        score=float(message.score),
        basis=_basis(str(message.reason)),
    )


def _basis(reason: str) -> Basis:
    """Return what a verdict rests on, for which the message has no field but its reason."""
    told = (basis for basis, words in TOLD_BASIS.items() if reason.endswith(words))
    return next(told, Basis.MAPS)


def _status(known: tuple[Any, ...], value: int, what: str) -> Any:
    if not 0 <= value < len(known):
        raise CodecError(f"{what}: expected a status 0..{len(known) - 1}, got {value}")
    return known[value]
