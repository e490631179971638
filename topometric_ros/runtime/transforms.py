"""A transform buffer without tf2: frames, their parents, and where they were at a moment.

Each source (an agent's bag, a node's /tf) has a buffer of its own, so that two robots with the same
frame names never meet. Nothing is guessed: a transform that was not received is an error that names
the missing frame or the range of time that is known.
"""

from __future__ import annotations

import bisect
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from topometric_ros.errors import TopometricError

_SECOND = 1_000_000_000
_MOST_FRAMES = 10_000
_LONGEST_CHAIN = 1000
_LISTED = 20
"""Frames of a tree, of a way up it, and in a message, at most; a robot has some hundred."""


class TransformError(TopometricError):
    """A transform that is not known or cannot be one."""


class TransformNotYetError(TransformError):
    """The transform is not known, but may still arrive."""


@dataclass
class _Edge:
    """Where a frame was in its parent: `stamps` (ns, increasing) and `poses` (4, 4) each."""

    parent: str
    static: bool
    stamps: list[int] = field(default_factory=list)
    poses: list[NDArray[np.float64]] = field(default_factory=list)


class TransformBuffer:
    """The tree of frames of one source.

    Parameters
    ----------
    history : how far back (ns) a moving frame's poses are kept; None: all of them
    """

    def __init__(self, history: int | None = None) -> None:
        self._edges: dict[str, _Edge] = {}
        self._history = history

    def add(
        self,
        parent: str,
        child: str,
        stamp: int,
        T_parent_child: NDArray[np.float64],
        *,
        static: bool = False,
    ) -> None:
        """Take one transform, valid at `stamp` (ns) or, where `static`, always.

        Raises
        ------
        TransformError
            The matrix is not rigid and finite, or the frames are one and the same or empty.
        """
        parent, child = parent.lstrip("/"), child.lstrip("/")
        if not parent or not child or parent == child:
            raise TransformError(f"a transform from {child!r} to {parent!r} makes no tree")
        check_rigid(T_parent_child, f"transform from {child!r} to {parent!r}")
        edge = self._edges.get(child)
        if edge is None or edge.parent != parent or edge.static != static:
            edge = self._edges[child] = _Edge(parent, static)
            if len(self._edges) > _MOST_FRAMES:
                self._make_room(child)
        if static:
            edge.stamps, edge.poses = [stamp], [T_parent_child]
            return
        if self._history is not None and edge.stamps and stamp < edge.stamps[-1] - self._history:
            # The clock was set back, as where a bag starts again: what was known is of another
            # time, and next to it everything from now on would be too old to keep.
            edge.stamps, edge.poses = [], []
        at = bisect.bisect_left(edge.stamps, stamp)
        if at < len(edge.stamps) and edge.stamps[at] == stamp:
            edge.poses[at] = T_parent_child
        else:
            edge.stamps.insert(at, stamp)
            edge.poses.insert(at, T_parent_child)
        if self._history is not None:
            old = bisect.bisect_left(edge.stamps, edge.stamps[-1] - self._history)
            del edge.stamps[:old], edge.poses[:old]

    def _make_room(self, newest: str) -> None:
        """Drop a tenth of the frames: moving ones that were last heard of longest ago.

        A tracker that gives each thing it sees a frame of its own must not fill the memory.
        """
        moving = [frame for frame, edge in self._edges.items() if not edge.static and edge.stamps]
        moving.sort(key=lambda frame: self._edges[frame].stamps[-1])
        for frame in moving[: _MOST_FRAMES // 10]:
            del self._edges[frame]
        if not moving:
            del self._edges[newest]
            raise TransformError(f"more than {_MOST_FRAMES} frames that stand still")

    def add_message(self, message: Any, static: bool) -> list[str]:
        """Take the transforms of a tf2_msgs/TFMessage of any library.

        Returns
        -------
        Why transforms were refused, one sentence each: a bad one must not cost its neighbours, for
        a latched message comes once.
        """
        refused = []
        for entry in message.transforms:
            stamp = entry.header.stamp.sec * _SECOND + entry.header.stamp.nanosec
            parent, child = entry.header.frame_id, entry.child_frame_id
            try:
                T_parent_child = transform_matrix(entry.transform)
                self.add(parent, child, stamp, T_parent_child, static=static)
            except TransformError as error:
                refused.append(f"{child} in {parent}: {error}")
        return refused

    def frames(self) -> set[str]:
        """Return the name of every frame in the tree."""
        return set(self._edges) | {edge.parent for edge in self._edges.values()}

    def ancestors(self, frame: str) -> list[str]:
        """Return `frame`, its parent, and so on up to the root of its tree."""
        chain = [frame.lstrip("/")]
        while chain[-1] in self._edges:
            parent = self._edges[chain[-1]].parent
            if parent in chain:
                raise TransformError(f"the frames {' -> '.join([*chain, parent])} form a circle")
            if len(chain) == _LONGEST_CHAIN:
                raise TransformError(f"more than {_LONGEST_CHAIN} frames lie above {chain[0]}")
            chain.append(parent)
        return chain

    def map_frame(self, frame: str) -> str:
        """Return the frame of the map that `frame` belongs to.

        The nearest ancestor named `map` (or `.../map`): what lies above it, an `earth` or the map
        of a whole fleet, is not the agent's own. Where there is none, the root of the tree.
        """
        chain = self.ancestors(frame)
        named = (name for name in chain if name.rsplit("/", 1)[-1] == "map")
        return next(named, chain[-1])

    def lookup(self, target: str, source: str, stamp: int) -> NDArray[np.float64]:
        """Return `T_target_source` (4, 4) at `stamp` (ns), interpolated between received poses.

        Raises
        ------
        TransformNotYetError
            A frame is unknown, the two are not connected, or a frame on the way has only been seen
            at earlier moments: what is missing may still arrive.
        TransformError
            The moment lies before the first pose of a frame on the way.
        """
        target, source = target.lstrip("/"), source.lstrip("/")
        up_target, up_source = self.ancestors(target), self.ancestors(source)
        common = next((name for name in up_source if name in set(up_target)), None)
        if common is None:
            known = self.frames()
            missing = [name for name in (target, source) if name not in known]
            if missing:
                listed = ", ".join(sorted(known)[:_LISTED]) or "none"
                listed += f" and {len(known) - _LISTED} more" if len(known) > _LISTED else ""
                raise TransformNotYetError(
                    f"no frame {' or '.join(missing)} on /tf; known: {listed}"
                )
            raise TransformNotYetError(
                f"no path from frame {source} to {target}: their trees have the roots "
                f"{up_source[-1]} and {up_target[-1]}"
            )
        T_common_source = self._up(up_source, common, stamp)
        T_common_target = self._up(up_target, common, stamp)
        return np.linalg.inv(T_common_target) @ T_common_source

    def _up(self, chain: list[str], top: str, stamp: int) -> NDArray[np.float64]:
        """Return `T_top_bottom` along a chain of ancestors."""
        T_top_bottom = np.eye(4)
        for child in chain[: chain.index(top)]:
            T_top_bottom = self._pose(child, stamp) @ T_top_bottom
        return T_top_bottom

    def _pose(self, child: str, stamp: int) -> NDArray[np.float64]:
        """Return where `child` was in its parent at a moment."""
        edge = self._edges[child]
        if edge.static:
            return edge.poses[0]
        after = bisect.bisect_left(edge.stamps, stamp)
        if after < len(edge.stamps) and edge.stamps[after] == stamp:
            return edge.poses[after]
        if after in (0, len(edge.stamps)):
            kind = TransformError if after == 0 else TransformNotYetError
            raise kind(
                f"transform from {child} to {edge.parent} at {stamp / _SECOND:.3f} s: known from "
                f"{edge.stamps[0] / _SECOND:.3f} to {edge.stamps[-1] / _SECOND:.3f} s only"
            )
        first, last = edge.stamps[after - 1], edge.stamps[after]
        share = (stamp - first) / (last - first)
        return interpolate(edge.poses[after - 1], edge.poses[after], share)


def interpolate(
    first: NDArray[np.float64], second: NDArray[np.float64], share: float
) -> NDArray[np.float64]:
    """Return the pose `share` (0..1) of the way between two, turning at a constant rate."""
    turn = Rotation.from_matrix(first[:3, :3].T @ second[:3, :3]).as_rotvec()
    between = np.eye(4)
    between[:3, :3] = first[:3, :3] @ Rotation.from_rotvec(share * turn).as_matrix()
    between[:3, 3] = (1 - share) * first[:3, 3] + share * second[:3, 3]
    return between


def transform_matrix(transform: Any) -> NDArray[np.float64]:
    """Return a geometry_msgs/Transform of any library as a (4, 4) matrix.

    Raises
    ------
    TransformError
        A number is not finite or the quaternion's length is not one.
    """
    t, q = transform.translation, transform.rotation
    quaternion = np.array([q.x, q.y, q.z, q.w])
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1) < 0.01:  # Also false for a number that is not finite.
        raise TransformError(f"a rotation quaternion of length {length:.3g}, expected 1")
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(quaternion).as_matrix()
    T[:3, 3] = (t.x, t.y, t.z)
    return T


def check_rigid(T: NDArray[np.float64], what: str) -> None:
    """Raise TransformError where `T` is not a rigid motion; `what` begins the message."""
    T = np.asarray(T)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise TransformError(
            f"{what}: expected 4x4 finite numbers, got shape {T.shape}: {T.tolist()}"
        )
    R = T[:3, :3]
    off = float(np.abs(R @ R.T - np.eye(3)).max())
    if off > 1e-3 or np.linalg.det(R) < 0 or np.abs(T[3] - (0, 0, 0, 1)).max() > 1e-9:
        raise TransformError(f"{what}: not a rotation and a translation (off by {off:.2g})")
