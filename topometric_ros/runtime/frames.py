"""The frames that the merger puts on /tf: one for each agent whose place is known."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from topometric_ros.runtime.message_codec import header


def published_frames(frame_ids: Mapping[str, str], global_frame: str) -> dict[str, str]:
    """Return the name on /tf of each agent's map frame.

    Its own name, or `<agent>/<frame>` where two agents, or an agent and the global frame, use the
    same one; an agent that names no frame gets `<agent>/map`. No two are the same.

    Examples
    --------
    >>> published_frames({"a": "map", "b": "/map", "c": "c/map", "d": ""}, "global")
    {'a': 'a/map', 'b': 'b/map', 'c': 'c/map', 'd': 'd/map'}
    """
    # A name on /tf begins with no slash.
    own = {agent: frame.lstrip("/") for agent, frame in frame_ids.items()}
    used = [*own.values(), global_frame.lstrip("/")]
    names = {}
    for agent, frame in own.items():
        name = frame
        if not frame or used.count(frame) > 1:
            name = f"{agent}/{frame or 'map'}"
            while name in used:
                name = f"{agent}/{name}"
        names[agent] = name
    return names


def transforms_message(
    classes: Any,
    stamp: int,
    global_frame: str,
    transforms: Mapping[str, NDArray[np.float64]],
    frames: Mapping[str, str],
) -> Any:
    """Return a tf2_msgs/TFMessage with `global_frame` as the parent of every agent's map frame.

    Parameters
    ----------
    stamp : ns since the epoch
    transforms : T_global_agent (4, 4) of the agents whose place is known
    frames : name on /tf of each agent's map frame
    """
    entries = []
    for agent, T in transforms.items():
        x, y, z = (float(value) for value in T[:3, 3])
        qx, qy, qz, qw = Rotation.from_matrix(T[:3, :3]).as_quat(canonical=True).tolist()
        entries.append(
            classes.TransformStamped(
                header=header(classes, global_frame, stamp),
                child_frame_id=frames[agent],
                transform=classes.Transform(
                    translation=classes.Vector3(x=x, y=y, z=z),
                    rotation=classes.Quaternion(x=qx, y=qy, z=qz, w=qw),
                ),
            )
        )
    return classes.TFMessage(transforms=entries)
