"""What a pose must show to be believed, whatever its rivals: the gates, and when they give way.

Enough must have been seen in common to fix the position, and hardly anything may speak against it.
Shares are judged by their lower bound: that 7 of 382 cells conflict does not prove 1.5 %.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from topometric_ros.configuration import parameter
from topometric_ros.fusion.furniture import Pieces
from topometric_ros.matching.evidence import Evidence

_ACROSS_ENOUGH = 2.5
"""Wall that runs across (m) from which its share does not matter."""

_ACROSS_AT_ALL = 1.0
"""Wall that runs across (m) without which no slide is asked: two corridors side by side."""

_WALL_CLUMP, FURNITURE_CLUMP = 2.0, 3.0
"""Neighbouring cells that err together and count as one."""


@dataclass(frozen=True)
class _Leniency:
    """When more conflict than the gates allow may pass: limits as in `VerificationConfig`."""

    wall_conflict: float
    furniture_conflict: float
    furniture_judged: int
    ratio: float
    gap: float


_MOVED = _Leniency(0.01, 0.35, 0, ratio=0.15, gap=300.0)
"""Furniture moved between two visits: the walls of several rooms vouch for the place."""

_VOUCHED = _Leniency(0.04, 0.05, 100, ratio=0.15, gap=600.0)
"""Doors opened and shut between two visits put walls into free floor; that it is the same place is
then vouched for by much furniture standing where it stood. Look-alike wings do not have that."""

_CHANGED = _Leniency(0.06, 0.30, 0, ratio=0.15, gap=300.0)
"""Other doors and other furniture too: only walls and the lack of a rival speak for the pose."""


@dataclass(frozen=True)
class VerificationConfig:
    """What a pose must show to be accepted."""

    free_floor: float = parameter(
        6.0, "Floor that both maps must have seen free.", unit="m²", minimum=0.0
    )
    agreed_wall: float = parameter(
        5.0, "Wall that both maps must have seen from the same side.", unit="m", minimum=0.0
    )
    smallest_eigenvalue: float = parameter(
        1.5, "Wall in common that must run across the main direction.", unit="m", minimum=0.0
    )
    across_share: float = parameter(
        0.2, "Wall in common that must run across the main direction, as a share of the wall along "
        "it; from 2.5 m across on no more is asked for.", minimum=0.0, maximum=1.0,
    )  # fmt: skip
    slide_cost: float = parameter(
        0.5, "Share of the score that a slide along the walls must cost where less of them runs "
        "across: ends of walls and doors fix a position too; above 1: never.", minimum=0.0,
        maximum=2.0,
    )  # fmt: skip
    wall_conflict: float = parameter(
        0.015, "Share of judged wall cells that may stand in the other's free floor, beyond doubt: "
        "the lower bound of the share counts.", minimum=0.0, maximum=1.0,
    )  # fmt: skip
    furniture_conflict: float = parameter(
        0.15, "Share of judged furniture cells that may stand on the other's bare floor, beyond "
        "doubt: the lower bound of the share counts.", minimum=0.0, maximum=1.0,
    )  # fmt: skip
    furniture_judged: int = parameter(
        15, "Furniture cells from which their conflict counts.", minimum=0
    )
    clear_ratio: float = parameter(
        0.30, "Runner-up's share of the best value up to which `clear_gap` decides.", minimum=0.0,
        maximum=1.0,
    )  # fmt: skip
    clear_gap: float = parameter(
        90.0, "Lead of the best value where the runner-up is far behind.", minimum=0.0
    )
    wide_ratio: float = parameter(
        0.75, "Runner-up's share of the best value up to which `wide_gap` decides.", minimum=0.0,
        maximum=1.0,
    )  # fmt: skip
    wide_gap: float = parameter(
        500.0, "Lead of the best value where the runner-up is near.", minimum=0.0
    )
    twin_share: float = parameter(
        0.8, "Share of the smaller map's floor in common from which it may be another, identical "
        "flat; above 1: never.", minimum=0.0, maximum=2.0,
    )  # fmt: skip
    twin_furniture: float = parameter(
        0.005, "Share of the furniture in conflict from which the smaller map may be of another, "
        "identical flat.", minimum=0.0, maximum=1.0,
    )  # fmt: skip
    twin_floor: float = parameter(
        120.0, "Floor in common from which the maps are of no flat: whole floors have no twin "
        "that is furnished like them.", unit="m²", minimum=0.0,
    )  # fmt: skip
    twin_part: float = parameter(
        35.0, "Floor in common below which a map that lies in the other for the most part may be a "
        "part of an identical flat, whatever the furniture; 0: never.", unit="m²", minimum=0.0,
    )  # fmt: skip
    repeated_floor: float = parameter(
        70.0, "Floor in common below which it must not fit another part of the maps too: a room or "
        "two may repeat.", unit="m²", minimum=0.0,
    )  # fmt: skip
    repeated_part: float = parameter(
        0.3, "Part of the smaller map's floor in common below which that must not fit another part "
        "of the maps either.", minimum=0.0, maximum=1.0,
    )  # fmt: skip
    repeated_share: float = parameter(
        0.4, "How well a small part in common may fit elsewhere too, as a share of how it "
        "fits here.",
        minimum=0.0, maximum=10.0,
    )  # fmt: skip
    changed_furniture: bool = parameter(
        False,
        "Also accept where doors and furniture changed, if much more is in common: for maps "
        "of different days, where no storey is built like another one.",
    )
    same_distance: float = parameter(
        0.6, "Poses nearer than this on the plan are one.", unit="m", minimum=0.0, maximum=5.0
    )
    same_angle: float = parameter(
        6.0, "Poses turned by less than this are one.", unit="deg", minimum=0.0, maximum=45.0
    )
    same_height: float = parameter(
        0.3, "Poses nearer than this in height are one.", unit="m", minimum=0.0, maximum=2.0
    )


def objection(
    evidence: Evidence,
    gap: float,
    ratio: float,
    config: VerificationConfig,
    furniture: Callable[[], Pieces] | None = None,
) -> str | None:
    """Return what speaks against a pose, in a sentence, or None where it may be accepted.

    After registration the evidence is computed anew and asked again, with the decision's `gap` and
    `ratio`: a pose that passed must still pass where ICP has moved it. Where nothing but furniture
    speaks against it, it was moved if the rest stands where it stood to the centimetre: `furniture`
    is asked for that, where there is one.
    """
    missed = missed_gate(evidence, config)
    if missed is None or _holds_despite(evidence, gap, ratio, config):
        return None
    if furniture is not None and _missed_by_walls(evidence, config) is None and furniture().same:
        return None
    return missed


def missed_gate(evidence: Evidence, config: VerificationConfig) -> str | None:
    """Return the sentence of the first gate that a pose fails, or None where it passes all."""
    return _missed_by_walls(evidence, config) or _misplaced(evidence, config)


def _missed_by_walls(e: Evidence, config: VerificationConfig) -> str | None:
    if e.storeys == 0:
        return "no floor of one map meets a floor of the other"
    if e.free_floor < config.free_floor:
        return (
            f"too little in common: both maps saw {e.free_floor:.1f} m² of the same free floor, "
            f"at least {config.free_floor:g} m² are needed"
        )
    if e.agreed_wall < config.agreed_wall:
        return (
            f"too little in common: both maps saw {e.agreed_wall:.1f} m of wall from the same "
            f"side, at least {config.agreed_wall:g} m are needed"
        )
    along = e.agreed_wall - e.smallest_eigenvalue
    needed = max(config.smallest_eigenvalue, min(_ACROSS_ENOUGH, config.across_share * along))
    held = e.smallest_eigenvalue >= _ACROSS_AT_ALL and e.fixed >= config.slide_cost
    if e.smallest_eigenvalue < needed and not held:
        return (
            "the walls in common all run one way, so the position along them is not fixed: "
            f"{e.smallest_eigenvalue:.1f} m of wall run across, "
            f"at least {needed:.1f} m are needed; sliding along costs {max(0.0, e.fixed):.0%} of "
            f"the score, at least {config.slide_cost:.0%} are needed"
        )
    cells = e.wall_conflict_cells / e.wall_conflict if e.wall_conflict > 0.0 else 0.0
    if _at_least(e.wall_conflict, cells / _WALL_CLUMP) > config.wall_conflict:
        return (
            "the walls of one map stand in the seen-free floor of the other: "
            f"{e.wall_conflict:.1%} of {cells:.0f} wall cells conflict, "
            f"at most {config.wall_conflict:.1%} allowed"
        )
    return None


def _misplaced(e: Evidence, config: VerificationConfig) -> str | None:
    counted = e.furniture_judged >= config.furniture_judged
    if counted and furniture_elsewhere(e) > config.furniture_conflict:
        return (
            "the furniture of one map stands where the other saw bare floor: "
            f"{e.furniture_conflict:.0%} of {e.furniture_judged} furniture cells conflict, "
            f"at most {config.furniture_conflict:.0%} allowed"
        )
    return None


def _at_least(share: float, count: float) -> float:
    """Return the lower bound of a share seen in `count` cases, at 95 % one-sided (Wilson 1927)."""
    if count <= 0.0:
        return 0.0
    z = 1.645
    spread = np.sqrt(share * (1.0 - share) / count + z**2 / (4.0 * count**2))
    return float(max(0.0, (share + z**2 / (2.0 * count) - z * spread) / (1.0 + z**2 / count)))


def furniture_elsewhere(e: Evidence) -> float:
    """Return the share of the furniture that stands elsewhere beyond doubt."""
    return _at_least(e.furniture_conflict, e.furniture_judged / FURNITURE_CLUMP)


def _holds_despite(e: Evidence, gap: float, ratio: float, config: VerificationConfig) -> bool:
    """Whether so much else speaks for a pose that some conflict may pass."""
    floor, wall = max(20.0, config.free_floor), max(10.0, config.agreed_wall)
    across = max(5.0, config.smallest_eigenvalue)
    if e.storeys == 0 or e.free_floor < floor or e.agreed_wall < wall:
        return False
    if e.smallest_eigenvalue < across:
        return False
    rules = (_MOVED, _VOUCHED, _CHANGED) if config.changed_furniture else (_MOVED, _VOUCHED)
    return any(
        e.wall_conflict <= rule.wall_conflict
        and e.furniture_conflict <= rule.furniture_conflict
        and e.furniture_judged >= rule.furniture_judged
        and ratio <= rule.ratio
        and gap >= rule.gap
        for rule in rules
    )
