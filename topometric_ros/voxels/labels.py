"""Counting the labels of one segmentation against those of another."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def joint_counts(
    one: NDArray[np.integer],
    other: NDArray[np.integer],
    ids_one: NDArray[np.integer],
    ids_other: NDArray[np.integer],
) -> NDArray[np.int64]:
    """Count how often each label of one array meets each label of another.

    Parameters
    ----------
    one, other : (N,) integers, two labels of the same things
    ids_one, ids_other : (R,) and (S,) distinct integers, the labels to count, in any order

    Returns
    -------
    (R + 1, S + 1) int64; the last row and column count labels that are none of the ids

    Examples
    --------
    >>> one, other = np.array([4, 4, 7, -1]), np.array([0, 1, 1, 1])
    >>> joint_counts(one, other, np.array([7, 4]), np.arange(2))
    array([[0, 1, 0],
           [1, 1, 0],
           [0, 1, 0]])
    """
    shape = (len(ids_one) + 1, len(ids_other) + 1)
    cell = _row_of(one, ids_one) * shape[1] + _row_of(other, ids_other)
    return np.bincount(cell, minlength=shape[0] * shape[1]).reshape(shape)


def _row_of(labels: NDArray[np.integer], ids: NDArray[np.integer]) -> NDArray[np.int64]:
    """Return the row in `ids` of each label, len(ids) where it is not there."""
    if len(ids) == 0:
        return np.zeros(len(labels), np.int64)
    order = np.argsort(ids, kind="stable")
    place = np.minimum(np.searchsorted(ids[order], labels), len(ids) - 1)
    row = order[place].astype(np.int64)
    return np.where(ids[row] == labels, row, len(ids))
