"""What is known beforehand of how frames lie to each other: rough starts, markers, GNSS, old maps.

A prior is one line of YAML in the parameter `priors`:

    {between: [alice, bob], position: [12.0, 3.0, 0.0], yaw: 90, sigma: 1.5, yaw_sigma: 15}
    {agent: alice, in: site, position: [0, 0, 0], yaw: 0, sigma: 0.3, yaw_sigma: 2, name: marker 7}
    {between: [alice, monday], T: [1, 0, 0, 4, ...], covariance: [...], alone: true}

The first tells T_alice_bob, b's origin and heading in a's frame; the second where an agent's frame
lies in an outer one, and two agents with the same outer frame have a prior between them. A pose
outside of what a prior allows is no rival and is never accepted; where the maps speak clearly for
such a pose, both are told and nothing is merged. With `alone` the prior holds where the maps share
too little to be aligned.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import ConfigurationError
from topometric_ros.fusion.poses import Transform, angle, carried, inverse, yaw_of, yaw_pose
from topometric_ros.yaml_text import load_yaml

_ALLOWED = 18.47
"""Squared distance in standard deviations that a right pose exceeds once in 1,000 (4 unknowns)."""

_OF_MAPS = np.diag([0.05, 0.05, 0.05, np.radians(0.5)]) ** 2
"""What an alignment may be off itself, m and rad, added to every prior."""

_FREE = (0, 1, 2, 5)
"""x, y, z and yaw: tilts are taken from gravity."""

_KEYS = ("between", "agent", "in", "position", "yaw", "T", "sigma", "yaw_sigma", "covariance",
         "alone", "name")  # fmt: skip


@dataclass(frozen=True)
class Prior:
    """A transform that is known beforehand, and how well.

    `T` (4, 4) float64, m, is T_target_source; `covariance` (6, 6) over (x, y, z, roll, pitch, yaw)
    in m and rad as that of an alignment; `alone` says that it holds where the maps tell nothing.
    `agents` are those of the two frames that were said to be agents' own.
    """

    target: str
    source: str
    T: Transform
    covariance: NDArray[np.float64]
    alone: bool = False
    name: str = "prior"
    agents: tuple[str, ...] = ()

    def allows(self, T: Transform) -> bool:
        """Whether a transform of the same two frames may be the right one, by this prior."""
        off = np.array([*(T[:3, 3] - self.T[:3, 3]), yaw_of(inverse(self.T) @ T)])
        spread = self.covariance[np.ix_(_FREE, _FREE)] + _OF_MAPS
        return bool(off @ np.linalg.solve(spread, off) <= _ALLOWED)

    def told(self, T: Transform) -> str:
        """Return in words how far a transform is from what the prior says."""
        metres = float(np.linalg.norm(T[:3, 3] - self.T[:3, 3]))
        sigma = float(np.sqrt(np.trace(self.covariance[:3, :3]) / 3.0))
        turn = float(np.degrees(angle(inverse(self.T) @ T)))
        by = float(np.degrees(np.sqrt(self.covariance[5, 5])))
        return (
            f"{metres:.2f} m and {turn:.1f}° from the {self.name} (standard deviations "
            f"{sigma:.2g} m and {by:.2g}°)"
        )


def parse_priors(texts: Sequence[str]) -> tuple[Prior, ...]:
    """Return the priors that the parameter's lines tell.

    Raises
    ------
    ConfigurationError
        A line is no YAML mapping, or lacks or misspells something.
    """
    return tuple(_parsed(text) for text in texts)


def prior_between(priors: Sequence[Prior], a: str, b: str) -> Prior | None:
    """Return the tightest prior of T_a_b, told directly or by a common outer frame, or None."""
    found = [p for p in priors if (p.target, p.source) == (a, b)]
    found += [reversed_prior(p) for p in priors if (p.target, p.source) == (b, a)]
    found += [
        _through(p, q)
        for p in priors
        for q in priors
        if (p.source, q.source) == (a, b) and p.target == q.target
    ]
    return min(found, key=lambda p: float(np.trace(p.covariance[:3, :3])), default=None)


def pointless(priors: Sequence[Prior], agents: Sequence[str]) -> Iterator[tuple[int, str]]:
    """Yield which priors tell nothing of `agents`, as where one is misspelt, and why in words."""
    known = ", ".join(agents)
    for index, prior in enumerate(priors):
        strange = [name for name in prior.agents if name not in agents]
        if strange:
            yield index, f"the {prior.name} names {' and '.join(strange)}; agents are {known}"
        elif prior.target not in agents and [p.target for p in priors].count(prior.target) == 1:
            told = f"the {prior.name} tells nothing: no other agent has one in {prior.target}"
            yield index, told


def reversed_prior(prior: Prior) -> Prior:
    """Return the prior of the same two frames in the other order."""
    return Prior(
        prior.source,
        prior.target,
        inverse(prior.T),
        carried(prior.covariance, -prior.T[:3, :3].T, -prior.T[:3, 3]),
        prior.alone,
        prior.name,
    )


def contradicted(priors: Sequence[Prior], placed: Mapping[str, Transform]) -> Iterator[str]:
    """Yield in words which priors the places of one group's agents contradict.

    Parameters
    ----------
    placed : T_group_agent (4, 4) of each agent of the group
    """
    agents = list(placed)
    for i, a in enumerate(agents):
        for b in agents[i + 1 :]:
            prior = prior_between(priors, a, b)
            T = inverse(placed[a]) @ placed[b]
            if prior is not None and not prior.allows(T):
                yield f"{a} and {b} are placed {prior.told(T)}"


def _through(p: Prior, q: Prior) -> Prior:
    """Return T_a_b from T_outer_a and T_outer_b."""
    back = inverse(p.T)
    R, arm = back[:3, :3], q.T[:3, 3] - p.T[:3, 3]
    covariance = carried(q.covariance, R, np.zeros(3)) + carried(p.covariance, -R, arm)
    name = p.name if p.name == q.name else f"{p.name} and {q.name}"
    return Prior(p.source, q.source, back @ q.T, covariance, p.alone and q.alone, name)


def _parsed(text: str) -> Prior:
    where = f"prior {text!r}"
    try:
        tree = load_yaml(text)
    except ConfigurationError as error:
        raise ConfigurationError(f"{where}: {error}") from error
    if not isinstance(tree, Mapping):
        raise ConfigurationError(f"{where}: expected {{between: [a, b], …}}, got {tree!r}")
    unknown = [key for key in tree if key not in _KEYS]
    if unknown:
        raise ConfigurationError(f"{where}: unknown key {unknown[0]!r}; known: {', '.join(_KEYS)}")
    target, source = _frames(tree, where)
    sigma = _numbers(tree, "sigma", 1, where, (1.0,))[0]
    turn = np.radians(_numbers(tree, "yaw_sigma", 1, where, (10.0,))[0])
    if "covariance" in tree:
        covariance = np.array(_numbers(tree, "covariance", 36, where)).reshape(6, 6)
        symmetric = np.allclose(covariance, covariance.T)
        if not symmetric or np.linalg.eigvalsh(covariance).min() < 0.0:
            raise ConfigurationError(f"{where}: covariance: expected one, symmetric, not negative")
    else:
        covariance = np.diag([sigma, sigma, sigma, turn, turn, turn]) ** 2
    name = str(tree.get("name", f"prior of {target} and {source}"))
    own = (target, source) if "between" in tree else (source,)
    alone = tree.get("alone") is True
    return Prior(target, source, _pose(tree, where), covariance, alone, name, own)


def _frames(tree: Mapping[str, Any], where: str) -> tuple[str, str]:
    """Return target and source frame."""
    between = tree.get("between")
    if isinstance(between, list) and len(between) == 2 and "agent" not in tree and "in" not in tree:
        target, source = map(str, between)
    elif between is None and "agent" in tree and "in" in tree:
        target, source = str(tree["in"]), str(tree["agent"])
    else:
        raise ConfigurationError(f"{where}: expected either between: [a, b] or agent: a, in: frame")
    if target == source:
        raise ConfigurationError(f"{where}: expected two frames, got {target!r} twice")
    return target, source


def _pose(tree: Mapping[str, Any], where: str) -> Transform:
    if "T" not in tree:
        x, y, z = _numbers(tree, "position", 3, where)
        return yaw_pose(np.radians(_numbers(tree, "yaw", 1, where)[0]), (x, y, z))
    T = np.array(_numbers(tree, "T", 16, where)).reshape(4, 4)
    R = T[:3, :3]
    rigid = np.abs(R @ R.T - np.eye(3)).max() < 1e-6 and np.linalg.det(R) > 0
    if not rigid or not np.array_equal(T[3], (0, 0, 0, 1)):
        raise ConfigurationError(f"{where}: T: expected a rigid motion")
    return T


def _numbers(
    tree: Mapping[str, Any], key: str, count: int, where: str, default: tuple[float, ...] = ()
) -> list[float]:
    value = tree.get(key, list(default) or None)
    flat = np.ravel(value).tolist() if isinstance(value, (list, int, float)) else []
    if len(flat) != count or not all(isinstance(v, (int, float)) and np.isfinite(v) for v in flat):
        many = "a number" if count == 1 else f"{count} numbers"
        got = repr(value) if key in tree else "none"
        raise ConfigurationError(f"{where}: {key}: expected {many}, got {got}")
    return [float(v) for v in flat]
