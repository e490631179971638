"""What the extractor tells the operator: what came in, what was refused, what came out."""

from __future__ import annotations

from dataclasses import dataclass, field

from topometric_ros.nodes.diagnostics import Level, Status
from topometric_ros.topometric_map import TopometricMap


@dataclass
class ExtractorReport:
    """Counts since the start; `refusal` is why the last cloud was refused, until a good one."""

    received: int = 0
    refused: int = 0
    points_dropped: int = 0
    refusal: str = ""
    failure: str = ""
    published: TopometricMap | None = None
    cpu_s: float = 0.0
    extra: dict[str, object] = field(default_factory=dict)

    def refuse(self, reason: str) -> bool:
        """Count a cloud that cannot be used; return whether the reason is a new one."""
        is_new = reason != self.refusal
        self.refused += 1
        self.refusal = reason
        return is_new

    def statuses(self, node: str, publishers: int, skipped: int) -> list[Status]:
        """Return the statuses of input and map for `/diagnostics`."""
        return [self._input(node, publishers, skipped), self._map(node)]

    def _input(self, node: str, publishers: int, skipped: int) -> Status:
        level, message = Level.OK, f"{self.received} clouds received"
        if self.refusal:
            level, message = Level.ERROR, f"last cloud refused: {self.refusal}"
        elif not self.received:
            level = Level.WARN
            message = "no cloud yet" if publishers else "nobody publishes the cloud topic"
        values = {
            "received": self.received,
            "refused": self.refused,
            "skipped": skipped,
            "non-finite points dropped": self.points_dropped,
            "publishers": publishers,
            **self.extra,
        }
        return Status(f"{node}: input", level, message, values)

    def _map(self, node: str) -> Status:
        if self.failure:
            return Status(f"{node}: map", Level.ERROR, f"no map: {self.failure}")
        m = self.published
        if m is None:
            return Status(f"{node}: map", Level.WARN, "no map yet")
        values = {
            "session": m.session,
            "sequence": m.sequence,
            "rooms": len(m.rooms),
            "passages": len(m.passages),
            "storeys": len(m.storeys),
            "voxels": len(m.voxels),
            "CPU time [s]": self.cpu_s,
        }
        if m.warnings:
            return Status(f"{node}: map", Level.WARN, m.warnings[0], values)
        return Status(f"{node}: map", Level.OK, f"{len(m.rooms)} rooms", values)
