"""KISS-Matcher, the robust global registration to beat, with rotation about the vertical only.

Reference: H. Lim et al., "KISS-Matcher: fast and robust point cloud registration revisited", ICRA
2025; `use_quatro`: H. Lim et al., "A single correspondence is enough", ICRA 2022.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.evaluation.peers.base import PeerResult, require


class KissMatcher:
    """The wheel `kiss-matcher`; accepts a pose with `least_inliers` final inliers.

    Five is what the makers' own example asks for; the score is the number of inliers, so that the
    rows tell what any other limit would do.
    """

    name = "kiss_matcher"

    def __init__(self, voxel_size: float = 0.2, least_inliers: int = 5) -> None:
        self._library = require(
            "kiss_matcher", self.name, "kiss-matcher", " (its wheels end at Python 3.12)"
        )
        self._voxel_size = voxel_size
        self._least_inliers = least_inliers

    def align(self, points_a: NDArray[np.float64], points_b: NDArray[np.float64]) -> PeerResult:
        """Return the pose that the largest consistent set of matches gives, without any ICP."""
        config = self._library.KISSMatcherConfig(self._voxel_size, use_quatro=True)
        matcher = self._library.KISSMatcher(config)
        found = matcher.estimate(points_b.astype(np.float32), points_a.astype(np.float32))
        inliers = int(matcher.get_num_final_inliers())
        T_a_b = np.eye(4)
        T_a_b[:3, :3] = np.asarray(found.rotation)
        T_a_b[:3, 3] = np.asarray(found.translation).ravel()
        return PeerResult(T_a_b, inliers >= self._least_inliers, float(inliers))
