"""Rasters made fine and smooth for the eye; what they mean stays on the coarse cells."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

_FINE_CELLS = 2_500_000
"""A refined raster has at most about so many cells."""
_LABEL_BLUR = 1.2
"""Cells by which a label is blurred before the densest wins."""
_BLUR_REACH = 6
"""Cells: four deviations of the wider blur, and one for the interpolation."""


def refinement(shape: tuple[int, ...]) -> int:
    """Return how many fine cells a cell's edge is cut into: 1 to 4."""
    return int(np.clip(np.sqrt(_FINE_CELLS / max(1, shape[0] * shape[1])), 1, 4))


def fine_origin(origin: tuple[float, float], cell: float, factor: int) -> tuple[float, float]:
    """Return the centre of the first fine cell, m."""
    shift = cell * (0.5 / factor - 0.5)
    return origin[0] + shift, origin[1] + shift


def smooth_mask(mask: NDArray[np.bool_], factor: int) -> NDArray[np.bool_]:
    """Refine a mask (nx, ny) by `factor`, its stairs rounded off; lines one cell wide survive."""
    result = np.zeros((mask.shape[0] * factor, mask.shape[1] * factor), bool)
    if mask.any():
        near = _bounds(mask, margin=_BLUR_REACH)
        closed = ndimage.binary_closing(np.pad(mask[near], 2), np.ones((3, 3)))[2:-2, 2:-2]
        fine = tuple(slice(edge.start * factor, edge.stop * factor) for edge in near)
        result[fine] = _refined(closed.astype(np.float32), factor, 0.75) > 0.33
    return result


def smooth_labels(labels: NDArray[np.int32], factor: int) -> NDArray[np.int32]:
    """Refine labels (nx, ny) by `factor`; every fine cell takes the label that is densest there."""
    shape = (labels.shape[0] * factor, labels.shape[1] * factor)
    best = np.zeros(shape, dtype=np.float32)
    result = np.full(shape, labels.min(initial=0), dtype=np.int32)
    for label in np.unique(labels):
        mask = labels == label
        # Beyond the blur's reach a label has no density.
        near = _bounds(mask, margin=_BLUR_REACH)
        fine = tuple(slice(edge.start * factor, edge.stop * factor) for edge in near)
        density = _refined(mask[near].astype(np.float32), factor, _LABEL_BLUR)
        result[fine][density > best[fine]] = label
        best[fine] = np.maximum(best[fine], density)
    return result


def _bounds(mask: NDArray[np.bool_], margin: int) -> tuple[slice, ...]:
    """Return the part of a raster that holds all that is set, and `margin` cells round it."""
    (part,) = ndimage.find_objects(mask.astype(np.int8))
    return tuple(
        slice(max(0, edge.start - margin), min(size, edge.stop + margin))
        for edge, size in zip(part, mask.shape, strict=True)
    )


def _refined(values: NDArray[np.float32], factor: int, blur: float) -> NDArray[np.float32]:
    """Blur by `blur` cells and interpolate linearly at the centres of the fine cells."""
    blurred = ndimage.gaussian_filter(values, blur)
    positions = [(np.arange(n * factor) + 0.5) / factor - 0.5 for n in values.shape]
    for axis, at in enumerate(positions):
        low = np.clip(np.floor(at).astype(np.int64), 0, values.shape[axis] - 1)
        high = np.minimum(low + 1, values.shape[axis] - 1)
        share = np.clip(at - low, 0.0, 1.0).astype(np.float32)
        share = share[:, None] if axis == 0 else share[None, :]
        lower, upper = np.take(blurred, low, axis), np.take(blurred, high, axis)
        blurred = lower * (1 - share) + upper * share
    return blurred
