"""Named quality-of-service profiles, and the choice of one for a cloud of unknown origin."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

_CLOUD_DEPTH = 50
"""Clouds come in bursts, and a process may stand still: what a usual scanner makes in 5 s. The
middleware tells of what is lost on the way, and not of what newer ones push out at its end."""
MAP_CLOUD_DEPTH = 2
"""Of whole maps the newest serves, and each may have many megabytes."""


def _profile(reliable: bool, latched: bool, depth: int) -> QoSProfile:
    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=depth,
        reliability=ReliabilityPolicy.RELIABLE if reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE,
    )


SNAPSHOT = _profile(reliable=True, latched=True, depth=1)
"""Maps, alignments and markers: whole snapshots, a late joiner gets the current state."""

TRANSFORMS = _profile(reliable=True, latched=False, depth=100)
"""`/tf`, as tf2_ros has it."""

STATIC_TRANSFORMS = _profile(reliable=True, latched=True, depth=100)
"""`/tf_static`, as tf2_ros has it for listeners."""

DIAGNOSTICS = _profile(reliable=True, latched=False, depth=10)
"""`/diagnostics`, as diagnostic_updater has it."""

CLOUD_RELIABLE = _profile(reliable=True, latched=False, depth=_CLOUD_DEPTH)
CLOUD_BEST_EFFORT = _profile(reliable=False, latched=False, depth=_CLOUD_DEPTH)


def strongest_common(offers: Iterable[QoSProfile], depth: int = _CLOUD_DEPTH) -> QoSProfile:
    """Return the strongest cloud profile that every one of the publishers' offers satisfies.

    With no publisher yet it is reliable and volatile: the profile that needs no second
    subscription, during which messages could be lost, for the publishers seen most often.
    """
    known = list(offers)
    if not known:
        return _profile(reliable=True, latched=False, depth=depth)
    return _profile(
        reliable=all(o.reliability == ReliabilityPolicy.RELIABLE for o in known),
        latched=all(o.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in known),
        depth=depth,
    )


def cloud_profile(
    choice: str, offers: Iterable[QoSProfile], depth: int = _CLOUD_DEPTH
) -> QoSProfile:
    """Return the cloud subscription's profile for parameter `cloud_qos` = `choice`."""
    if choice == "auto":
        return strongest_common(offers, depth)
    return _profile(reliable=choice == "reliable", latched=False, depth=depth)


def same_profile(a: QoSProfile, b: QoSProfile) -> bool:
    """Return whether two profiles ask for the same reliability and durability."""
    return (a.reliability, a.durability) == (b.reliability, b.durability)


def describe(profile: QoSProfile) -> str:
    """Return a profile in words, for the log: ``reliable, transient local``."""
    return f"{profile.reliability.name}, {profile.durability.name}".replace("_", " ").lower()
