"""Floor plans: a picture of the free floor extruded to walls, rooms from a segmented picture.

White (250 and more of 255) is free, everything else is wall. `NAME_gt_segmentation.png` beside
`NAME.png` has the rooms as white areas between dark lines; `NAME_furnitures.png` may be loaded in
place of `NAME.png` and adds furniture. This is how the plans of Bormann et al. 2016 are kept.
Frame: x along the picture's rows, y down its columns, z up: the mirror image of what is drawn, as
in the ready-made pairs.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from topometric_ros.errors import one_line
from topometric_ros.simulation.building import BuildingError
from topometric_ros.simulation.labelled import (
    STRUCTURE,
    LabelledBuilding,
    TrueLink,
    TrueRoom,
    join_rings,
)
from topometric_ros.simulation.outlines import simplify, trace_outlines

PIXEL = 0.05
"""Size of a pixel, m."""
_MOST_PIXELS = 80_000_000
"""440 m by 440 m; a picture of a few bytes may say that it has more than memory holds."""
CEILING = 2.7
FURNITURE = 0.9
"""Height that furniture is extruded to, m."""
_FREE = 250 / 255
_SMALLEST_ROOM = 1.0
"""Smaller white areas of a segmented picture are left-overs of drawing, m²."""
_NARROWEST_WAY, _WIDEST_DOOR = 0.4, 1.6
_SEAM = 3
"""How far the rooms on the two sides of a drawn line lie from its cells, pixels."""


def load_floor_plan(path: Path) -> LabelledBuilding:
    """Return the building of a floor plan.

    Raises
    ------
    BuildingError
        A picture is missing or unreadable, or the two differ in size.
    """
    plain = path.with_name(path.name.replace("_furnitures", ""))
    free = _free_cells(plain)
    segmented = _free_cells(plain.with_name(f"{plain.stem}_gt_segmentation.png"))
    if free.shape != segmented.shape:
        raise BuildingError(f"{path}: {free.shape} pixels, its rooms {segmented.shape}")
    labels = _room_cells(segmented)
    parts = [(*_shell(free), STRUCTURE)]
    if path != plain:
        furniture, _ = ndimage.label(free & ~_free_cells(path))
        for k, place in enumerate(ndimage.find_objects(furniture), start=1):
            corner = (place[0].start, place[1].start)
            parts.append((*_prism(furniture[place] == k, corner, FURNITURE), k))
    vertices = np.concatenate([part[0] for part in parts])
    ends = np.cumsum([0, *(len(part[0]) for part in parts[:-1])])
    faces = np.concatenate([part[1] + end for part, end in zip(parts, ends, strict=True)])
    tags = np.repeat([part[2] for part in parts], [len(part[1]) for part in parts])
    return LabelledBuilding(
        path.stem,
        vertices,
        faces.astype(np.int32),
        _rooms(labels),
        _links(free, labels),
        face_tag=tags.astype(np.int32),
    )


def _free_cells(path: Path) -> NDArray[np.bool_]:
    """Return where a picture is white: (X, Y) bool."""
    import matplotlib.image
    from PIL import Image

    try:
        with Image.open(path) as header:
            width, height = header.size
        if width * height > _MOST_PIXELS:
            raise BuildingError(f"{path}: {width} x {height} pixels, at most {_MOST_PIXELS} in all")
        picture = matplotlib.image.imread(path)
    except (OSError, SyntaxError, ValueError, Image.DecompressionBombError) as error:
        raise BuildingError(f"{path}: cannot be read: {one_line(error)}") from error
    grey = picture if picture.ndim == 2 else picture[..., : min(3, picture.shape[2])].min(axis=2)
    white: NDArray[np.bool_] = np.ascontiguousarray((grey >= _FREE).T)
    return white


def _room_cells(segmented: NDArray[np.bool_]) -> NDArray[np.int32]:
    """Return the room of each cell, -1 none; rooms in the order of the picture's rows."""
    areas = ndimage.label(segmented.T)[0].T
    sizes = np.bincount(areas.ravel())
    large = sizes >= _SMALLEST_ROOM / PIXEL**2
    large[0] = False
    ids = np.where(large, np.cumsum(large) - 1, -1)
    return ids[areas].astype(np.int32)


def _rooms(labels: NDArray[np.int32]) -> tuple[TrueRoom, ...]:
    rooms = []
    for k, place in enumerate(ndimage.find_objects(labels + 1)):
        corner = np.array([place[0].start, place[1].start])
        rings = [simplify(ring, 0.75) for ring in trace_outlines(labels[place] == k)]
        rings = [PIXEL * (ring + corner) for ring in rings]
        rooms.append(TrueRoom(k, f"room {k}", "room", 0, join_rings(rings), 0.0, CEILING))
    return tuple(rooms)


def _links(free: NDArray[np.bool_], labels: NDArray[np.int32]) -> tuple[TrueLink, ...]:
    """Ways through the lines that the segmentation draws across free floor.

    A line that meets three rooms and more is cut up among the pairs on its two sides.
    """
    seams, _ = ndimage.label(free & (labels < 0), np.ones((3, 3)))
    links: list[TrueLink] = []
    for k, place in enumerate(ndimage.find_objects(seams), start=1):
        window = tuple(slice(max(0, part.start - _SEAM), part.stop + _SEAM) for part in place)
        corner = np.array([part.start for part in window])
        seam, near = seams[window] == k, labels[window]
        reached = ndimage.binary_dilation(seam, np.ones((3, 3)), iterations=_SEAM)
        rooms = [int(room) for room in np.unique(near[reached]) if room >= 0]
        if len(rooms) == 2:
            links += _ways(seam, (rooms[0], rooms[1]), corner)
        elif len(rooms) > 2:
            size = 2 * _SEAM + 1
            lowest = ndimage.minimum_filter(np.where(near < 0, 1 << 30, near), size)
            highest = ndimage.maximum_filter(near, size)
            sides = np.stack([lowest, highest], axis=-1)
            for low, high in np.unique(sides[seam & (lowest < highest)], axis=0):
                cells = seam & (lowest == low) & (highest == high)
                links += _ways(cells, (int(low), int(high)), corner)
    return tuple(sorted(links, key=lambda link: (link.rooms, *link.position)))


def _ways(
    cells: NDArray[np.bool_], rooms: tuple[int, int], corner: NDArray[np.int64]
) -> list[TrueLink]:
    """Return a link for each connected piece of a line; a wide one is no door."""
    links = []
    pieces, count = ndimage.label(cells, np.ones((3, 3)))
    for piece in range(1, count + 1):
        found = np.argwhere(pieces == piece)
        width = PIXEL * float(np.max(np.ptp(found, axis=0) + 1))
        if width >= _NARROWEST_WAY:
            middle = found[np.argmin(((found - found.mean(axis=0)) ** 2).sum(axis=1))]
            x, y = PIXEL * (middle + corner + 0.5)
            kind = "door" if width <= _WIDEST_DOOR else "virtual"
            links.append(TrueLink(rooms, kind, np.array([x, y, 0.0]), width))
    return links


def _shell(free: NDArray[np.bool_]) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return walls round the free cells, and one floor and one ceiling over all of them."""
    vertices, faces = _sides(trace_outlines(free), 0.0, CEILING)
    occupied = np.argwhere(free)
    (x0, y0), (x1, y1) = PIXEL * occupied.min(axis=0), PIXEL * (occupied.max(axis=0) + 1)
    slabs = [(x, y, z) for z in (0.0, CEILING) for x, y in ((x0, y0), (x1, y0), (x1, y1), (x0, y1))]
    quads = np.array([(0, 1, 2), (0, 2, 3), (4, 6, 5), (4, 7, 6)]) + len(vertices)
    return np.concatenate([vertices, slabs]), np.concatenate([faces, quads])


def _prism(
    cells: NDArray[np.bool_], corner: tuple[int, int], height: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return a solid on the floor: its sides, and a lid of one rectangle for each run of cells."""
    rings = [ring + corner for ring in trace_outlines(cells)]
    vertices, faces = _sides(rings, 0.0, height)
    lids = []
    for x, column in enumerate(cells):
        steps = np.flatnonzero(np.diff(np.pad(column, 1).astype(np.int8)))
        for y0, y1 in steps.reshape(-1, 2) + corner[1]:
            x0 = x + corner[0]
            lids += [(x0, y0), (x0 + 1, y0), (x0 + 1, y1), (x0, y1)]
    lid = np.column_stack([PIXEL * np.array(lids), np.full(len(lids), height)])
    first = len(vertices) + 4 * np.arange(len(lids) // 4)[:, None, None]
    quads = (first + np.array([(0, 1, 2), (0, 2, 3)])).reshape(-1, 3)
    return np.concatenate([vertices, lid]), np.concatenate([faces, quads])


def _sides(
    rings: list[NDArray[np.float64]], low: float, high: float
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Return upright rectangles along rings (cells): vertices (V, 3), m, and faces (F, 3)."""
    vertices, faces, start = [], [], 0
    for ring in rings:
        count = len(ring)
        below = np.column_stack([PIXEL * ring, np.full(count, low)])
        vertices += [below, below + (0.0, 0.0, high - low)]
        a = np.arange(count)
        b = np.roll(a, -1)
        faces += [
            start + np.column_stack([a, b, b + count]),
            start + np.column_stack([a, b + count, a + count]),
        ]
        start += 2 * count
    return np.concatenate(vertices), np.concatenate(faces)
