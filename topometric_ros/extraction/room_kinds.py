"""What kind a room is of, and which stretches are one corridor: by geometry or as was learned.

A classifier is any object with the two methods of `RoomClassifier`; one is named by
`kinds.classifier` or handed to `extract`. The one that comes with the package knows shape and
neighbours: a corridor is narrow for its length and leads to many rooms; stairs lead out of a
stairwell, which is no corridor. Its weights were set by hand on the labelled rooms of nine
buildings.
"""

from __future__ import annotations

import importlib
import math
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.configuration import parameter
from topometric_ros.errors import ConfigurationError
from topometric_ros.extraction.masks import depth
from topometric_ros.topometric_map import ROOM_KINDS

_LARGE, _WIDE = 50.0, 4.0
"""A hall is larger (m²) and wider (m) than these."""
_MOST_NEIGHBOURS = 6
"""More neighbours than this say no more."""
_STAIRWELL = 0.6
"""How sure it is that a room without the shape of a corridor, from which stairs lead, is built
for them: on the labelled rooms five of eight were."""
_STAIRWELL_WIDTH = 3.0
"""m: a room with stairs that is wider than this is no corridor, whatever it leads to."""

_OPENING = 0.85
_ALIKE = 1.5
"""Stretches of one corridor meet in an opening of this share of the narrower one's width, and the
wider one is at most this many times as wide."""


@dataclass(frozen=True)
class RoomView:
    """What a classifier is shown of a room; lengths in m.

    `floor` (nx, ny) bool is its floor on cells of `cell`, walls left out. While rooms are still
    being made, `points`, `height`, `neighbours` and `stairs` are not known and empty.
    """

    floor: NDArray[np.bool_]
    cell: float
    points: NDArray[np.float64]
    """(n, 3) centres of the room's voxels, level frame."""
    height: float | None = None
    neighbours: int = 0
    """How many rooms passages lead to."""
    stairs: int = 0
    """How many passages of kind `stairs` lead out of it."""

    @property
    def area(self) -> float:
        """Area of the floor, m²."""
        return float(np.count_nonzero(self.floor) * self.cell**2)

    @property
    def width(self) -> float:
        """Typical width, see :func:`typical_width`."""
        return typical_width(self.floor, self.cell)


class RoomClassifier(Protocol):
    """Tells what rooms are for (the draft's purpose-aware rooms); subclass it or look like it."""

    def kind(self, room: RoomView) -> tuple[str, float]:
        """Return one of `ROOM_KINDS` and how sure that is, 0 to 1."""

    def same_corridor(self, first: RoomView, second: RoomView, opening: float) -> bool:
        """Return whether two regions that meet in an opening (m wide) are cuts of one corridor.

        Unless overridden they are where both are called corridors and it does not narrow between.
        """
        narrow, wide = sorted((first.width, second.width))
        if opening < _OPENING * narrow or wide > _ALIKE * narrow:
            return False
        return all(self.kind(view)[0] == "corridor" for view in (first, second))


class GeometricClassifier(RoomClassifier):
    """The classifier that comes with the package.

    It joins no more corridors than the merging of pieces has joined by the same features
    (`narrowings.merging.corridors`).
    """

    def kind(self, room: RoomView) -> tuple[str, float]:
        """Return what :func:`room_kind` says."""
        return room_kind(room.area, room.width, room.neighbours, room.stairs)

    def same_corridor(self, first: RoomView, second: RoomView, opening: float) -> bool:
        """Return False."""
        return False


def load_classifier(name: str) -> RoomClassifier:
    """Return the classifier of that name, `geometric` or `MODULE:NAME`.

    Raises
    ------
    ConfigurationError
        There is no such module or name in it, or what is found there is no classifier.
    """
    if name == "geometric":
        return GeometricClassifier()
    module, _, attribute = name.partition(":")
    try:
        found = getattr(importlib.import_module(module), attribute)
        classifier = found() if isinstance(found, type) else found
    except Exception as error:  # Whatever somebody else's module may raise.
        raise ConfigurationError(
            f"expected geometric or MODULE:NAME of a room classifier, got {name!r} ({error})"
        ) from error
    for method in ("kind", "same_corridor"):
        if not callable(getattr(classifier, method, None)):
            raise ConfigurationError(
                f"expected a room classifier, got {name!r}, which has no method {method}"
            )
    return classifier  # type: ignore[no-any-return]


@dataclass(frozen=True)
class RoomKindsConfig:
    """Who tells the kinds of rooms."""

    classifier: str = parameter(
        "geometric",
        "What tells rooms from corridors, halls and stairwells: geometric, or MODULE:NAME of an "
        "own RoomClassifier, an object or a class without arguments.",
        rule=load_classifier,
    )


def told(classifier: RoomClassifier, room: RoomView) -> tuple[str, float]:
    """Return what a classifier says of a room; raises ConfigurationError where that is no kind."""
    kind, sure = classifier.kind(room)
    if kind not in ROOM_KINDS or not 0.0 <= sure <= 1.0:
        raise ConfigurationError(
            f"{type(classifier).__name__}: expected one of {', '.join(ROOM_KINDS)} and a "
            f"confidence of 0 to 1, got {kind!r} and {sure}"
        )
    return kind, float(sure)


def join_corridors(
    regions: NDArray[np.int32],
    distance: NDArray[np.float64],
    cell: float,
    classifier: RoomClassifier,
) -> NDArray[np.int32]:
    """Join touching regions that a classifier calls cuts of one corridor, the widest opening first.

    Parameters
    ----------
    regions : (nx, ny) int32, numbered from 1, 0 where there is none
    distance : (nx, ny) float64, cells, distance from the walls
    cell : edge of a cell, m
    classifier : who says so

    Returns
    -------
    (nx, ny) int32; a joined region has its lowest number
    """
    if isinstance(classifier, GeometricClassifier):
        return regions
    regions = regions.copy()
    asked: set[tuple[int, int]] = set()
    while True:
        openings = _openings(regions, distance)
        for pair in sorted(openings, key=lambda p: (-openings[p], p)):
            if pair in asked:
                continue
            asked.add(pair)
            views = [
                RoomView(_cropped(regions == number), cell, np.zeros((0, 3))) for number in pair
            ]
            # The distance is that from the middle of the opening to its nearer side.
            if classifier.same_corridor(views[0], views[1], 2 * openings[pair] * cell):
                regions[regions == pair[1]] = pair[0]
                asked = {p for p in asked if pair[0] not in p}
                break
        else:
            return regions


def _openings(
    regions: NDArray[np.int32], distance: NDArray[np.float64]
) -> dict[tuple[int, int], float]:
    """Return the largest distance from the walls (cells) where each two regions touch."""
    found: dict[tuple[int, int], float] = {}
    for axis in (0, 1):
        first, second = (
            np.moveaxis(regions, axis, 0)[part] for part in (slice(-1), slice(1, None))
        )
        near, far = (np.moveaxis(distance, axis, 0)[part] for part in (slice(-1), slice(1, None)))
        touch = (first != second) & (first > 0) & (second > 0)
        for a, b, reach in zip(
            first[touch].tolist(),
            second[touch].tolist(),
            np.minimum(near, far)[touch].tolist(),
            strict=True,
        ):
            pair = (min(a, b), max(a, b))
            found[pair] = max(found.get(pair, 0.0), reach)
    return found


def _cropped(mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
    x, y = ndimage.find_objects(mask.astype(np.int8))[0]
    return mask[x, y]


def typical_width(floor: NDArray[np.bool_], cell: float) -> float:
    """Return four times the mean distance to the rim, m: about the width of a long strip.

    Parameters
    ----------
    floor : (nx, ny), cells of `cell` m
    """
    inside = np.pad(floor, 1)
    if not inside.any():
        return 0.0
    return float(4.0 * depth(inside)[inside].mean() * cell)


def room_kind(area: float, width: float, neighbours: int, stairs: int) -> tuple[str, float]:
    """Return a room's kind and how sure that is, 0 to 1.

    Parameters
    ----------
    area : of the floor, m²
    width : typical width, m
    neighbours : how many rooms passages lead to
    stairs : how many passages of kind `stairs` lead out of it

    Examples
    --------
    >>> room_kind(area=30.0, width=1.9, neighbours=8, stairs=0)[0]
    'corridor'
    >>> room_kind(area=14.0, width=2.2, neighbours=1, stairs=0)[0]
    'room'
    """
    if area <= 0.0 or width <= 0.0:
        return "unknown", 0.0
    score = (
        1.5 * math.log(area / width**2 / 3.2)
        + 1.2 * (min(neighbours, _MOST_NEIGHBOURS) - 2)
        - 1.5 * (max(width, 1.5) - 2.2)
        - 0.3
    )
    corridor = 1.0 / (1.0 + math.exp(-score))
    if corridor >= 0.5 and not (stairs and width >= _STAIRWELL_WIDTH):
        return "corridor", corridor
    if stairs:
        return "stairwell", _STAIRWELL
    if area >= _LARGE and width >= _WIDE:
        return "hall", 1.0 - corridor
    return "room", 1.0 - corridor
