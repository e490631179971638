"""What kind a room is of, from its shape and what it is joined to: corridor, stairwell, hall, room.

A corridor is narrow for its length and leads to many rooms; stairs lead out of a stairwell, which
is no corridor. The weights were set by hand on the labelled rooms of nine buildings; a learned
classifier with the same signature can take this function's place.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_LARGE, _WIDE = 50.0, 4.0
"""A hall is larger (m²) and wider (m) than these."""
_MOST_NEIGHBOURS = 6
"""More neighbours than this say no more."""
_STAIRWELL = 0.6
"""How sure it is that a room without the shape of a corridor, from which stairs lead, is built
for them: on the labelled rooms five of eight were."""
_STAIRWELL_WIDTH = 3.0
"""m: a room with stairs that is wider than this is no corridor, whatever it leads to."""


def typical_width(floor: NDArray[np.bool_], cell: float) -> float:
    """Return four times the mean distance to the rim, m: about the width of a long strip.

    Parameters
    ----------
    floor : (nx, ny), cells of `cell` m
    """
    inside = np.pad(floor, 1)
    if not inside.any():
        return 0.0
    return float(4.0 * np.asarray(ndimage.distance_transform_edt(inside))[inside].mean() * cell)


def room_kind(area: float, width: float, neighbours: int, stairs: int) -> tuple[str, float]:
    """Return a room's kind and how sure that is, 0 to 1.

    Parameters
    ----------
    area : of the floor, m²
    width : typical width, m
    neighbours : how many rooms passages lead to
    stairs : how many passages of kind `stairs` lead out of it

    Examples
    --------
    >>> room_kind(area=30.0, width=1.9, neighbours=8, stairs=0)[0]
    'corridor'
    >>> room_kind(area=14.0, width=2.2, neighbours=1, stairs=0)[0]
    'room'
    """
    if area <= 0.0 or width <= 0.0:
        return "unknown", 0.0
    score = (
        1.5 * math.log(area / width**2 / 3.2)
        + 1.2 * (min(neighbours, _MOST_NEIGHBOURS) - 2)
        - 1.5 * (max(width, 1.5) - 2.2)
        - 0.3
    )
    corridor = 1.0 / (1.0 + math.exp(-score))
    if corridor >= 0.5 and not (stairs and width >= _STAIRWELL_WIDTH):
        return "corridor", corridor
    if stairs:
        return "stairwell", _STAIRWELL
    if area >= _LARGE and width >= _WIDE:
        return "hall", 1.0 - corridor
    return "room", 1.0 - corridor
