"""From coarse poses to fine ones: a grid round each that shrinks while fewer poses stay."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.matching.search_fields import MapFields, ScoringConfig, candidate_heights
from topometric_ros.matching.search_poses import (
    Comparison,
    Pose,
    common_centre,
    compare,
    same_pose,
    score_around,
)

DISTINCT = (0.6, float(np.radians(6.0)), 0.3)
"""Poses that differ by less than this (m on the plan, rad, m in height) are one."""


@dataclass(frozen=True)
class RefineConfig:
    """How many poses are refined, and on how many cells."""

    coarse_samples: int = parameter(
        800, "Wall and free cells that the first pass looks at.", minimum=200, maximum=1_000_000
    )
    second_samples: int = parameter(
        2500, "Wall and free cells that the second pass looks at.", minimum=200, maximum=1_000_000
    )
    fine_samples: int = parameter(
        6000, "Wall and free cells that the later passes look at.", minimum=200, maximum=1_000_000
    )
    keep_coarse: int = parameter(25, "Poses kept after the first pass.", minimum=1, maximum=1000)
    keep: int = parameter(12, "Distinct poses kept in the end.", minimum=2, maximum=100)


@dataclass(frozen=True)
class _Pass:
    """A grid round a pose: half-range and step of the turns (degrees) and of the shifts (m)."""

    turn: tuple[float, float]
    shift: tuple[float, float]
    conflict_weight: float | None = None
    """Milder than the score's own while poses are still rough; None: as configured."""

    def turns(self) -> NDArray[np.float64]:
        """Return the turns to try: (k,) rad, the middle one 0."""
        return _grid(*self.turn) * (np.pi / 180.0)

    def shifts(self) -> NDArray[np.float64]:
        """Return the shifts to try along x and along y: (k,) m, the middle one 0."""
        return _grid(*self.shift)


_WIDE = _Pass((6.0, 1.5), (1.2, 0.2), conflict_weight=2.0)
_FIRST = _Pass((1.5, 0.75), (0.3, 0.1), conflict_weight=2.0)
_SECOND = _Pass((1.2, 0.3), (0.2, 0.1), conflict_weight=2.0)
_LAST = (_Pass((0.45, 0.15), (0.1, 0.05)), _Pass((0.3, 0.1), (0.06, 0.03)))
_EXACT = _Pass((0.1, 0.1), (0.03, 0.03))

_WIDE_SAMPLES = 600
"""Wall and free cells that are looked at while a pose may still be a metre off."""


def _grid(half: float, step: float) -> NDArray[np.float64]:
    n = round(half / step)
    return np.arange(-n, n + 1, dtype=np.float64) * step


@dataclass
class _Views:
    """The comparisons of two maps by height and number of samples, made once."""

    a: MapFields
    b: MapFields
    made: dict[tuple[float, int | None], Comparison] = field(default_factory=dict)

    def at(self, height: float, samples: int | None) -> Comparison:
        key = (height, samples)
        if key not in self.made:
            self.made[key] = compare(self.a, self.b, height, samples)
        return self.made[key]


def refine_poses(
    a: MapFields, b: MapFields, poses: list[Pose], scoring: ScoringConfig, config: RefineConfig
) -> list[Pose]:
    """Return the distinct poses that the given ones lead to, with their S, best first.

    Parameters
    ----------
    poses : rough poses, within about 3° and 0.5 m of what they mean
    """
    views = _Views(a, b)
    rough = [_improved(views, p, (_FIRST,), scoring, config.coarse_samples) for p in poses]
    kept = distinct(views, rough, config.keep_coarse)
    better = [_improved(views, p, (_SECOND,), scoring, config.second_samples) for p in kept]
    kept = distinct(views, better, config.keep)
    fine = [_improved(views, p, _LAST, scoring, config.fine_samples) for p in kept]
    exact = [_improved(views, p, (_EXACT,), scoring, None) for p in fine]
    return distinct(views, exact, config.keep)


def refine_pose(
    a: MapFields, b: MapFields, pose: Pose, scoring: ScoringConfig, config: RefineConfig
) -> Pose:
    """Return the best pose in the basin of one, with its S."""
    views = _Views(a, b)
    passes = (_FIRST, _SECOND, *_LAST)
    fine = _improved(views, pose, passes, scoring, config.fine_samples)
    return _improved(views, fine, (_EXACT,), scoring, None)


def fit_nearby(
    a: MapFields,
    b: MapFields,
    poses: list[Pose],
    found: list[Pose],
    scoring: ScoringConfig,
    config: RefineConfig,
) -> list[Pose | None]:
    """Return where very rough poses fit best nearby, and None for all but the best distinct ones.

    Parameters
    ----------
    poses : within about 7° and 1.5 m of what they mean, as rooms' centroids and doors tell; their
        heights become the nearest difference of floors
    found : refined poses, not refined once more where one of `poses` leads to them
    config : `second_samples`, `fine_samples` and `keep` are used
    """
    views = _Views(a, b)
    heights = np.array(candidate_heights(a, b))
    if len(heights) == 0:
        return [None] * len(poses)
    on_floors = [replace(p, height=float(heights[abs(heights - p.height).argmin()])) for p in poses]
    near = [_improved(views, p, (_WIDE, _FIRST), scoring, _WIDE_SAMPLES) for p in on_floors]
    kept = distinct(views, near, config.keep)
    fitted: list[Pose | None] = []
    for pose in near:
        if not any(pose is other for other in kept):
            fitted.append(None)
            continue
        centre = common_centre(views.at(pose.height, _WIDE_SAMPLES), pose)
        same = [p for p in found if same_pose(p, pose, centre, DISTINCT)]
        if not same:
            better = _improved(views, pose, (_SECOND,), scoring, config.second_samples)
            fine = _improved(views, better, _LAST, scoring, config.fine_samples)
            same = [_improved(views, fine, (_EXACT,), scoring, None)]
        fitted.append(same[0])
    return fitted


def _improved(
    views: _Views,
    pose: Pose,
    passes: tuple[_Pass, ...],
    scoring: ScoringConfig,
    samples: int | None,
) -> Pose:
    """Take the best of each pass's grid in turn; its score is S of as many cells."""
    comparison = views.at(pose.height, samples)
    for step in passes:
        conflict = scoring.conflict_weight
        if step.conflict_weight is not None:
            conflict = min(conflict, step.conflict_weight)
        weights = (conflict, scoring.free_weight)
        centre = common_centre(comparison, pose)
        turns, shifts = step.turns(), step.shifts()
        scores = score_around(comparison, pose, centre, turns, shifts, weights)
        k, i, j = np.unravel_index(int(scores.argmax()), scores.shape)
        target = pose.moved(centre) + (shifts[i], shifts[j])
        turned = Pose(pose.yaw + float(turns[k]), 0.0, 0.0, pose.height, float(scores[k, i, j]))
        x, y = target - turned.moved(centre)
        pose = replace(turned, x=float(x), y=float(y))
    return pose


def distinct(views: _Views, poses: list[Pose], keep: int) -> list[Pose]:
    """Return the best of each bunch of poses that are one, best first, at most `keep`."""
    result: list[tuple[Pose, NDArray[np.float64]]] = []
    order = sorted(poses, key=lambda p: (-p.score, p.height, p.yaw, p.x, p.y))
    for pose in order:
        if all(not same_pose(better, pose, centre, DISTINCT) for better, centre in result):
            comparison = views.at(pose.height, 3000)
            result.append((pose, common_centre(comparison, pose)))
        if len(result) == keep:
            break
    return [pose for pose, _ in result]
