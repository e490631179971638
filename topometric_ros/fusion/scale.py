"""Whether two maps are of one scale: clouds in feet or millimetres, sensors that measure long.

Two looks. Storeys and doors are of much the same height everywhere, so maps whose heights differ by
a unit's factor are told apart before anything fits. And where two maps do fit, how the distances
between walls differ tells a scale to a few tenths of a per cent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import cKDTree

from topometric_ros.extraction.quality import USE_SCALE
from topometric_ros.fusion.icp import UP, gates_of, jacobian, pairs_of, shared_part
from topometric_ros.fusion.poses import Transform, apply, turned
from topometric_ros.fusion.registration_config import RegistrationConfig, RegistrationError
from topometric_ros.fusion.surface import Surface
from topometric_ros.topometric_map import TopometricMap

_UNITS = {"feet": 0.3048, "inches": 0.0254, "centimetres": 0.01, "millimetres": 0.001}
"""Length in m of what clouds come in."""

_NEAR_UNIT = 1.35
"""Factor by which heights of like storeys differ from building to building."""

_OF_UNIT = 1.59
"""Factor by which heights may miss a unit's: half way from inches to centimetres."""

_UNLIKE = 1.6
"""Factor between the heights of two maps' storeys from which their scales may differ."""

_POINTS = 2000
"""Points that are enough to measure a scale with."""


@dataclass(frozen=True)
class Heights:
    """What tells a map's scale, m: the median height of its storeys and of its doors, or None."""

    storey: float | None
    door: float | None


def heights(m: TopometricMap) -> Heights:
    """Return how high a map's storeys and doors are."""
    storeys = [s.ceiling_z - s.floor_z for s in m.storeys if s.ceiling_z is not None]
    doors = [p.height for p in m.passages if p.height is not None and p.kind == "door"]
    return Heights(
        float(np.median(storeys)) if storeys else None, float(np.median(doors)) if doors else None
    )


def unlike_scale(a: TopometricMap, b: TopometricMap) -> str | None:
    """Return in words why two maps seem to be of unlike scale, or None.

    Storeys must differ by a factor; where both maps have doors these must say the same, for a hall
    beside an office differs in storeys and not in doors. What an extraction was warned of counts
    too: it saw more of the cloud than the map keeps.
    """
    return _by_heights(a, b) or _warned(a, b)


def _warned(a: TopometricMap, b: TopometricMap) -> str | None:
    """Return what was told of the scale when one of the maps was made, and not of the other."""
    told = [next((w for w in m.warnings if USE_SCALE in w), None) for m in (a, b)]
    odd = [(m, w) for m, w in zip((a, b), told, strict=True) if w is not None]
    return f"{odd[0][0].agent}: {odd[0][1]}" if len(odd) == 1 else None


def _by_heights(a: TopometricMap, b: TopometricMap) -> str | None:
    first, second = heights(a), heights(b)
    if first.storey is None or second.storey is None:
        return None
    ratio = second.storey / first.storey
    if max(ratio, 1 / ratio) < _UNLIKE:
        return None
    told = f"the storeys of {b.agent} are {ratio:.2g} times as high as those of {a.agent}"
    told += f" ({second.storey:.2g} and {first.storey:.2g} m)"
    if first.door is not None and second.door is not None:
        doors = second.door / first.door
        if not 1 / _NEAR_UNIT < doors / ratio < _NEAR_UNIT:
            return None
        told += f", their doors {doors:.2g} times"
    odd, factor = (b, ratio) if ratio > 1 else (a, 1 / ratio)
    unit = next((u for u, m in _UNITS.items() if 1 / _OF_UNIT < factor * m < _OF_UNIT), None)
    if unit is None:
        return f"{told}: the maps seem to be of unlike scale; see --scale"
    return (
        f"{told}: {odd.agent} seems to be in {unit}; {USE_SCALE} {_UNITS[unit]:g} for it if it is"
    )


def stretch(
    source: Surface, target: Surface, T: Transform, config: RegistrationConfig, tree: cKDTree
) -> tuple[float, float]:
    """Return by what factor the target is larger than the source, and how sure that is.

    ICP from a pose that fits, with the size as one more unknown.

    Parameters
    ----------
    source, target : Surface, level frames
    T : (4, 4) float64, T_target_source
    config : RegistrationConfig
    tree : of the target's points

    Returns
    -------
    factor, standard deviation : a sensor that measures 2 % long gives its map 0.98

    Raises
    ------
    RegistrationError
        The surfaces share too little.
    """
    config = replace(config, points=min(config.points, _POINTS))
    gates = gates_of(config, max(source.spacing, target.spacing))
    source = shared_part(source, tree, T, gates[0], config)
    middle = source.points.mean(axis=0)
    log_factor, spread = 0.0, np.inf
    for gate in gates:
        for _ in range(config.steps):
            points = middle + np.exp(log_factor) * (source.points - middle)
            stretched = Surface(points, source.normals, source.sided, source.spacing)
            pairs = pairs_of(stretched, target, tree, T, gate, config)
            if len(pairs.residuals) < config.smallest_pairs:
                raise RegistrationError(f"only {len(pairs.residuals)} pairs of points are left")
            there = apply(T, middle[None])[0]
            arms = pairs.moved - there
            J = np.column_stack(
                [jacobian(pairs.normals, arms, UP), np.sum(pairs.normals * arms, axis=1)]
            )
            H = J.T @ (pairs.weights[:, None] * J)
            H += 1e-6 * np.trace(H) / len(H) * np.eye(len(H))
            update = -np.linalg.solve(H, J.T @ (pairs.weights * pairs.residuals))
            turn = turned(np.array([0.0, 0.0, update[0]]))
            turn[:3, 3] = there + update[1:4] - turn[:3, :3] @ there
            T, log_factor = turn @ T, log_factor + float(update[4])
            together = max(1.0, config.correlated_area / target.spacing**2)
            variance = max(float(np.mean(pairs.residuals**2)), (0.1 * target.spacing) ** 2)
            spread = float(np.sqrt(np.linalg.inv(H)[4, 4] * variance * together))
            if np.abs(update).max() < 1e-4:
                break
    return float(np.exp(log_factor)), spread
