"""What the extractor tells the operator: what came in, what was refused, what came out."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from topometric_ros.nodes.diagnostics import Level, Status
from topometric_ros.topometric_map import TopometricMap


@dataclass
class ExtractorReport:
    """What happened since the start; `refusal` is why the last cloud was refused, if it was."""

    received: int = 0
    refused: int = 0
    refusal: str = ""
    failure: str = ""
    published: TopometricMap | None = None
    cpu_s: float = 0.0

    def refuse(self, reason: str) -> bool:
        """Count a cloud that cannot be used; return whether the reason is a new one."""
        is_new = reason != self.refusal
        self.refused += 1
        self.refusal = reason
        return is_new

    def extracted(self, topometric_map: TopometricMap, cpu_s: float) -> None:
        """Note a map that was published and the CPU time that it took."""
        self.published, self.cpu_s, self.failure = topometric_map, cpu_s, ""

    def statuses(self, node: str, numbers: Mapping[str, object]) -> list[Status]:
        """Return the statuses of input and map for `/diagnostics`; `numbers` are of the input."""
        return [self._input(node, numbers), self._map(node)]

    def _input(self, node: str, numbers: Mapping[str, object]) -> Status:
        level, message = Level.OK, f"{self.received} clouds received"
        if self.refusal:
            level, message = Level.ERROR, f"last cloud refused: {self.refusal}"
        elif not self.received:
            level = Level.WARN
            message = "no cloud yet" if numbers["publishers"] else "nobody publishes the topic"
        values = {"received": self.received, "refused": self.refused, **numbers}
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
