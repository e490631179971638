"""Rooms of a strip as they are designed: width, door, windows, furniture, a room cut out of them.

A design is in the strip's own (u, v), so that two rooms of one design are twins: identical but
for where they are.
"""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from topometric_ros.simulation.building import Box, cabinet, table

Piece = tuple[Box, ...]
"""The boxes of one thing that could be moved; x and y are the room's u and v."""


@dataclass(frozen=True)
class Style:
    """What the rooms of one sort of building are like; lengths in m."""

    kinds: dict[str, float]
    """How often each kind of room comes, by name."""
    width: tuple[float, float]
    depth: float
    corridor: float
    rooms: int
    cut_out: tuple[str, ...]
    """Kinds whose rooms may have a smaller room cut out of a corner."""
    small: str
    """Kind of that smaller room."""


STYLES = {
    "office": Style(
        {"office": 6, "meeting room": 1.5, "laboratory": 1, "kitchen": 0.7, "store": 0.8},
        *((2.8, 6.0), 5.2, 2.0, 12, ("office", "laboratory"), "store"),
    ),
    "home": Style(
        {"bedroom": 3, "living room": 1.5, "kitchen": 1.2, "bathroom": 1, "office": 0.6},
        *((2.6, 5.6), 4.4, 1.4, 7, ("bedroom",), "bathroom"),
    ),
    "hospital": Style(
        {"patient room": 7, "treatment room": 1.5, "office": 1, "store": 1, "kitchen": 0.4},
        *((3.6, 5.4), 6.0, 2.4, 20, ("patient room",), "bathroom"),
    ),
}


@dataclass(frozen=True)
class Design:
    """A room in (u, v): 0 to `width` along the corridor, 0 to the strip's depth away from it."""

    kind: str
    width: float
    door: float
    """Middle of the door to the corridor: its u."""
    door_width: float
    windows: tuple[tuple[float, float], ...]
    """Middle (u) and width of each."""
    cut: tuple[float, float, float] | None
    """u from, u to and depth of the room cut out of a corner at the corridor."""
    pieces: tuple[Piece, ...]
    link: str = "door"


def divide(length: float, count: int, rng: np.random.Generator) -> list[float]:
    """Return `count` widths that sum to `length`, in decimetres but for the last, m."""
    shares = rng.uniform(0.7, 1.3, count)
    ends = np.round(np.cumsum(shares) / shares.sum() * length, 1)
    ends[-1] = length
    return np.round(np.diff(ends, prepend=0.0), 3).tolist()


def design_room(
    style: Style,
    width: float,
    facade: bool,
    options: tuple[float, float, bool],
    rng: np.random.Generator,
) -> Design:
    """Return a room drawn from a style.

    Parameters
    ----------
    facade : whether its far wall is an outer one
    options : share of furniture kept, share of rooms with a room cut out, windows or none
    """
    furniture, cut_share, windows = options
    kind = str(rng.choice(list(style.kinds), p=_shares(style)))
    cut = None
    if kind in style.cut_out and width >= 3.4 and rng.random() < cut_share:
        size = round(float(rng.uniform(1.5, min(1.9, width - 1.7))), 1)
        cut = (0.0, size, 1.9) if rng.random() < 0.5 else (round(width - size, 3), width, 1.9)
    low, high = (0.75, width - 0.75) if cut is None else _rest(cut, width)
    door = round(float(rng.uniform(low, high)), 2)
    drawn: tuple[tuple[float, float], ...] = ()
    if facade and windows and kind != "store":
        size = round(float(rng.uniform(0.8, max(0.9, width - 1.4))), 1)
        drawn = ((round(float(width / 2 + rng.uniform(-0.2, 0.2)), 2), size),)
    pieces = furnish(kind, width, style.depth, 0.0 if cut is None else cut[2], rng)
    kept = tuple(piece for piece in pieces if rng.random() < furniture)
    link = "opening" if kind in ("living room", "kitchen") and rng.random() < 0.5 else "door"
    door_width = 1.1 if link == "opening" or kind == "patient room" else 0.9
    return Design(kind, width, door, door_width, drawn, cut, kept, link)


def make_twins(
    designs: list[list[Design]], pairs: int, rng: np.random.Generator
) -> list[tuple[int, int]]:
    """Turn neighbours in a strip into identical rooms, in place; return (strip, first) of each.

    The two take their mean width, so that the strip keeps its length.
    """
    places = [(s, i) for s, row in enumerate(designs) for i in range(0, len(row) - 1, 2)]
    chosen = sorted(rng.permutation(len(places))[:pairs].tolist())
    for s, i in (places[k] for k in chosen):
        row = designs[s]
        mean = (row[i].width + row[i + 1].width) / 2
        model = max(row[i : i + 2], key=lambda design: design.width)
        row[i] = row[i + 1] = _narrowed(model, mean)
    return [places[k] for k in chosen]


def _narrowed(design: Design, width: float) -> Design:
    """Return a design made narrower: everything keeps its place but what no longer fits in."""
    cut = design.cut
    if cut is not None and width - (cut[1] - cut[0]) < 1.5:
        cut = None
    if cut is not None and cut[0] > 0:
        cut = (width - (cut[1] - cut[0]), width, cut[2])
    low, high = (0.75, width - 0.75) if cut is None else _rest(cut, width)
    windows = tuple((width / 2, min(size, width - 0.8)) for _, size in design.windows)
    pieces = tuple(p for p in design.pieces if max(box.upper[0] for box in p) < width - 0.1)
    door = float(np.clip(design.door, low, max(low, high)))
    return dataclasses.replace(
        design, width=width, door=door, cut=cut, windows=windows, pieces=pieces
    )


def _rest(cut: tuple[float, float, float], width: float) -> tuple[float, float]:
    """Range of u for the middle of a door beside the room cut out."""
    return (cut[1] + 0.65, width - 0.65) if cut[0] == 0.0 else (0.65, cut[0] - 0.65)


def _shares(style: Style) -> list[float]:
    total = sum(style.kinds.values())
    return [weight / total for weight in style.kinds.values()]


def furnish(
    kind: str, width: float, depth: float, cut: float, rng: np.random.Generator
) -> list[Piece]:
    """Return furniture that leaves the 1.4 m next to the corridor, and the middle, to walk in."""
    free = max(1.4, cut + 1.2)
    room = depth - free
    if kind in ("meeting room", "kitchen", "living room"):
        length, across = min(2.4, room - 0.6), min(1.2, width - 2.0)
        pieces = [table(width / 2, free + room / 2 - 0.2, max(across, 0.6), max(length, 0.8))]
        if kind == "kitchen":
            pieces.append(cabinet(width / 2, depth - 0.4, width - 0.6, 0.6, 0.9))
        return pieces
    if kind in ("patient room", "bedroom"):
        side = 0.15 + rng.uniform(0.0, 0.05)
        beds = [cabinet(side + 1.0, depth - 0.75, 2.0, 0.95, 0.55)]
        tall = cabinet(width - 0.4, free + 0.5, 0.55, 0.9, 1.9)
        return [*beds, tall]
    if kind == "bathroom":
        return [cabinet(width - 0.45, depth - 0.9, 0.7, 1.4, 0.55)]
    count = max(1, min(3, int((width - 0.4) // 2.0)))
    spaces = np.arange(count) * (width / count) + width / count / 2
    height = 1.9 if kind == "store" else 0.0
    pieces = [
        cabinet(u, depth - 0.5, 1.2, 0.6, height) if height else table(u, depth - 0.65, 1.5, 0.8)
        for u in spaces + rng.uniform(-0.1, 0.1, count)
    ]
    along = min(room - 1.6, float(rng.uniform(0.6, 1.8)))
    if along > 0.4:
        v = free + along / 2
        u = 0.35 if rng.random() < 0.5 else width - 0.35
        pieces.append(cabinet(u, v, 0.45, along, float(rng.uniform(0.8, 2.0))))
    return pieces
