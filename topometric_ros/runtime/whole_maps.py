"""Notices single scans that are taken for whole maps, as where /tf_static was not recorded.

A cloud whose frame is not on /tf counts as the whole map so far and replaces the one before. Maps
that grow keep what they held; of scans from a moving sensor the last one alone would be extracted.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

_KEPT = 0.75
"""Share of the first cloud's points that the last one must still have: scans 0.4 to 0.7, maps 1."""

_CELL = 0.5
"""Edge of the cells that are compared, m: what a closed loop moves by less has not gone."""

_LOOKED_AT = 10_000
_PRIMES = np.array([73_856_093, 19_349_663, 83_492_791])
"""Teschner et al. 2003: cells by one number, which serves far from the origin too."""


class WholeMaps:
    """The first and the last of the clouds of one frame that were taken for whole maps."""

    def __init__(self) -> None:
        self.frame_id = ""
        self._first: NDArray[np.float64] | None = None
        self._last: NDArray[np.float64] | None = None

    def add(self, points: NDArray[np.float64], frame_id: str) -> None:
        """Take a cloud (N, 3) float64, m, in `frame_id`; another frame begins anew."""
        if frame_id != self.frame_id or self._first is None:
            self.frame_id, self._last = frame_id, None
            self._first = points[:: max(1, len(points) // _LOOKED_AT)].copy()
        else:
            self._last = points

    def doubt(self) -> str:
        """Return what speaks against whole maps in a sentence, or an empty text."""
        if self._first is None or self._last is None:
            return ""
        kept = float(np.isin(_cells(self._first), _cells(self._last)).mean())
        if kept >= _KEPT:
            return ""
        return (
            f"clouds in frame {self.frame_id} were taken for whole maps, of which the last counts, "
            f"but it holds {kept:.0%} of the first: if they are single scans, /tf or /tf_static "
            f"lacks {self.frame_id}"
        )


def _cells(points: NDArray[np.float64]) -> NDArray[np.int64]:
    """Return a number (N,) for the cell of each point."""
    cells = np.floor(points / _CELL).astype(np.int64)
    return np.asarray(np.bitwise_xor.reduce(cells * _PRIMES, axis=1))
