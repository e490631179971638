"""The protocol that every descriptor of room geometry follows (thesis eq. 41-43)."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from topometric_ros.topometric_map import TopometricMap


class Descriptor(Protocol):
    """A function from the voxels of rooms to vectors that are near for similar geometry.

    `version` rises whenever the same room would be described by other numbers: maps carry their
    descriptors, and only equal names and versions may be compared.
    """

    @property
    def name(self) -> str:
        """What the descriptor is called in a map."""

    @property
    def version(self) -> int:
        """Raised when the numbers change."""

    @property
    def dimension(self) -> int:
        """Length D of a vector."""

    @property
    def by_ratio(self) -> bool:
        """Whether values are sizes, zero or more, of which ratios count: compared by logarithm."""

    def __call__(
        self, topometric_map: TopometricMap, members: Sequence[Sequence[int]] | None = None
    ) -> NDArray[np.float32]:
        """Describe every room, or each set of rooms in `members` merged: (R, D) float32."""


def room_voxels(
    topometric_map: TopometricMap, members: Sequence[Sequence[int]] | None = None
) -> Iterator[NDArray[np.int32]]:
    """Yield the voxels of every room, or of each set of room ids in `members`: (n, 3) int32."""
    order = np.argsort(topometric_map.room, kind="stable")
    labels = topometric_map.room[order]
    if members is None:
        members = [(room.id,) for room in topometric_map.rooms]
    for ids in members:
        parts = [
            order[np.searchsorted(labels, i) : np.searchsorted(labels, i, side="right")]
            for i in sorted(ids)
        ]
        yield topometric_map.voxels[np.sort(np.concatenate(parts))]
