"""One agent's clouds and transforms on their way into its session, live and in replay alike.

Decides for each cloud whether it is a whole map or a single scan, places scans by the agent's own
TF tree, and lets a scan wait until the transforms around its stamp have arrived.
"""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import TopometricError
from topometric_ros.io.pointcloud2 import CloudError, points_from_message
from topometric_ros.runtime.agents_file import MODES
from topometric_ros.runtime.extractor_session import ExtractorSession
from topometric_ros.runtime.message_codec import stamp_of
from topometric_ros.runtime.transforms import (
    TransformBuffer,
    TransformError,
    TransformNotYetError,
)
from topometric_ros.runtime.whole_maps import WholeMaps

logger = logging.getLogger(__name__)


class InputError(TopometricError):
    """An input mode that does not exist."""


@dataclass
class _Scan:
    points: NDArray[np.float64]
    frame_id: str
    stamp: int
    dropped: int
    since: float | None = None
    """When it was first seen waiting, s."""


class AgentInput:
    """The way of one agent's clouds into its :class:`ExtractorSession`.

    Parameters
    ----------
    session : where the clouds go
    mode : map, scan, or auto: a cloud is a scan where its frame lies below the map's on /tf
    map_frame : frame of the map; empty: see :meth:`TransformBuffer.map_frame`
    history : how far back (ns) transforms are kept, None: for ever
    waiting : scans that may wait for their transforms; the oldest are skipped and counted
    sensor_frame : frame of the sensor where it is not that of the clouds, as of clouds that an
        odometry has placed already
    """

    def __init__(
        self,
        session: ExtractorSession,
        mode: str = "auto",
        map_frame: str = "",
        history: int | None = None,
        waiting: int = 200,
        sensor_frame: str = "",
    ) -> None:
        if mode not in MODES:
            raise InputError(f"mode: expected one of {', '.join(MODES)}, got {mode!r}")
        self.session = session
        self.mode = mode
        self.transforms = TransformBuffer(history)
        self.skipped: list[str] = []
        """Why clouds were skipped, one sentence each, the newest last (at most 100 are kept)."""
        self.skipped_count = 0
        self.overflowed = 0
        """How many of them gave way to newer scans while they waited for transforms."""
        self.whole_maps = WholeMaps()
        self.astray = ""
        """What is wrong where clouds lie on /tf, but not below the map's frame that was named."""
        self._map_frame = map_frame.lstrip("/")
        self._sensor_frame = sensor_frame.lstrip("/")
        self._waiting: deque[_Scan] = deque()
        self._most_waiting = waiting
        self._waits_for = ""
        self._taken_as_map = ""

    def reset(self) -> None:
        """Forget every cloud, taken or waiting; a new session begins. Transforms stay."""
        self._waiting.clear()
        self._taken_as_map = ""
        self.whole_maps = WholeMaps()
        self.skipped, self.skipped_count, self.overflowed = [], 0, 0
        self.session.reset()

    def add_transforms(self, message: Any, static: bool) -> None:
        """Take a tf2_msgs/TFMessage; transforms that cannot be right are skipped and counted."""
        for reason in self.transforms.add_message(message, static):
            self._skip(reason)
        self._place_waiting()

    def add_cloud(self, message: Any) -> None:
        """Take a sensor_msgs/PointCloud2.

        Raises
        ------
        CloudError
            The message contradicts itself or holds no finite point; nothing has changed.
        """
        points, dropped = points_from_message(message)
        if len(points) == 0:
            total = dropped or "0"
            raise CloudError(
                f"a cloud in frame {message.header.frame_id}: no finite point of {total}"
            )
        self.add_points(points, message.header.frame_id, stamp_of(message.header), dropped)

    def add_points(
        self, points: NDArray[np.float64], frame_id: str, stamp: int, dropped: int = 0
    ) -> None:
        """Take the finite points (N, 3) float64, m, of a cloud in `frame_id` at `stamp` (ns)."""
        frame_id = frame_id.lstrip("/")
        if not self._is_scan(frame_id):
            self._taken_as_map = frame_id
            if self.mode == "auto":
                self.whole_maps.add(points, frame_id)
            self.session.add_map_cloud(points, frame_id, stamp, dropped)
            return
        if frame_id == self._taken_as_map:
            logger.warning(
                "%s: clouds in %s are scans, as /tf now says; those before are forgotten",
                *(self.session.agent, frame_id),
            )
            self.session.reset()
            self._taken_as_map = ""
        self._waiting.append(_Scan(points, frame_id, stamp, dropped))
        self._place_waiting()
        while len(self._waiting) > self._most_waiting:
            self._waiting.popleft()
            self.overflowed += 1
            self._skip(f"more than {self._most_waiting} scans wait: {self._waits_for}")

    @property
    def waiting(self) -> int:
        """How many scans wait for transforms."""
        return len(self._waiting)

    @property
    def waits_for(self) -> str:
        """What the oldest waiting scan lacks, a sentence that names the frame; or empty."""
        return self._waits_for if self._waiting else ""

    def expire(self, now: float, longest: float) -> None:
        """Skip the scans that have waited for their transforms too long.

        Parameters
        ----------
        now : s, of a clock that only runs forward
        longest : s that a scan may wait from the first call that sees it
        """
        for scan in self._waiting:
            scan.since = now if scan.since is None else scan.since
        while self._waiting:
            since = self._waiting[0].since
            if since is None or now - since <= longest:
                return
            self._waiting.popleft()
            self._skip(f"a scan waited {longest:g} s: {self._waits_for}")
            self._place_waiting()

    def finish(self) -> None:
        """Skip what still waits: nothing more will arrive."""
        while self._waiting:
            self._place(self._waiting.popleft(), last=True)

    def _is_scan(self, frame_id: str) -> bool:
        if self.mode != "auto":
            return self.mode == "scan"
        if frame_id not in self.transforms.frames():
            return False
        target = self._map_frame or self.transforms.map_frame(frame_id)
        above = self.transforms.ancestors(frame_id)
        if target != frame_id and target not in above:
            self.astray = f"expected {target} above {frame_id} on /tf, got {', '.join(above)}"
        return target != frame_id and target in above

    def _place_waiting(self) -> None:
        while self._waiting and self._place(self._waiting[0]):
            self._waiting.popleft()

    def _place(self, scan: _Scan, last: bool = False) -> bool:
        """Put a scan into the session, or skip it; False where it should wait."""
        try:
            target = self._map_frame_of(scan.frame_id)
            T_map_cloud = self.transforms.lookup(target, scan.frame_id, scan.stamp)
            sensor = self._sensor(target, scan, T_map_cloud)
        except TransformNotYetError as error:
            self._waits_for = str(error)
            if not last:
                return False
            self._skip(str(error))
            return True
        except TransformError as error:
            self._skip(str(error))
            return True
        self.session.add_scan(scan.points, target, scan.stamp, T_map_cloud, scan.dropped, sensor)
        return True

    def _sensor(
        self, target: str, scan: _Scan, T_map_cloud: NDArray[np.float64]
    ) -> NDArray[np.float64] | None:
        """Return where the sensor was, (3,) m, map frame; None where the frames do not tell."""
        if self._sensor_frame:
            return self.transforms.lookup(target, self._sensor_frame, scan.stamp)[:3, 3]
        # A cloud in the map's own frame was placed by somebody else.
        return None if scan.frame_id == target else T_map_cloud[:3, 3]

    def _map_frame_of(self, frame_id: str) -> str:
        """Return the frame that scans of `frame_id` are gathered in."""
        if self._map_frame:
            return self._map_frame
        if frame_id not in self.transforms.frames():
            raise TransformNotYetError(f"no frame {frame_id} on /tf")
        return self.transforms.map_frame(frame_id)

    def _skip(self, reason: str) -> None:
        self.skipped_count += 1
        self.skipped = [*self.skipped[-99:], reason]
        logger.debug("%s: skipped: %s", self.session.agent, reason)
