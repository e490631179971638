"""One cloud to one described map: what the command line and the extractor's session both do."""

from __future__ import annotations

import dataclasses
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.extraction.pipeline import Extraction, extract
from topometric_ros.extraction.quality import Finding
from topometric_ros.matching.config import MatchingConfig
from topometric_ros.runtime.descriptions import describe_changed
from topometric_ros.topometric_map import TopometricMap


def extract_map(
    points: NDArray[np.float64],
    extraction: ExtractionConfig,
    matching: MatchingConfig,
    *,
    T_up_input: NDArray[np.float64] | None = None,
    warnings: tuple[str, ...] = (),
    previous: TopometricMap | None = None,
    **identity: Any,
) -> Extraction:
    """Extract a map and describe its rooms.

    Parameters
    ----------
    points : (P, 3) float64, m, finite, z up: turned by `T_up_input` from the input's frame
    extraction, matching : configurations of the two stages
    T_up_input : (4, 4), identity by default; becomes a part of the map's `T_level_input`
    warnings : put before those of the extraction
    previous : an earlier map of the session, whose descriptors serve for rooms that are the same
    identity : agent, session, sequence, frame_id, stamp, origin, T_level_input, way and classifier
        of `extract`

    Raises
    ------
    ExtractionError
        No points, or no floor with z up.
    """
    result = extract(points, extraction, **identity)
    start = time.thread_time()
    described = in_input_frame(describe_changed(result.map, previous, matching), T_up_input)
    described = dataclasses.replace(described, warnings=(*warnings, *described.warnings))
    told = tuple(Finding("input", "warning", warning) for warning in warnings)
    quality = dataclasses.replace(result.quality, findings=(*told, *result.quality.findings))
    timings = {**result.timings, "descriptors": time.thread_time() - start}
    return dataclasses.replace(result, map=described, timings=timings, quality=quality)


def in_input_frame(m: TopometricMap, T_up_input: NDArray[np.float64] | None) -> TopometricMap:
    """Return a map whose `T_level_input` leads from the input's own frame, not the turned one."""
    if T_up_input is None or np.array_equal(T_up_input, np.eye(4)):
        return m
    return dataclasses.replace(m, T_level_input=m.T_level_input @ T_up_input)
