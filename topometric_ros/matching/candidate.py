"""A candidate pose between two maps, whatever source proposed it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import RoomMatch


@dataclass(frozen=True)
class Candidate:
    """A hypothesis: one transform and, where rooms led to it, the matches that speak for it.

    `T_a_b` (4, 4) float64, m, from the level frame of map b to that of map a; rotation about z
    only. `source` is "rooms" or "search"; `score` orders candidates of one source (higher first).
    """

    T_a_b: NDArray[np.float64]
    source: str
    score: float
    matches: tuple[RoomMatch, ...] = ()
