"""How far a transform is from the true one, how often that is unnoticed, and what it costs to send.

The error of a transform is the mean displacement of the second agent's points, never the difference
of translations: read at the frame's origin, that multiplies errors of the yaw by the distance to
it. The nearest-neighbour distance, which published figures use, is kinder: a cloud shifted along
its own walls loses little.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import betaincinv

from topometric_ros.fusion.poses import angle, apart, apply, inverse
from topometric_ros.io.bag_messages import MAP_TYPE, message_classes, typestore
from topometric_ros.runtime.message_codec import map_to_message
from topometric_ros.topometric_map import TopometricMap

RIGHT = (0.5, 5.0)
"""A transform is right below this displacement (m) and angle (degrees)."""
STRICTLY_RIGHT = (0.1, 1.0)
"""The same for strict success."""
NO_OVERLAP, LITTLE_OVERLAP = 0.02, 0.10
"""Below the first a pair must not be merged; below the second it need not be."""
RAW_POINT_BYTES = 12
"""A point of a raw cloud: x, y and z as float32."""
_CONFIDENCE = 0.95


@dataclass(frozen=True)
class TransformError:
    """A transform against the true one: degrees, m, m."""

    angle: float
    displacement: float
    nearest: float

    def within(self, limits: tuple[float, float]) -> bool:
        """Return whether displacement (m) and angle (degrees) are below the limits."""
        return self.displacement < limits[0] and self.angle < limits[1]


@dataclass(frozen=True)
class ReliabilityBin:
    """Forecasts between two confidences: how many, their mean, and the share that came true."""

    low: float
    high: float
    count: int
    confidence: float
    right: float


def transform_error(
    T_found: NDArray[np.float64],
    T_true: NDArray[np.float64],
    points: NDArray[np.float64],
    tree: cKDTree | None = None,
) -> TransformError:
    """Compare a transform with the true one on the points that it moves.

    Parameters
    ----------
    T_found, T_true : (4, 4) float64, m, T_a_b
    points : (N, 3) float64, m, what agent b saw, in its frame
    tree : of all of b's points, or None: made of `points`
    """
    tree = cKDTree(points) if tree is None else tree
    # Where the found transform puts a point, seen from the truly placed cloud's own frame.
    nearest, _ = tree.query(apply(inverse(T_true) @ T_found, points))
    return TransformError(
        angle=float(np.degrees(angle(inverse(T_true) @ T_found))),
        displacement=apart(T_found, T_true, points),
        nearest=float(nearest.mean()),
    )


def upper_bound(events: int, trials: int, confidence: float = _CONFIDENCE) -> float:
    """Return the one-sided upper bound of a rate (Clopper & Pearson 1934); 1 without trials.

    With no event it is close to the rule of three, 3 / trials.

    Examples
    --------
    >>> round(upper_bound(0, 100), 4)
    0.0295
    """
    if trials == 0 or events >= trials:
        return 1.0
    return float(betaincinv(events + 1, trials - events, confidence))


def brier_score(confidences: Sequence[float], right: Sequence[bool]) -> float:
    """Return the mean squared difference of forecast and outcome (Brier 1950); NaN without any."""
    if not len(confidences):
        return float("nan")
    return float(np.mean((np.asarray(confidences, float) - np.asarray(right, float)) ** 2))


def reliability(
    confidences: Sequence[float], right: Sequence[bool], bins: int = 10
) -> list[ReliabilityBin]:
    """Return the filled bins of the reliability diagram, lowest first.

    A forecast that is right as often as it says has `right` near `confidence` in every bin.
    """
    forecast, outcome = np.asarray(confidences, float), np.asarray(right, float)
    place = np.clip((forecast * bins).astype(int), 0, bins - 1)
    return [
        ReliabilityBin(
            k / bins,
            (k + 1) / bins,
            int((place == k).sum()),
            float(forecast[place == k].mean()),
            float(outcome[place == k].mean()),
        )
        for k in np.unique(place).tolist()
    ]


def bytes_on_the_wire(m: TopometricMap) -> int:
    """Return the size of the map's message as it is sent (CDR), in bytes."""
    message = map_to_message(m, message_classes())
    return len(typestore().serialize_cdr(message, MAP_TYPE))
