"""Notices that an agent has moved its whole map: a loop was closed, its old alignments are void."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from topometric_ros.fusion.poses import apply, inverse
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.voxels.grid import lattice_coordinates
from topometric_ros.voxels.morton import morton_encode

MOVED = 0.5
"""Share of a map's cells that must still be there in its next version; a growing map keeps all."""

_CELLS = 2.0
"""Edge in voxels of the cells that are compared: what is rounded otherwise has not moved."""

_LOOKED_AT = 20_000


def still_there(old: TopometricMap, new: TopometricMap) -> float:
    """Return the share of an older map's surface that the newer one has in the same place.

    Both are of one session and so of one input frame.
    """
    if len(old.voxels) == 0:
        return 1.0
    size = _CELLS * max(old.voxel_size, new.voxel_size)
    codes = [
        morton_encode(
            lattice_coordinates(apply(inverse(m.T_level_input), m.surface()), size, np.zeros(3))
        )
        for m in (old, new)
    ]
    looked_at = codes[0][:: max(1, len(codes[0]) // _LOOKED_AT)]
    return float(np.isin(looked_at, codes[1]).mean())


def move_told(agent: str, share: float, by_hand: Sequence[str]) -> str:
    """Say that an agent's map has moved; `by_hand` were aligned with it by an operator."""
    told = f"{agent}: its whole map has moved, {share:.0%} is where it was: aligned anew"
    if by_hand:
        told += f"; what was set by hand with {', '.join(by_hand)} is kept and may no longer hold"
    return told
