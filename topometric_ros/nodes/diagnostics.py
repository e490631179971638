"""What an operator sees on `/diagnostics`: a status for each thing that can go wrong by itself."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from typing import Any

from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue


class Level(IntEnum):
    """The levels of diagnostic_msgs/DiagnosticStatus."""

    OK = 0
    WARN = 1
    ERROR = 2
    STALE = 3


@dataclass(frozen=True)
class Status:
    """One line of the operator's table, with the numbers behind it."""

    name: str
    level: Level
    message: str
    values: Mapping[str, Any] = field(default_factory=dict)


def to_message(statuses: Iterable[Status], hardware_id: str, stamp: Time) -> DiagnosticArray:
    """Return the statuses as one diagnostic_msgs/DiagnosticArray."""
    array = DiagnosticArray()
    array.header.stamp = stamp
    for status in statuses:
        array.status.append(
            DiagnosticStatus(
                level=bytes([status.level]),
                name=status.name,
                message=status.message,
                hardware_id=hardware_id,
                values=[KeyValue(key=k, value=_text(v)) for k, v in status.values.items()],
            )
        )
    return array


def _text(value: Any) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
