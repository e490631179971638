"""Trained networks, run by onnxruntime (extra `learned`) on one thread, the same way every time."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import missing_extra

Network = Callable[[Mapping[str, NDArray[np.float32]]], list[NDArray[np.float32]]]
"""Named inputs in, outputs in the order of the file out."""


@cache
def onnx_network(path: Path, needed_by: str) -> Network:
    """Load a network once.

    Parameters
    ----------
    path : of the .onnx file, one of the package's own
    needed_by : the parameter that asks for it, for the message

    Raises
    ------
    ConfigurationError
        onnxruntime is not installed.
    """
    try:
        import onnxruntime
    except ImportError as error:
        raise missing_extra(needed_by, "onnxruntime", "learned") from error
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 3
    session = onnxruntime.InferenceSession(str(path), options, providers=["CPUExecutionProvider"])

    def run(inputs: Mapping[str, NDArray[np.float32]]) -> list[NDArray[np.float32]]:
        found: list[NDArray[np.float32]] = session.run(None, dict(inputs))
        return found

    return run
