"""Names of the agents' map frames on /tf, where every robot may call its own `map`."""

from __future__ import annotations

from collections.abc import Mapping


def frames_below(global_frame: str, frames: Mapping[str, str]) -> dict[str, str]:
    """Return the name under which each agent's map frame is published on /tf.

    A frame has one parent and one place: a name that two agents use, or that is the global frame's
    own, becomes ``<agent>/<frame>``.

    Parameters
    ----------
    global_frame
        Name of the global frame.
    frames
        Each agent's own name of its map frame.

    Examples
    --------
    >>> frames_below("global", {"r1": "map", "r2": "map", "r3": "r3/map"})
    {'r1': 'r1/map', 'r2': 'r2/map', 'r3': 'r3/map'}
    """
    names = list(frames.values())
    return {
        agent: f"{agent}/{name}" if names.count(name) > 1 or name == global_frame else name
        for agent, name in frames.items()
    }
