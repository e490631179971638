"""Blocks, lobbies and stairs put together to one labelled building."""

from __future__ import annotations

from collections import Counter

import numpy as np
from numpy.typing import NDArray

from topometric_ros.simulation.building import Box, BuildingConfig, box_mesh, make_building
from topometric_ros.simulation.generator_layouts import Strip
from topometric_ros.simulation.generator_storey import (
    Block,
    flights,
    half_landing,
    landing,
    room_polygon,
)
from topometric_ros.simulation.generator_wings import (
    WingFrame,
    offset_convex,
    prism,
    wall_along,
)
from topometric_ros.simulation.labelled import STRUCTURE, LabelledBuilding, TrueLink, TrueRoom


class Assembly:
    """Collects triangles, rooms and links, storey by storey from the lowest."""

    def __init__(self, name: str, config: BuildingConfig, storeys: int) -> None:
        self._name, self._config, self._storeys = name, config, storeys
        self._height = config.ceiling + config.slab
        self._rooms: list[TrueRoom] = []
        self._links: list[TrueLink] = []
        self._meshes: list[tuple[NDArray[np.float64], NDArray[np.int64]]] = []
        self._tags: list[int] = []
        self._names: Counter[tuple[str, int]] = Counter()
        self._well = -1
        self._count = 0
        self._pieces = 0

    def add_block(
        self, block: Block, storey: int, frame: WingFrame | None, stairs: Strip | None
    ) -> int:
        """Add a block of a storey and return the id of its corridor; `stairs` has the stairwell."""
        config, floor, first = self._config, storey * self._height, len(self._rooms)
        below, above = storey > 0, storey + 1 < self._storeys
        well = (1,) if stairs is not None else ()
        building = make_building(
            tuple(block.kinds),
            tuple(block.areas),
            tuple(block.openings),
            (),
            config,
            without_floor=well if below else (),
            without_ceiling=well if above else (),
        )
        boxes = list(building.structure)
        if stairs is not None and above:
            boxes += flights(stairs, self._height, config.wall)
        if stairs is not None and below:
            boxes.append(landing(stairs))
        self._add_boxes(boxes, floor, frame, STRUCTURE)
        for piece in block.pieces:
            self._pieces += 1
            self._add_boxes(list(piece), floor, frame, self._pieces)
        self._add_rooms(block, storey, frame)
        if stairs is not None:
            if below:
                turn = np.array([*half_landing(stairs), floor - self._height / 2])
                self._links.append(TrueLink((self._well, first + 1), "stair", turn, 1.1))
            self._well = first + 1
        return first

    def add_lobby(self, frame: WingFrame, storey: int, corridors: tuple[int, int]) -> None:
        """Add the lobby between two corridors, open to both."""
        config, floor = self._config, storey * self._height
        corners, wall = frame.lobby, self._config.wall
        ceiling = floor + config.ceiling
        slab = offset_convex(corners, -wall / 2)
        self._add_mesh(*prism(slab, floor - config.slab, floor), STRUCTURE)
        self._add_mesh(*prism(slab, ceiling, ceiling + config.slab), STRUCTURE)
        for start, end in ((0, 1), (3, 2)):
            plan = wall_along(corners[start], corners[end], wall)
            self._add_mesh(*prism(plan, floor, ceiling), STRUCTURE)
        lobby = self._add_room("lobby", storey, offset_convex(corners, wall / 2))
        width = float(np.hypot(*(corners[3] - corners[0]))) - 0.4
        for corridor, ends in zip(corridors, ((3, 0), (1, 2)), strict=True):
            place = np.array([*corners[list(ends)].mean(axis=0), floor])
            self._links.append(TrueLink((corridor, lobby), "opening", place, width))

    def finish(self) -> LabelledBuilding:
        """Return the building."""
        vertices, faces = zip(*self._meshes, strict=True)
        return LabelledBuilding(
            self._name,
            np.concatenate(vertices),
            np.concatenate(faces).astype(np.int32),
            tuple(self._rooms),
            tuple(self._links),
            face_tag=np.repeat(self._tags, [len(mesh[1]) for mesh in self._meshes]).astype(
                np.int32
            ),
        )

    def _add_rooms(self, block: Block, storey: int, frame: WingFrame | None) -> None:
        """Add the rooms of a block and the links between them."""
        floor, first = storey * self._height, len(self._rooms)
        for room, kind in enumerate(block.kinds):
            rectangles = [area.bounds for area in block.areas if area.room == room]
            polygon = room_polygon(rectangles, self._config.wall)
            self._add_room(kind, storey, polygon if frame is None else frame.place(polygon))
        for a, b, kind, position, width in block.links:
            place = np.array([*position, floor])
            place = place if frame is None else frame.place(place)
            self._links.append(TrueLink((first + a, first + b), kind, place, width))

    def _add_room(self, kind: str, storey: int, polygon: NDArray[np.float64]) -> int:
        """Add a room, numbered among those of its kind on its storey."""
        self._names[kind, storey] += 1
        name = f"{kind} {storey}.{self._names[kind, storey]}"
        floor, room = storey * self._height, len(self._rooms)
        ceiling = floor + self._config.ceiling
        self._rooms.append(TrueRoom(room, name, kind, storey, polygon, floor, ceiling))
        return room

    def _add_boxes(self, boxes: list[Box], floor: float, frame: WingFrame | None, tag: int) -> None:
        vertices, faces = box_mesh(boxes)
        if frame is not None:
            vertices = frame.place(vertices)
        self._add_mesh(vertices + (0.0, 0.0, floor), faces, tag)

    def _add_mesh(self, vertices: NDArray[np.float64], faces: NDArray[np.int64], tag: int) -> None:
        self._meshes.append((vertices, faces + self._count))
        self._tags.append(tag)
        self._count += len(vertices)
