"""This package as a peer: extraction of both clouds, then merging, as the command line does it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from topometric_ros.evaluation.peers.base import PeerResult
from topometric_ros.fusion.merge import merge
from topometric_ros.runtime.config import preset_config
from topometric_ros.runtime.extract_map import extract_map


class Topometric:
    """`topometric merge` with a preset; accepted where the alignment's status says so."""

    def __init__(self, preset: str = "default") -> None:
        self.name = "topometric" if preset == "default" else f"topometric_{preset}"
        self._preset = preset

    def align(self, points_a: NDArray[np.float64], points_b: NDArray[np.float64]) -> PeerResult:
        """Return the alignment; of a refused pair, the best pose that was considered."""
        config = preset_config(self._preset)
        matching = config.merge.matching
        maps = [
            extract_map(points, config.extraction, matching, agent=agent).map
            for agent, points in (("a", points_a), ("b", points_b))
        ]
        alignment = merge(maps, config.merge).alignments[0]
        T_a_b = alignment.T_a_b
        if T_a_b is None and alignment.alternatives:
            T_a_b = alignment.alternatives[0].T_a_b
        return PeerResult(T_a_b, alignment.accepted, alignment.score)
