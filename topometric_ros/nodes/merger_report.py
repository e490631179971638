"""What the merger tells the operator: a status for each agent and for each pair of agents."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from topometric_ros.alignment import (
    AgentPlacement,
    AgentStatus,
    Alignment,
    AlignmentStatus,
    Basis,
    Placed,
)
from topometric_ros.fusion.verification import LEAST_CONFIDENCE
from topometric_ros.nodes.diagnostics import Level, Status
from topometric_ros.topometric_map import TopometricMap

_NANOSECONDS = 1e-9

_ALIGNMENT_LEVELS = {
    AlignmentStatus.ACCEPTED: Level.OK,
    AlignmentStatus.NONE: Level.WARN,
    AlignmentStatus.AMBIGUOUS: Level.WARN,
    AlignmentStatus.REJECTED: Level.WARN,
    AlignmentStatus.WITHDRAWN: Level.ERROR,
}


@dataclass
class InputReport:
    """What came from one agent; `refusal` is why the last message was refused, until a good one."""

    topic: str
    received: int = 0
    refused: int = 0
    refusal: str = ""
    publishers: int = 0
    rivals: int = 0
    """How many publishers its topic has, where it is certain that there are several."""
    newest: TopometricMap | None = None
    arrived: int = 0
    """When `newest` arrived, ns."""
    file: str = ""
    """The file that `newest` was read from; nobody need publish such a map."""

    def refuse(self, reason: str) -> bool:
        """Count a message that cannot be used; return whether the reason is a new one."""
        is_new = reason != self.refusal
        self.refused += 1
        self.refusal = reason
        return is_new


@dataclass
class MergerReport:
    """The inputs by topic, the newest alignments and why the last merge failed, if it did."""

    inputs: dict[str, InputReport] = field(default_factory=dict)
    placed: Placed | None = None
    waiting: int = 0
    """Pairs that are still to be aligned with the newest maps."""
    since: dict[tuple[str, str], int] = field(default_factory=dict)
    """When the present verdict on each pair was come to, ns."""
    failure: str = ""
    changes: tuple[str, ...] = ()
    """What has changed between the agents' visits, in words."""
    unsaved: str = ""
    """Why the state could not be written, if so."""
    gone: dict[str, float] = field(default_factory=dict)
    """For how long (s) the extractors of agents have been gone that are stale."""

    def statuses(self, node: str, now: int) -> list[Status]:
        """Return the statuses of agents and alignments for `/diagnostics`; `now` in ns."""
        placements = {p.id: p for p in self.placed.agents} if self.placed else {}
        result = [self._merge(node)]
        for name, entry in self.inputs.items():
            agent = entry.newest.agent if entry.newest else name
            placement, gone = placements.get(agent), self.gone.get(agent)
            result.append(_agent(node, entry, placement, now, gone))
        rooms = {e.newest.agent: len(e.newest.rooms) for e in self.inputs.values() if e.newest}
        alignments = self.placed.alignments if self.placed else ()
        return result + [
            _alignment(node, x, now - self.since.get(x.agents, now), rooms) for x in alignments
        ]

    def _merge(self, node: str) -> Status:
        if self.failure:
            return Status(f"{node}: merge", Level.ERROR, f"merging failed: {self.failure}")
        if self.placed is None:
            return Status(f"{node}: merge", Level.WARN, "nothing merged yet")
        placed = sum(p.T_global_agent is not None for p in self.placed.agents)
        text = f"{placed} of {len(self.inputs)} agents in the global map"
        values = {"global frame": self.placed.global_frame, "pairs waiting": self.waiting}
        values |= self.placed.timings
        values |= {f"change {i}": line for i, line in enumerate(self.changes, 1)}
        if self.placed.warnings:
            text = f"{text}; {self.placed.warnings[0]}"
        if self.unsaved:
            return Status(f"{node}: merge", Level.ERROR, f"{text}; {self.unsaved}", values)
        complete = placed == len(self.inputs) and not self.placed.warnings
        return Status(f"{node}: merge", Level.OK if complete else Level.WARN, text, values)


def _agent(
    node: str, entry: InputReport, placement: AgentPlacement | None, now: int, gone: float | None
) -> Status:
    name = f"{node}: agent {entry.topic}"
    values: dict[str, object] = {
        "received": entry.received,
        "refused": entry.refused,
        "publishers": entry.publishers,
    }
    m = entry.newest
    if m is not None:
        values |= {
            "agent": m.agent,
            "session": m.session,
            "sequence": m.sequence,
            "frame": m.frame_id,
            "age [s]": max(0, now - entry.arrived) * _NANOSECONDS,  # A clock may be set back.
            "rooms": len(m.rooms),
            "voxels": len(m.voxels),
        }
    if entry.file:
        values["file"] = entry.file
    if entry.refusal:
        return Status(name, Level.ERROR, f"last map refused: {entry.refusal}", values)
    if m is None:
        text = "no map yet" if gone is None else "no map yet: nobody publishes the topic"
        return Status(name, Level.WARN, text, values)
    if gone is not None:
        text = f"its extractor has been gone for {gone:.0f} s; its map is kept"
        return Status(name, Level.STALE, text, values)
    if placement is None:
        return Status(name, Level.WARN, "not merged yet", values)
    known = placement.status is not AgentStatus.UNALIGNED
    text = f"{placement.status}: {placement.reason}" if placement.reason else placement.status.value
    if entry.rivals > 1:
        return Status(name, Level.WARN, f"{entry.rivals} publishers on its topic; {text}", values)
    return Status(name, Level.OK if known else Level.WARN, text, values)


def _alignment(node: str, x: Alignment, age: int, rooms: Mapping[str, int]) -> Status:
    """Return the status of a pair; what is not known of it, as of no pose at all, is left out.

    `rooms` are the numbers of rooms of the agents' maps, `age` (ns) is of the verdict.
    """
    values: dict[str, object] = {
        "status": x.status.value,
        "age [s]": max(0, age) * _NANOSECONDS,
        "rooms": " and ".join(str(rooms.get(agent, 0)) for agent in x.agents),
        "matches": len(x.matches),
        "candidates": len(x.alternatives) + x.accepted,
        "score": float(x.score),
    }
    rivals = sorted((rival.score for rival in x.alternatives), reverse=True)
    if rivals[not x.accepted :]:
        values["score of the next best"] = float(rivals[not x.accepted])
    values |= {"confidence": float(x.confidence), "confidence needed": LEAST_CONFIDENCE}
    if x.T_a_b is not None:
        values |= {"overlap": float(x.overlap), "rmse [m]": float(x.rmse)}
        values |= {} if x.inliers is None else {"inliers": float(x.inliers)}
    name = f"{node}: alignment {' - '.join(x.agents)}"
    level = (
        Level.WARN if x.basis is Basis.OPERATOR and not x.accepted else _ALIGNMENT_LEVELS[x.status]
    )
    return Status(name, level, f"{x.status}: {x.reason}", values)
