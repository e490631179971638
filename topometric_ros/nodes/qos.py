"""Named quality-of-service profiles, and the choice of one for a cloud of unknown origin."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

_CLOUD_DEPTH = 10
"""Clouds come in bursts; ten scans are what a usual scanner makes in a second."""


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


def strongest_common(offers: Iterable[QoSProfile]) -> QoSProfile:
    """Return the strongest cloud profile that every one of the publishers' offers satisfies.

    With no publisher yet it is reliable and volatile: the profile that needs no second
    subscription, during which messages could be lost, for the publishers seen most often.
    """
    known = list(offers)
    if not known:
        return CLOUD_RELIABLE
    return _profile(
        reliable=all(o.reliability == ReliabilityPolicy.RELIABLE for o in known),
        latched=all(o.durability == DurabilityPolicy.TRANSIENT_LOCAL for o in known),
        depth=_CLOUD_DEPTH,
    )


def cloud_profile(choice: str, offers: Iterable[QoSProfile]) -> QoSProfile:
    """Return the cloud subscription's profile for parameter `cloud_qos` = `choice`."""
    fixed = {"reliable": CLOUD_RELIABLE, "best_effort": CLOUD_BEST_EFFORT}
    return fixed[choice] if choice in fixed else strongest_common(offers)


def same_profile(a: QoSProfile, b: QoSProfile) -> bool:
    """Return whether two profiles ask for the same reliability and durability."""
    return (a.reliability, a.durability) == (b.reliability, b.durability)


def describe(profile: QoSProfile) -> str:
    """Return a profile in words, for the log: ``reliable, transient local``."""
    return f"{profile.reliability.name}, {profile.durability.name}".replace("_", " ").lower()
