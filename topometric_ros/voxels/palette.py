"""Colours of rooms and agents: told apart by colour-blind eyes, the same for the same id always.

The nine hues are Paul Tol's *muted* scheme; ids beyond nine repeat them lighter, then darker.
References: P. Tol, "Colour schemes", SRON technical note SRON/EPS/TN/09-002, 2021.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

_MUTED = np.array(
    [
        *((0x44, 0xAA, 0x99), (0xDD, 0xCC, 0x77), (0x88, 0xCC, 0xEE), (0xCC, 0x66, 0x77)),
        *((0x11, 0x77, 0x33), (0xAA, 0x44, 0x99), (0x99, 0x99, 0x33), (0x33, 0x22, 0x88)),
        (0x88, 0x22, 0x55),
    ],
    dtype=np.float64,
)
_TURNS = ((0.0, 0.0), (0.45, 255.0), (0.35, 0.0))
"""How far each turn through the hues is mixed, and with what: nothing, white, black."""

NO_ROOM_COLOUR = (0xB8, 0xB8, 0xB8)
"""Voxels that belong to no room."""

_AGENTS = np.array(
    [
        *((0x00, 0x77, 0xBB), (0xEE, 0x99, 0x11), (0x00, 0x99, 0x88), (0xAA, 0x33, 0x77)),
        *((0x66, 0xBB, 0xEE), (0x99, 0x77, 0x33)),
    ],
    dtype=np.uint8,
)


def room_colours(rooms: ArrayLike) -> NDArray[np.uint8]:
    """Return the colour of each room id; ids below zero (no room) are grey.

    Parameters
    ----------
    rooms : (N,) integers

    Returns
    -------
    (N, 3) uint8, red green blue

    Examples
    --------
    >>> room_colours([0, -1]).tolist()
    [[68, 170, 153], [184, 184, 184]]
    """
    ids = np.asarray(rooms, dtype=np.int64).reshape(-1)
    amount, target = np.array(_TURNS)[ids // len(_MUTED) % len(_TURNS)].T[:, :, None]
    # Each turn starts at another hue, so that neighbouring ids nine apart differ in hue too.
    hue = (ids + 4 * (ids // len(_MUTED))) % len(_MUTED)
    colours = _MUTED[hue] * (1 - amount) + target * amount
    colours[ids < 0] = NO_ROOM_COLOUR
    return np.round(colours).astype(np.uint8)


def agent_colour(index: int) -> tuple[int, int, int]:
    """Return the colour of the index-th agent of a result; six, then they repeat.

    Examples
    --------
    >>> agent_colour(0) == agent_colour(6)
    True
    """
    red, green, blue = _AGENTS[index % len(_AGENTS)].tolist()
    return red, green, blue
