"""What the extractor tells the operator: what came in, what was refused, what came out."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import dataclass

from topometric_ros.extraction.quality import Quality
from topometric_ros.nodes.diagnostics import Level, Status
from topometric_ros.nodes.running import SILENT_S
from topometric_ros.topometric_map import TopometricMap

_LOST_TOLD_S = 60.0
"""How long scans that were lost stay a warning."""


@dataclass
class ExtractorReport:
    """What happened since the start; `refusal` is why the last cloud was refused, if it was,
    `missing` why scans were last given up; `superseded` are map clouds that newer ones replaced,
    `lost` scans that the queue had no room for, of which the map holds nothing."""

    received: int = 0
    silence: str = ""
    """Why nothing has arrived so far."""
    refused: int = 0
    refusal: str = ""
    missing: str = ""
    unchanged: int = 0
    superseded: int = 0
    lost: int = 0
    loss: str = ""
    """How scans were last lost."""
    lost_on_the_way: int = 0
    lost_at: float = -float("inf")
    """When scans were last lost, s of the monotonic clock."""
    failure: str = ""
    unsaved: str = ""
    """Why what was gathered could not be written, if so."""
    _silence_told: bool = False
    published: TopometricMap | None = None
    quality: Quality | None = None
    cpu_s: float = 0.0

    def refuse(self, reason: str) -> bool:
        """Count a cloud that cannot be used; return whether the reason is a new one."""
        is_new = reason != self.refusal
        self.refused += 1
        self.refusal = reason
        return is_new

    def miss(self, reason: str) -> bool:
        """Note why scans found no place in the map; return whether the reason is a new one.

        Times differ from scan to scan, so reasons are told apart by what comes before them.
        """
        told = reason.partition(" at ")[0]
        is_new = told != self.missing
        self.missing = told
        return is_new

    def hear(self, silence: str, since: float) -> bool:
        """Note why nothing has arrived since the start, s of the monotonic clock.

        Return whether that is to be told now; it is told once.
        """
        self.silence = "" if self.received else silence
        due = bool(self.silence) and not self._silence_told
        if not due or time.monotonic() - since < SILENT_S:
            return False
        self._silence_told = True
        return True

    def lose(self, scans: int, how: str) -> bool:
        """Count scans that were lost; return whether none had been so for a while."""
        is_new = scans > 0 and not (self._loses() and how == self.loss)
        if scans > 0:
            self.lost, self.loss = self.lost + scans, how
            self.lost_at = time.monotonic()
        return is_new

    def _loses(self) -> bool:
        return time.monotonic() - self.lost_at < _LOST_TOLD_S

    def extracted(self, topometric_map: TopometricMap, quality: Quality, cpu_s: float) -> None:
        """Note a map that was published, how good it is and the CPU time that it took."""
        self.published, self.quality = topometric_map, quality
        self.cpu_s, self.failure = cpu_s, ""

    def statuses(self, node: str, numbers: Mapping[str, object]) -> list[Status]:
        """Return the statuses of input and map for `/diagnostics`; `numbers` are of the input.

        Once there is a map, a third one tells its quality.
        """
        return [self._input(node, numbers), self._map(node), *self._quality(node)]

    def _input(self, node: str, numbers: Mapping[str, object]) -> Status:
        level, message = Level.OK, f"{self.received} clouds received"
        if self.refusal:
            level, message = Level.ERROR, f"last cloud refused: {self.refusal}"
        elif not self.received:
            level, message = Level.WARN, f"no cloud yet: {self.silence}"
        elif self._loses():
            level, message = Level.WARN, f"{self.lost} scans lost: {self.loss}"
            if numbers.get("waits for"):
                message += f"; {numbers['waits for']}"
        elif numbers.get("waits for"):
            level = Level.WARN
            message = f"{numbers['waiting for transforms']} scans wait: {numbers['waits for']}"
        elif self.missing and not numbers["scans"]:
            level, message = Level.WARN, f"no scan could be placed: {self.missing}"
        values = {"received": self.received, "refused": self.refused, **numbers}
        values |= {"superseded": self.superseded, "scans lost": self.lost}
        values |= {"lost on the way": self.lost_on_the_way}
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
        if self.unsaved:
            return Status(f"{node}: map", Level.ERROR, self.unsaved, values)
        if m.warnings:
            return Status(f"{node}: map", Level.WARN, m.warnings[0], values)
        return Status(f"{node}: map", Level.OK, f"{len(m.rooms)} rooms", values)

    def _quality(self, node: str) -> list[Status]:
        if self.quality is None:
            return []
        content = self.quality.content()
        values: dict[str, object] = {
            name: v for name, v in content.items() if isinstance(v, int | float)
        }
        values |= {f"in no room: {k}": v for k, v in content["unlabelled"].items()}
        values |= {f.code: str(f) for f in self.quality.findings}
        warnings = self.quality.warnings()
        level = Level.WARN if warnings else Level.OK
        message = warnings[0] if warnings else "nothing looks wrong"
        more = f" (and {len(warnings) - 1} more)" if len(warnings) > 1 else ""
        return [Status(f"{node}: quality", level, message + more, values)]
