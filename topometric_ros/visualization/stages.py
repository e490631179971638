"""Pictures of the extraction's stages, as the figures of the thesis show them (§4.2.4-4.2.8).

Every function draws from the map alone: it carries the navigable volume and the viewpoints, and
what follows from them is computed again. Each returns PNG bytes, the same for the same input.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.extraction.similarity import cluster_visibilities
from topometric_ros.extraction.viewpoints import horizontal_distance_field
from topometric_ros.extraction.visibility import Visibilities, jaccard, visibilities
from topometric_ros.topometric_map import NO_ROOM, TopometricMap
from topometric_ros.visualization.figures import draw_paper, hex_colour, map_figure
from topometric_ros.visualization.page import number
from topometric_ros.visualization.plan import Plan
from topometric_ros.visualization.sheet import INK, Sheet, bounds_of
from topometric_ros.visualization.similarity_matrix import matrix_figure
from topometric_ros.visualization.view import ViewError, point_storeys
from topometric_ros.voxels.grid import VoxelGrid
from topometric_ros.voxels.palette import room_colours

STAGES = ("navigable", "distance", "isovist", "similarity", "rooms", "matches", "trajectories")

EYE = "#d1003f"
NAVIGABLE = "#44aa99"
_SEEN_FLOOR = "#f6d99a"
SEEN = "#c25b00"
_UNSEEN_WALL = "#a9afb6"
_FEWEST_IN_WALL = 4
"""Seen voxels of a column that make it a wall and not floor, ceiling or the edge of a table."""
_STEPS = 5
"""Colours of the distance field that the legend explains."""
DRAWN = 0.1
"""Edges of the similarity graph with a smaller Jaccard index are not drawn; most are tiny."""


class Stages:
    """A map with what its viewpoints see, computed once for all stages that need it."""

    def __init__(self, m: TopometricMap, config: ExtractionConfig) -> None:
        self.map = m
        self.config = config

    @cached_property
    def seen(self) -> Visibilities:
        """What every viewpoint sees (eq. 30)."""
        if not len(self.map.viewpoints):
            raise ViewError("the map holds no viewpoints")
        grid = VoxelGrid(self.map.voxels, np.asarray(self.map.origin), self.map.voxel_size)
        eyes = self.map.viewpoints.astype(np.float64)
        return visibilities(grid, eyes, self.config.views.visibility)

    @cached_property
    def similarity(self) -> NDArray[np.float64]:
        """Jaccard index of every two views (K, K)."""
        return jaccard(self.seen)

    @cached_property
    def clusters(self) -> NDArray[np.int32]:
        """Cluster of every view (K,)."""
        return cluster_visibilities(self.seen, self.config.views.similarity)

    @cached_property
    def distance(self) -> NDArray[np.float64]:
        """Horizontal distance from each navigable voxel to the edge of all of them: (N,), m."""
        m = self.map
        if not len(m.navigable):
            raise ViewError("the map holds no navigable voxels")
        steps = horizontal_distance_field(m.navigable, self.config.viewpoints.step)
        return np.asarray(steps * m.voxel_size, np.float64)

    def pictures(self, stage: str) -> dict[str, bytes]:
        """Return the pictures of a stage, by their names; not of `matches` and `trajectories`.

        Raises
        ------
        ViewError
            The map does not hold what the stage shows.
        """
        draw: Mapping[str, Callable[[], dict[str, bytes]]] = {
            "navigable": lambda: {"navigable": navigable_figure(self.map)},
            "distance": lambda: {"distance": distance_figure(self.map, self.distance, self.config)},
            "isovist": lambda: {"isovist": isovist_figure(self.map, self.seen, self.config)},
            "similarity": self._similarity,
            "rooms": self._rooms,
        }
        try:
            return draw[stage]()
        except ViewError as error:
            raise ViewError(f"stage {stage}: {error}") from error

    def _similarity(self) -> dict[str, bytes]:
        similarity, clusters = self.similarity, self.clusters
        return {
            "similarity": matrix_figure(similarity, clusters),
            "similarity_graph": graph_figure(self.map, similarity, clusters, self.config),
        }

    def _rooms(self) -> dict[str, bytes]:
        picture = map_figure(self.map) if self.map.rooms else None
        if picture is None:
            raise ViewError("the map holds no rooms")
        return {"rooms": picture}


def navigable_figure(m: TopometricMap) -> bytes:
    """Draw the navigable volume over the floor plan (§4.2.4), cell by cell: gaps are its own."""
    if not len(m.navigable):
        raise ViewError("the map holds no navigable voxels")
    sheet, area = Sheet(), 0.0
    storeys = navigable_storeys(m)
    for plan, pose, index in draw_paper(sheet, m):
        standing, _ = _columns(m, plan, m.navigable[storeys == index])
        area += standing.sum() * plan.cell**2
        image = np.zeros((*standing.shape, 4), dtype=np.uint8)
        image[standing] = *(round(255 * value) for value in _rgb_of(NAVIGABLE)), 255
        sheet.raster(image, plan.origin, plan.cell, pose, order=1.5)
    name = f"navigable volume, {number(area, 0, 'm²')}"
    sheet.legend([("walls", INK, "patch"), (name, NAVIGABLE, "patch")])
    return sheet.png()


def distance_figure(
    m: TopometricMap, distance: NDArray[np.float64], config: ExtractionConfig
) -> bytes:
    """Draw the horizontal distance field with the viewpoints (§4.2.5-4.2.6, figures 7 and 8).

    `distance` (N,), m, is that of each navigable voxel.
    """
    from matplotlib import colormaps

    sheet, colours = Sheet(), colormaps["viridis"]
    storeys = navigable_storeys(m)
    eye_storeys = eye_storeys_of(m, config)
    for plan, pose, index in draw_paper(sheet, m):
        here = storeys == index
        standing, values = _columns(m, plan, m.navigable[here], distance[here])
        image = np.round(colours(values / distance.max()) * 255).astype(np.uint8)
        image[..., 3] = 255 * standing
        sheet.raster(image, plan.origin, plan.cell, pose, order=1.5)
        for eye in pose.apply(_xy(m)[eye_storeys == index]):
            sheet.dot(eye, EYE, 4.5 if len(m.viewpoints) < 200 else 3.0)
    steps = np.linspace(m.voxel_size, distance.max(), _STEPS)
    entries = [
        (
            ("to the edge " if k == 0 else "") + number(step, 1, "m"),
            hex_colour(_rgb(colours(step / distance.max()))),
            "patch",
        )
        for k, step in enumerate(steps)
    ]
    sheet.legend([*entries, (f"{len(m.viewpoints)} viewpoints", EYE, "dot")])
    return sheet.png()


def isovist_figure(m: TopometricMap, seen: Visibilities, config: ExtractionConfig) -> bytes:
    """Draw what the viewpoint that sees most voxels sees (§4.2.7)."""
    sheet = Sheet()
    best = int(np.argmax(seen.sizes()))
    rows = seen.rows(best)
    eye = m.viewpoints[best].astype(np.float64)
    storeys = _storeys_of(m, _heights(m, m.voxels[rows]))
    home, radius = eye_storeys_of(m, config)[best], config.views.visibility.radius
    for plan, pose, index in draw_paper(sheet, m, _UNSEEN_WALL):
        floor, count = _columns(m, plan, m.voxels[rows[storeys == index]])
        for mask, tint, order in (
            (floor, _SEEN_FLOOR, 1.5),
            (count >= _FEWEST_IN_WALL, SEEN, 3.0),
        ):
            sheet.mask(mask, plan.origin, plan.cell, pose, tint, order)
        if index == home:
            sheet.dot(pose.apply(eye[None, :2])[0], EYE, 7.0)
            circle = pose.apply(eye[:2] + _circle(radius))
            sheet.line(circle, EYE, 0.9)
            sheet.include(bounds_of(circle))
    sheet.legend(
        [
            (f"viewpoint, range {number(radius, 0, 'm')}", EYE, "dot"),
            ("walls seen", SEEN, "patch"),
            ("floor, ceiling seen", _SEEN_FLOOR, "patch"),
            ("other walls", _UNSEEN_WALL, "patch"),
        ]
    )
    return sheet.png()


def graph_figure(
    m: TopometricMap,
    similarity: NDArray[np.float64],
    clusters: NDArray[np.int32],
    config: ExtractionConfig,
) -> bytes:
    """Draw the similarity graph over the floor plan (figure 11): views by cluster.

    `similarity` (K, K) and `clusters` (K,) are of the map's viewpoints. Edges below a Jaccard
    index of 0.1 and those between storeys are not drawn.
    """
    sheet = Sheet()
    tints = [hex_colour(colour) for colour in room_colours(clusters)]
    storeys = eye_storeys_of(m, config)
    for _, pose, index in draw_paper(sheet, m):
        here = np.flatnonzero(storeys == index)
        places = dict(zip(here.tolist(), pose.apply(_xy(m)[here]), strict=True))
        weights = np.triu(similarity[np.ix_(here, here)], 1)
        pairs = np.argwhere(weights >= DRAWN)
        # The strongest last, so that they lie on top.
        for i, j in pairs[np.argsort(weights[tuple(pairs.T)], kind="stable")]:
            weight = weights[i, j]
            ends = [places[int(here[i])], places[int(here[j])]]
            shade = (*_rgb_of(INK), 0.12 + 0.6 * weight)
            sheet.line(ends, shade, 0.3 + 2.2 * weight)
        for view, place in places.items():
            sheet.dot(place, tints[view], 6.5)
    count = int(clusters.max()) + 1
    name = f"{len(clusters)} views, {count} clusters"
    edges = f"Jaccard index ≥ {DRAWN}"
    sheet.legend([(name, tints[0], "dot"), (edges, INK, "line")])
    return sheet.png()


def _columns(
    m: TopometricMap,
    plan: Plan,
    cells: NDArray[np.int32],
    values: NDArray[np.float64] | None = None,
) -> tuple[NDArray[np.bool_], NDArray[np.float64]]:
    """Return which columns (nx, ny) of a plan cells lie in, and their largest value or count."""
    low = np.round((np.asarray(plan.origin) - m.origin[:2]) / plan.cell).astype(np.int64)
    at = cells[:, :2] - low
    inside = ((at >= 0) & (at < plan.rooms.shape)).all(axis=1)
    place = tuple(at[inside].T)
    mask, result = np.zeros(plan.rooms.shape, bool), np.zeros(plan.rooms.shape)
    mask[place] = True
    if values is None:
        np.add.at(result, place, 1.0)
    else:
        np.maximum.at(result, place, values[inside])
    return mask, result


def navigable_storeys(m: TopometricMap) -> NDArray[np.uint8]:
    """Return the index of the storey that each navigable voxel lies on: (N,)."""
    return _storeys_of(m, _heights(m, m.navigable))


def _storeys_of(m: TopometricMap, z: NDArray[np.float64]) -> NDArray[np.uint8]:
    return point_storeys(m, z, np.full(len(z), NO_ROOM, np.int32))


def _heights(m: TopometricMap, cells: NDArray[np.int32]) -> NDArray[np.float64]:
    return m.origin[2] + cells[:, 2].astype(np.float64) * m.voxel_size


def _circle(radius: float) -> NDArray[np.float64]:
    angle = np.linspace(0.0, 2 * np.pi, 181)
    return radius * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _xy(m: TopometricMap) -> NDArray[np.float64]:
    return m.viewpoints[:, :2].astype(np.float64)


def eye_storeys_of(m: TopometricMap, config: ExtractionConfig) -> NDArray[np.uint8]:
    """Return the storey of the voxel that each viewpoint stands on: (K,)."""
    return _storeys_of(m, m.viewpoints[:, 2].astype(np.float64) - config.viewpoints.height)


def _rgb(colour: Sequence[float]) -> list[int]:
    return [round(255 * value) for value in colour[:3]]


def _rgb_of(colour: str) -> tuple[float, float, float]:
    red, green, blue = (int(colour[k : k + 2], 16) / 255 for k in (1, 3, 5))
    return red, green, blue
