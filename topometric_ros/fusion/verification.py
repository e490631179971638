"""Whether a pose may be believed: accepted, ambiguous, rejected or none, with the reason in words.

A wrong merge is worse than none, so a pose is accepted only where enough was seen in common, hardly
anything speaks against it, and no other pose does nearly as well. Everything else is told to the
operator with the number that decided and the threshold that it missed.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from topometric_ros.alignment import AlignmentStatus, Alternative
from topometric_ros.fusion.furniture import Pieces
from topometric_ros.fusion.gates import VerificationConfig, objection
from topometric_ros.fusion.rivals import Judged, difference, disproved_margin, distinct
from topometric_ros.fusion.twins import twin_doubt
from topometric_ros.matching.candidate import Candidate
from topometric_ros.matching.evidence import Evidence

_ALTERNATIVES = 5

_RULES = 33
"""Pairs of a lead and a runner-up's share between the clear and the wide one."""

_CALIBRATED = 1.85
"""Exponent of a margin in the odds of a pose that leads by it."""

LEAST_CONFIDENCE = 0.5
"""A pose is accepted from this confidence on."""

TWIN_TRUST = 0.45
"""Greatest confidence in a pose that an identical flat would have too."""


@dataclass(frozen=True)
class Decision:
    """What became of a pair of maps.

    `best` is the index of the best candidate (None without any), also where it is not accepted;
    `confidence` 0..1, see :func:`confidence`. `alternatives` are up to five distinct poses between
    the level frames with their values, best first, the one at `best` among them.
    """

    status: AlignmentStatus
    reason: str
    best: int | None
    confidence: float = 0.0
    gap: float = 0.0
    ratio: float = 0.0
    alternatives: tuple[Alternative, ...] = ()


def decide(
    judged: Sequence[Judged],
    config: VerificationConfig,
    furniture: Callable[[], Pieces] | None = None,
) -> Decision:
    """Accept the best of some candidates, or say why not.

    Parameters
    ----------
    judged : candidates of any source, each refined (`matching.evidence.refine`) and with its
        evidence, those of `matching.search` always among them: rough copies of the best pose
        would read as rivals of it, and without rivals nothing looks ambiguous
    config : VerificationConfig. `changed_furniture` is off by default. No wrong pose was ever
        accepted with it, but in one building without furniture a look-alike wing reached a value
        of 886 at 2.9 % conflict, and only a second such wing kept it from being accepted.
    furniture : compares that of the best candidate to the centimetre, see `gates.objection`

    Returns
    -------
    Decision
    """
    order = sorted(range(len(judged)), key=lambda k: (-judged[k][1].value, -judged[k][1].score, k))
    if not order:
        return Decision(
            AlignmentStatus.NONE,
            "no pose brings a floor of one map onto a floor of the other",
            None,
        )
    best = order[0]
    reach = (config.same_distance, float(np.radians(config.same_angle)), config.same_height)
    rivals = distinct(judged, order, reach)
    first = judged[best][1]
    second = judged[rivals[1]][1].value if len(rivals) > 1 else 0.0
    gap = first.value - second
    ratio = second / first.value if first.value > 0.0 else 1.0
    alternatives = tuple(
        Alternative(judged[k][0].T_a_b, judged[k][1].value)
        for k in rivals[:_ALTERNATIVES]
        if judged[k][1].value > 0.0
    )

    def decision(status: AlignmentStatus, reason: str, trust: float) -> Decision:
        return Decision(status, reason, best, trust, gap, ratio, alternatives)

    refusal = objection(first, gap, ratio, config, furniture)
    if refusal is not None:
        return decision(AlignmentStatus.REJECTED, refusal, 0.0)
    near = [
        judged[k][1] for k in rivals[1:] if judged[k][1].value > config.clear_ratio * first.value
    ]
    trust = max(confidence(gap, ratio, config), _told_apart(first, near, gap, config))
    if trust < LEAST_CONFIDENCE:
        rival = judged[rivals[1]][0] if len(rivals) > 1 else None
        reason = _why_ambiguous(judged[best], rival, second, gap, ratio, config)
        return decision(AlignmentStatus.AMBIGUOUS, reason, trust)
    doubt = twin_doubt(first, config)
    if doubt is not None:
        return decision(AlignmentStatus.AMBIGUOUS, doubt, min(trust, TWIN_TRUST))
    return decision(AlignmentStatus.ACCEPTED, _why_accepted(first, ratio, near), trust)


def doubt_repeated(
    decision: Decision, evidence: Evidence, share: float, config: VerificationConfig
) -> Decision:
    """Return an accepted decision, ambiguous where the part in common repeats in the maps.

    Parameters
    ----------
    share : how well the part fits elsewhere, see :func:`matching.likeness.likeness`
    """
    if share < config.repeated_share:
        return decision
    reason = (
        f"the {evidence.free_floor:.0f} m² of floor in common look like another part of the maps, "
        f"which fits {share:.0%} as well, at most {config.repeated_share:.0%} allowed: "
        "let the maps share more rooms"
    )
    trust = min(decision.confidence, TWIN_TRUST)
    return replace(decision, status=AlignmentStatus.AMBIGUOUS, reason=reason, confidence=trust)


def confidence(gap: float, ratio: float, config: VerificationConfig) -> float:
    """Return how far the best pose is ahead of the runner-up: 0..1, accepted from 0.5.

    With gap = V1 − V2 and ratio = V2 / V1, m is the largest over the rules of
    min(gap / least gap, greatest ratio / ratio). The rules lead from `clear_*` to `wide_*`: the
    nearer the runner-up, the larger the lead that is asked for. Below 1 the confidence is
    m / (1 + m), from 1 on the odds are 2 m^1.85, as often as such poses were right
    (docs/benchmarks.md).
    """
    ratio = max(ratio, 1e-9)
    rules = zip(
        np.geomspace(max(config.clear_gap, 1e-9), max(config.wide_gap, 1e-9), _RULES),
        np.linspace(config.clear_ratio, config.wide_ratio, _RULES),
        strict=True,
    )
    margin = max(min(gap / least, greatest / ratio) for least, greatest in rules)
    return _as_confidence(2.0 * margin**_CALIBRATED if margin >= 1.0 else margin)


def _as_confidence(margin: float) -> float:
    """Map odds, or a margin that is 1 where a rule is just met, to 0..1."""
    return float(max(0.0, margin) / (1.0 + max(0.0, margin)))


def _told_apart(
    best: Evidence, near: Sequence[Evidence], gap: float, config: VerificationConfig
) -> float:
    """Return the confidence in a pose all of whose near rivals lack walls that they should show."""
    return _as_confidence(min(gap / max(config.clear_gap, 1e-9), disproved_margin(best, near)))


def _why_accepted(e: Evidence, ratio: float, near: Sequence[Evidence]) -> str:
    furniture = f" and {e.furniture_conflict:.0%} of the furniture" if e.furniture_judged else ""
    lacking = ""
    if disproved_margin(e, near) >= 1.0:
        absent = min(rival.wall_absent for rival in near)
        lacking = f" but lacks {absent:.1%} of the walls in view, this one {e.wall_absent:.1%}"
    return (
        f"{e.agreed_wall:.0f} m of wall and {e.free_floor:.0f} m² of free floor agree, "
        f"{e.wall_conflict:.1%} of the walls{furniture} conflict, "
        f"the next best pose reaches {ratio:.0%} of the value{lacking}"
    )


def _why_ambiguous(
    best: Judged,
    rival: Candidate | None,
    second: float,
    gap: float,
    ratio: float,
    config: VerificationConfig,
) -> str:
    candidate, evidence = best
    if rival is None or ratio <= config.clear_ratio:
        return (
            f"the best pose leads by only {gap:.0f}, at least {config.clear_gap:g} are needed: "
            "let the maps share more rooms"
        )
    shift, turn = difference(candidate.T_a_b, rival.T_a_b, evidence.centre)
    lead = np.log(np.clip(gap, config.clear_gap, config.wide_gap) / config.clear_gap)
    allowed = config.clear_ratio + (config.wide_ratio - config.clear_ratio) * lead / np.log(
        config.wide_gap / config.clear_gap
    )
    return (
        f"another pose, {shift:.1f} m and {turn:.0f}° away, fits nearly as well: "
        f"value {second:.0f} against {evidence.value:.0f}, {ratio:.0%} of it, "
        f"at most {allowed:.0%} allowed with a lead of {gap:.0f}"
    )
