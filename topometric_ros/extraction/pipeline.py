"""From a cloud to a topometric map: the stages of extraction strung together and timed."""

from __future__ import annotations

import dataclasses
import itertools
import logging
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.extraction import default_rooms, thesis_rooms
from topometric_ros.extraction.assemble import assemble_rooms, majority, storeys_of_rooms
from topometric_ros.extraction.assess import assess
from topometric_ros.extraction.columns import sort_columns
from topometric_ros.extraction.config import ExtractionConfig
from topometric_ros.extraction.floor_gaps import close_gaps
from topometric_ros.extraction.layers import refine_floor, storey_layers
from topometric_ros.extraction.mapped_rooms import MappedRooms
from topometric_ros.extraction.navigation import navigable_volume, on_storeys, unobstructed
from topometric_ros.extraction.overhead import is_overhead
from topometric_ros.extraction.passages import passages_of
from topometric_ros.extraction.quality import Quality
from topometric_ros.extraction.room_kinds import RoomClassifier, load_classifier
from topometric_ros.extraction.scene import Scene, make_scene
from topometric_ros.extraction.stairs import flights
from topometric_ros.extraction.storeys import RASTER
from topometric_ros.extraction.viewpoints import viewpoints
from topometric_ros.stopwatch import Stopwatch
from topometric_ros.topometric_map import Storey, TopometricMap, triple
from topometric_ros.voxels.grid import in_morton_order, offsets_of_means

logger = logging.getLogger(__name__)


@dataclass(frozen=True)
class Extraction:
    """A map, what it took and how good it is: `timings` holds CPU seconds of this thread by stage.

    The warnings among the findings of `quality` are those of the map.
    """

    map: TopometricMap
    timings: dict[str, float]
    quality: Quality


def extract(
    points: NDArray[np.float64],
    config: ExtractionConfig,
    *,
    agent: str = "agent",
    session: str = "",
    sequence: int = 0,
    frame_id: str = "map",
    stamp: int = 0,
    origin: tuple[float, float, float] | None = None,
    T_level_input: NDArray[np.float64] | None = None,
    way: NDArray[np.float64] | None = None,
    classifier: RoomClassifier | None = None,
    thinned: bool = False,
) -> Extraction:
    """Extract a topometric map from a cloud.

    Parameters
    ----------
    points : (P, 3) float64, m, input frame, finite
    config : ExtractionConfig
    agent, session, sequence, frame_id, stamp : copied into the map
    origin : m, level frame, of the lattice of an earlier map of this session. By default x and y
        are 0 and z lies on the lowest floor, so that a layer of cell centres does.
    T_level_input : (4, 4) of an earlier map of this session; estimated by default
    way : (K, 3) float64, m, input frame, where the sensor was, in order; not known by default
    classifier : tells kinds of rooms and joins cuts of corridors; by default the one that
        `kinds.classifier` names
    thinned : whether there is but one point a cell of 5 cm, or half a voxel, as of gathered scans

    Returns
    -------
    Extraction; a voxel has no room where its column lies too far from every room or
    behind its walls (preset `default`) or no view reached it (preset `thesis`)

    Raises
    ------
    ExtractionError
        No points, or no floor with z up.
    """
    watch = Stopwatch()
    classifier = load_classifier(config.kinds.classifier) if classifier is None else classifier
    scene = make_scene(points, config, origin, T_level_input, watch, thinned)
    grid = scene.grid
    with watch.stage("navigation"):
        navigable = _navigable(scene, config, way)
    room, eyes = _rooms(scene, navigable, config, classifier, watch)
    storey = scene.per_voxel(scene.storey_of_raster)
    with watch.stage("layers"):
        found = _mapped(scene, room, storey, navigable, config)
    with watch.stage("passages"):
        passages = passages_of(found, config.passages)
    with watch.stage("assemble"):
        rooms = assemble_rooms(found, passages, classifier)
    result = TopometricMap(
        agent=agent,
        session=session,
        sequence=sequence,
        frame_id=frame_id,
        stamp=stamp,
        voxel_size=grid.voxel_size,
        origin=triple(grid.origin),
        voxels=grid.coords,
        offsets=found.offsets,
        room=room,
        navigable=navigable,
        viewpoints=eyes.astype(np.float32),
        rooms=rooms,
        passages=passages,
        storeys=found.storeys,
        T_level_input=scene.T_level_input,
    )
    with watch.stage("quality"):
        quality = _quality(result, scene, storey, config)
    result = dataclasses.replace(result, warnings=quality.warnings())
    return Extraction(result, watch.seconds, quality)


def _navigable(
    scene: Scene, config: ExtractionConfig, way: NDArray[np.float64] | None
) -> NDArray[np.int32]:
    """Return the navigable volume: what was seen of it, and what closes its gaps."""
    grid, storeys, stick = scene.grid, scene.storeys, config.navigation
    free = unobstructed(grid, stick, scene.columns_of_grid)
    overhead = is_overhead(scene.columns)
    if overhead.any():
        free &= scene.per_voxel(overhead.astype(np.int32)) == 0
    navigable = navigable_volume(grid, stick, free)
    navigable = on_storeys(navigable, grid, storeys, stick)
    if way is not None:
        way = way @ scene.T_level_input[:3, :3].T + scene.T_level_input[:3, 3]
    if stick.treads and len(storeys) > 1:
        columns = scene.columns_of_grid or sort_columns(grid.coords)
        pairs = itertools.pairwise(storeys)
        found = [
            grid.coords[rows]
            for lower, upper in pairs
            for rows, _ in flights(
                grid, columns, lower.floor, upper.floor, lower.ceiling, config.passages.stairs
            )
        ]
        navigable = in_morton_order(np.concatenate([navigable, *found]))
    return close_gaps(navigable, grid.coords[free], grid, storeys, stick, way)


def _rooms(
    scene: Scene,
    navigable: NDArray[np.int32],
    config: ExtractionConfig,
    classifier: RoomClassifier,
    watch: Stopwatch,
) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Return the room of every voxel and the viewpoints."""
    with watch.stage("viewpoints"):
        eyes = viewpoints(navigable, scene.grid, config.viewpoints)
    with watch.stage("rooms"):
        if config.method == "visibility":
            room = thesis_rooms.segment(scene.grid, navigable, eyes, config.views)
        else:
            of_point = default_rooms.segment(
                scene.columns,
                scene.heights,
                scene.storeys,
                scene.storey_of_raster,
                (scene.points[:, :2] - scene.grid.origin[:2]) / RASTER,
                scene.raster_of_point,
                config.narrowings,
                classifier,
            )
            room = majority(scene.cell_of_point, of_point)
    return room, eyes


def _mapped(
    scene: Scene,
    room: NDArray[np.int32],
    storey: NDArray[np.int32],
    navigable: NDArray[np.int32],
    config: ExtractionConfig,
) -> MappedRooms:
    """Bring rooms, their storeys and what the voxels' points are like together."""
    return MappedRooms(
        scene.grid,
        offsets_of_means(scene.means_of_grid, scene.grid),
        room,
        navigable,
        storeys_of_rooms(room, storey),
        _map_storeys(scene, config),
        scene.columns_of_grid,
    )


def _map_storeys(scene: Scene, config: ExtractionConfig) -> tuple[Storey, ...]:
    """Describe the storeys with their bird's-eye layers."""
    # A ceiling seen from below is no floor of the storey above.
    overhead = is_overhead(scene.columns)
    points = scene.points[~overhead[scene.raster_of_point]] if overhead.any() else scene.points
    floors = [refine_floor(points, s.floor, config.layers) for s in scene.storeys]
    layers = storey_layers(points, floors, config.layers)
    return tuple(
        Storey(index, floor, found.ceiling if found.ceiling_seen else None, of_storey)
        for index, (floor, found, of_storey) in enumerate(
            zip(floors, scene.storeys, layers, strict=True)
        )
    )


def _quality(
    m: TopometricMap, scene: Scene, storey: NDArray[np.int32], config: ExtractionConfig
) -> Quality:
    """Measure what came out, and log what looks wrong."""
    quality = assess(
        m,
        scene.points,
        scene.columns,
        scene.raster.coords,
        scene.storeys,
        storey,
        config.method,
    )
    findings = (*scene.findings, *quality.findings)
    for finding in findings:
        level = logging.WARNING if finding.is_warning else logging.INFO
        logger.log(level, "%s: %s", m.agent, finding)
    return dataclasses.replace(quality, tilt=scene.tilt, findings=findings)
