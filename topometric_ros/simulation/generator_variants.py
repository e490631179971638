"""Variants of a made building that look like it and are another place: what must not be merged.

Alike rooms along a corridor, the same rooms with other furniture (an identical flat or storey, or
another day) and the mirror image of a whole building.
"""

from __future__ import annotations

import dataclasses
from dataclasses import replace

import numpy as np

from topometric_ros.simulation.building import Box
from topometric_ros.simulation.generator_rooms import Design, Piece, Style, furnish
from topometric_ros.simulation.labelled import LabelledBuilding

_CARELESS = 0.15
"""How far from where it was meant a piece of furniture is put, m along either wall."""

_GAP = 0.05
"""Nearest that it comes to a wall, m."""


def make_alike(designs: list[list[Design]], share: float, rng: np.random.Generator) -> None:
    """Turn a share of the rooms of each strip into copies of one of them, in place.

    The rooms of a strip must be equally wide.
    """
    for row in designs:
        chosen = rng.permutation(len(row))[: round(share * len(row))].tolist()
        for place in chosen[1:]:
            row[place] = row[chosen[0]]


def refurnished(
    designs: list[list[Design]], style: Style, kept: float, rng: np.random.Generator
) -> list[list[Design]]:
    """Return the same rooms with furniture drawn anew, each room's own, half of them mirrored.

    Nobody places furniture to the centimetre: each piece is up to 15 cm off where it is drawn.

    Parameters
    ----------
    kept : share of the furniture that is not left out
    """
    result = []
    for row in designs:
        other = []
        for design in row:
            deep = 0.0 if design.cut is None else design.cut[2]
            pieces = furnish(design.kind, design.width, style.depth, deep, rng)
            turned = rng.random() < 0.5
            room = (design.width, style.depth)
            pieces = [
                _put_down(
                    tuple(_flipped(box, design.width) if turned else box for box in piece),
                    room,
                    rng,
                )
                for piece in pieces
                if rng.random() < kept
            ]
            other.append(dataclasses.replace(design, pieces=tuple(pieces)))
        result.append(other)
    return result


def mirrored(building: LabelledBuilding) -> LabelledBuilding:
    """Return the mirror image of a building of triangles, x to -x."""
    flip = np.array([-1.0, 1.0, 1.0])
    return replace(
        building,
        name=f"{building.name}_mirrored",
        vertices=building.vertices * flip,
        faces=np.ascontiguousarray(building.faces[:, ::-1]),
        rooms=tuple(replace(r, polygon=r.polygon[::-1] * flip[:2]) for r in building.rooms),
        links=tuple(replace(link, position=link.position * flip) for link in building.links),
    )


def _put_down(piece: Piece, room: tuple[float, float], rng: np.random.Generator) -> Piece:
    """Return a piece a little beside where it was meant to stand, within the room."""
    low = np.min([box.lower[:2] for box in piece], axis=0)
    high = np.max([box.upper[:2] for box in piece], axis=0)
    shift = rng.uniform(-_CARELESS, _CARELESS, 2)
    u, v = np.clip(
        shift, np.minimum(_GAP - low, 0.0), np.maximum(np.array(room) - _GAP - high, 0.0)
    )
    return tuple(
        Box(
            (box.lower[0] + u, box.lower[1] + v, box.lower[2]),
            (box.upper[0] + u, box.upper[1] + v, box.upper[2]),
        )
        for box in piece
    )


def _flipped(box: Box, width: float) -> Box:
    (x0, y0, z0), (x1, y1, z1) = box.lower, box.upper
    return Box((width - x1, y0, z0), (width - x0, y1, z1))
