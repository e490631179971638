"""What every method that aligns two clouds is to the benchmark: a name and one function."""

from __future__ import annotations

import importlib
from dataclasses import dataclass
from types import ModuleType
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError

EXTRA = 'pip install -e ".[benchmark]"'


class PeerError(TopometricError):
    """A method that is not known or not installed."""


@dataclass(frozen=True)
class PeerResult:
    """The best pose that a method found and whether its own rule accepts it.

    `T_a_b` (4, 4) float64, m, or None where it proposes no pose at all; `score` is the number that
    its rule reads, in the method's own unit.
    """

    T_a_b: NDArray[np.float64] | None
    accepted: bool
    score: float


class Peer(Protocol):
    """A method that finds the pose of one gravity-aligned cloud in another."""

    name: str

    def align(self, points_a: NDArray[np.float64], points_b: NDArray[np.float64]) -> PeerResult:
        """Return the pose of b in a; both (N, 3) float64, m, z up, each in its own frame."""
        ...


def require(module: str, peer: str, wheel: str, note: str = "") -> ModuleType:
    """Import the library of a peer.

    Raises
    ------
    PeerError
        It is not installed; says in one line what to install.
    """
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise PeerError(
            f"peer {peer} needs the wheel {wheel}, which is not installed: {EXTRA}{note}"
        ) from error


def thinned(points: NDArray[np.float64], size: float) -> NDArray[np.float64]:
    """Return the mean point of every occupied cube of edge `size`, m: (M, 3) float64."""
    keys = np.floor((points - points.min(axis=0)) / size).astype(np.int64)
    spans = keys.max(axis=0) + 1
    flat = (keys[:, 0] * spans[1] + keys[:, 1]) * spans[2] + keys[:, 2]
    _, cell, counts = np.unique(flat, return_inverse=True, return_counts=True)
    sums = [np.bincount(cell, weights=points[:, k]) for k in range(3)]
    return np.stack(sums, axis=1) / counts[:, None]
