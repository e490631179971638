"""What an operator has said of pairs of agents: a transform that holds, or that there is none.

A transform is of the maps' frames, so it ends with the session of either agent. What was taken back
stays so, also for maps that come later: a false merge costs more than one that is missing.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Mapping

import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import TOLD_BASIS, Alignment, AlignmentStatus, Basis
from topometric_ros.runtime.transforms import TransformError, check_rigid

Pair = tuple[str, str]

_ROUNDING = 1e-9
"""How unsymmetric a covariance may be, as a share of its largest entry."""


def covariance_of(sigma: float, turn_sigma: float) -> NDArray[np.float64]:
    """Return a covariance (6, 6) from standard deviations: of each axis (m), of each turn (rad)."""
    return np.diag([sigma] * 3 + [turn_sigma] * 3) ** 2


class CovarianceError(TransformError):
    """Numbers that are no covariance of a transform."""


class ByHand:
    """The transforms that were set by hand, and the pairs whose alignment was taken back."""

    def __init__(
        self, fixed: Mapping[Pair, Alignment] | None = None, removed: Iterable[Pair] = ()
    ) -> None:
        self.fixed = dict(fixed or {})
        self._removed = {_unordered(*pair) for pair in removed}

    @property
    def removed(self) -> tuple[Pair, ...]:
        """The pairs that are not to be aligned with each other, in order."""
        return tuple(sorted(self._removed))

    def fixes(self, a: str, b: str) -> bool:
        """Whether a transform was set."""
        return (a, b) in self.fixed or (b, a) in self.fixed

    def forbids(self, a: str, b: str) -> bool:
        """Whether the two are not to be aligned with each other."""
        return _unordered(a, b) in self._removed

    def set(
        self,
        a: str,
        b: str,
        T_a_b: NDArray[np.float64],
        covariance: NDArray[np.float64] | None = None,
    ) -> None:
        """Fix a transform in the place of whatever was said of the pair before.

        Raises
        ------
        TransformError
            `T_a_b` is no rigid motion.
        CovarianceError
            `covariance`, (6, 6) as that of an alignment, can be none. With one the pose graph
            weighs the transform by it, without the transform holds as it is.
        """
        T_a_b = np.asarray(T_a_b, np.float64)
        check_rigid(T_a_b, f"alignment of {a} and {b}")
        if covariance is not None:
            covariance = np.asarray(covariance, np.float64)
            _check_covariance(covariance, f"alignment of {a} and {b}")
        self.allow(a, b)
        self.fixed[a, b] = Alignment(
            agents=(a, b),
            status=AlignmentStatus.ACCEPTED,
            reason=_told("set"),
            T_a_b=T_a_b,
            confidence=1.0,
            covariance=covariance,
            basis=Basis.OPERATOR,
        )

    def remove(self, a: str, b: str) -> bool:
        """Take back the transform that was set, else what the maps say now and later on.

        False where the latter was done before.
        """
        if self.fixes(a, b):
            return self.allow(a, b)
        if self.forbids(a, b):
            return False
        self._removed.add(_unordered(a, b))
        return True

    def allow(self, a: str, b: str) -> bool:
        """Let the maps decide again; False where nothing was said of the pair."""
        known = self.fixes(a, b) or self.forbids(a, b)
        for pair in ((a, b), (b, a)):
            self.fixed.pop(pair, None)
        self._removed.discard(_unordered(a, b))
        return known

    def with_covariance(
        self, alignments: Iterable[Alignment], default: NDArray[np.float64]
    ) -> tuple[Alignment, ...]:
        """Return alignments with the default covariance where one was set by hand without any."""
        return tuple(
            dataclasses.replace(x, covariance=default)
            if x.covariance is None and x.T_a_b is not None and self.fixes(*x.agents)
            else x
            for x in alignments
        )

    def end_session(self, agent: str) -> None:
        """Drop the transforms of an agent whose frame is another one now."""
        self.fixed = {pair: x for pair, x in self.fixed.items() if agent not in pair}


def taken_back(a: str, b: str) -> Alignment:
    """Return what is told of a pair that is not to be aligned."""
    reason = _told("removed")
    return Alignment((a, b), AlignmentStatus.WITHDRAWN, reason, basis=Basis.OPERATOR)


def _told(what: str) -> str:
    return f"{what} {TOLD_BASIS[Basis.OPERATOR]}"


def _unordered(a: str, b: str) -> Pair:
    return (a, b) if a < b else (b, a)


def _check_covariance(covariance: NDArray[np.float64], what: str) -> None:
    if covariance.shape != (6, 6) or not np.isfinite(covariance).all():
        raise CovarianceError(f"{what}: covariance: expected 6x6 finite numbers")
    off = np.abs(covariance - covariance.T).max()
    if off > _ROUNDING * np.abs(covariance).max():
        raise CovarianceError(f"{what}: covariance: not symmetric (off by {off:.2g})")
    least = float(np.linalg.eigvalsh(covariance).min())
    if least <= 0.0:
        raise CovarianceError(f"{what}: covariance: its least eigenvalue is {least:.2g}, not > 0")
