"""Which parameters a verdict on a pair of agents rests on, as a mark that changes when they do.

It is kept with the verdict, in the state file too: a merger that is told other parameters, while it
runs or between two starts, asks again. Of the priors only the one between the two agents counts.
"""

from __future__ import annotations

import hashlib
from functools import lru_cache

from topometric_ros.configuration import flatten
from topometric_ros.fusion.config import MergeConfig
from topometric_ros.fusion.priors import parse_priors, prior_between

_AFTER_ALIGNING = ("groups.", "fuse.", "global_frame", "priors")
"""Parameters of what is made of all alignments together, and the priors, which are told apart."""


@lru_cache(maxsize=2048)
def mark(config: MergeConfig, a: str, b: str) -> str:
    """Return the mark of what aligning agents `a` and `b` rests on besides their maps.

    Raises
    ------
    ConfigurationError
        A prior makes no sense.
    """
    values = [
        (name, value)
        for name, value in flatten(config).items()
        if not name.startswith(_AFTER_ALIGNING)
    ]
    prior = prior_between(parse_priors(config.priors), a, b)
    if prior is not None:
        pose = (prior.T.tobytes(), prior.covariance.tobytes())
        values.append(("prior", (*pose, prior.alone, prior.name)))
    return hashlib.sha256(repr(values).encode()).hexdigest()[:16]
