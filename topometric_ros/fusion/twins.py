"""Whether two maps that fit may show two identical flats, or one of them.

Flats, wings and storeys are built alike and furnished alike, and the walls of one are no evidence
against the other. What tells them apart is what lies beyond the part in common, and furniture: by
how much of it stands elsewhere, and by whether the rest stands where it stood to the centimetre.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from topometric_ros.fusion.furniture import Pieces
from topometric_ros.fusion.gates import FURNITURE_CLUMP, VerificationConfig, furniture_elsewhere
from topometric_ros.matching.evidence import Evidence

_PART, _PART_DIFFERS = 0.75, 0.6
"""Of `twin_share`: the share of the smaller map's floor from which it is a part of the other, and
where some of the furniture stands elsewhere."""

_ROOM, _ROOM_PART = 15.0, 0.3
"""Floor in common (m²) of a room, and the share of the smaller map's floor from which no more than
that says where it lies: twin flats have rooms that are alike to the furniture. Less of the map in
common is as little where the furniture conflicts, if only by a few cells."""

_HALF, _OTHERWISE = 0.5, 0.02
"""Of `twin_share`, and furniture in conflict beyond doubt, from which as much may be another flat
or floor, furnished otherwise: rooms of one kind are furnished much alike."""

_PARTLY, _STRAINED, _STRAINED_CELLS = 0.45, 0.01, 5
"""Of `twin_share`, walls in conflict and their cells from which as much may be too: cupboards that
stand elsewhere are walls there. Where furniture conflicts as well, the share does not matter."""


def twin_doubt(
    e: Evidence, config: VerificationConfig, furniture: Callable[[], Pieces] | None = None
) -> str | None:
    """Return why two identical flats, furnished alike, would look the same, or None.

    Nothing beyond what is shared tells where the smaller map lies, and not all furniture agrees, or
    little more than a room was seen of it. Where less is shared, more conflicts or a cell or two of
    furniture do not agree, `furniture` is asked how much of it stands in the same place to the
    centimetre; without it none of that counts.
    """
    if _is_part(e, config):
        return (
            f"one map holds {e.free_share:.0%} of the floor of the other, only {e.free_floor:.0f} "
            f"m², at least {_least_floor(e, config):g} m² are needed: a part of an identical flat "
            "would look the same, let the smaller map grow"
        )
    small, differs = e.free_floor < config.twin_floor, _differs(e, config)
    shared = f"one map holds {e.free_share:.0%} of the floor of the other"
    if small and differs and e.free_share >= config.twin_share:
        return (
            f"{shared}, so little else tells where that lies, and {e.furniture_conflict:.1%} of "
            "the furniture stands elsewhere: an identical flat would look the same"
        )
    if furniture is None or (config.changed_furniture and not small):
        return None
    asked = _may_be_furnished_otherwise(e, config)
    if small and e.furniture_conflict_cells > 0:
        asked = asked or e.free_share >= (_PART if differs else 1.0) * config.twin_share
    pieces = furniture()
    if not pieces.displaced and (not asked or pieces.same):
        return None
    placed = (
        f"of {pieces.fixed} pieces that can be placed to the centimetre {pieces.kept} stand where "
        "they stood"
        if pieces.fixed
        else "no piece can be placed to the centimetre"
    )
    return (
        f"{shared}, {e.furniture_conflict:.1%} of the furniture and {e.wall_conflict:.1%} of the "
        f"walls stand elsewhere, and {placed}: an identical flat would look the same"
    )


def _may_be_furnished_otherwise(e: Evidence, config: VerificationConfig) -> bool:
    """Whether more conflicts than the like furniture of another flat or floor would explain."""
    otherwise = furniture_elsewhere(e) >= _OTHERWISE
    strained = e.wall_conflict > _STRAINED and e.wall_conflict_cells >= _STRAINED_CELLS
    if otherwise and strained:
        return True
    least = _HALF if otherwise else _PARTLY if strained else math.inf
    return e.free_share >= least * config.twin_share


def _differs(e: Evidence, config: VerificationConfig) -> bool:
    """Whether any furniture stands elsewhere: more than a cell or two that err together."""
    many = e.furniture_conflict_cells >= FURNITURE_CLUMP
    return many and e.furniture_conflict >= config.twin_furniture


def _is_part(e: Evidence, config: VerificationConfig) -> bool:
    """Whether the smaller map is a small part of the other, or shares one room of a few with it."""
    return e.free_floor < _least_floor(e, config)


def _least_floor(e: Evidence, config: VerificationConfig) -> float:
    """Return the floor (m²) that a part must have in common to be no part of an identical flat."""
    least = _PART_DIFFERS if _differs(e, config) else _PART
    if e.free_share >= least * config.twin_share:
        return config.twin_part
    room = e.free_share >= _ROOM_PART or e.furniture_conflict_cells > 0
    return min(_ROOM, config.twin_part) if room else 0.0
