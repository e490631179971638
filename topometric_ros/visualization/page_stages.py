"""What the page of a view shows of each stage, as JSON: points and numbers in base64.

The same as the pictures of `stages`, but in 3D: every viewpoint's isovist can be asked for, and
every cell of the similarity matrix be read.
"""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import Alignment
from topometric_ros.io.packing import varint_encode
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.agreement import level_transform
from topometric_ros.visualization.figures import hex_colour
from topometric_ros.visualization.page import number
from topometric_ros.visualization.stage_files import FileStages
from topometric_ros.visualization.stages import (
    DRAWN,
    NAVIGABLE,
    STAGES,
    eye_storeys_of,
    navigable_storeys,
)
from topometric_ros.visualization.trajectories import colour_of, legs_of, name_of, trajectories_of
from topometric_ros.visualization.view import ViewError, ViewPoints, single_view, view_points
from topometric_ros.voxels.palette import room_colours

_MOST_VIEWS = 400
"""More views are compared, and their isovists sought, only where the stage was asked for."""
_MOST_CELLS = 40_000
_MOST_IN_PAIR = 20_000
"""Points of either map of a pair."""
_ISOVISTS = 1_500_000
"""Bytes of all isovists together; where they are more, some viewpoints have none to show."""
_GAP = 2.0
"""Between the two maps of a pair, m."""


def page_stages(
    stages: FileStages, asked: Sequence[str] = ()
) -> tuple[dict[str, Any], list[ViewError]]:
    """Return what the page's script draws from, and an error for every stage that is missing.

    Parameters
    ----------
    stages : of the view that the page shows
    asked : stages that were asked for by name; none: all that cost little
    """
    make: dict[str, Callable[[], dict[str, Any]]] = {
        "rooms": lambda: _rooms(stages),
        "navigable": lambda: _navigable(stages),
        "distance": lambda: _distance(stages),
        "isovist": lambda: _isovist(stages, view_points(stages.view)),
        "similarity": lambda: _similarity(stages),
        "matches": lambda: _matches(stages),
        "trajectories": lambda: _trajectories(stages),
    }
    shown: dict[str, Any] = {}
    errors = []
    for name in STAGES:
        if asked and name not in (*asked, "rooms"):
            continue
        try:
            if not asked:
                _require_cheap(name, stages)
            stages.progress(f"preparing {name}")
            shown[name] = make[name]()
        except ViewError as error:
            shown[name] = {"missing": str(error).removeprefix(f"stage {name}: ")}
            errors.append(ViewError(f"{stages.source}: stage {name}: {shown[name]['missing']}"))
    return shown, errors


def _require_cheap(name: str, stages: FileStages) -> None:
    views = len(stages.view.map.viewpoints)
    if name == "matches":
        raise ViewError("not asked for; topometric view FILE --stage all shows them side by side")
    if name in ("isovist", "similarity") and views > _MOST_VIEWS:
        raise ViewError(f"{views:,} viewpoints take long; ask with --stage {name}")


def _rooms(stages: FileStages) -> dict[str, Any]:
    if not stages.view.map.rooms:
        return {"note": "The map holds no rooms."}
    return {"note": "Rooms and the topological graph."}


def _navigable(stages: FileStages) -> dict[str, Any]:
    m = stages.view.map
    if not len(m.navigable):
        raise ViewError("the map holds no navigable voxels")
    columns = np.column_stack([m.navigable[:, :2], navigable_storeys(m)])
    area = number(len(np.unique(columns, axis=0)) * m.voxel_size**2, 0, "m²")
    return {
        "note": f"What an agent can stand on: {area}.",
        "colour": NAVIGABLE,
        **_cells(stages),
    }


def _cells(stages: FileStages) -> dict[str, Any]:
    """Return navigable voxels, thinned evenly along the Morton order."""
    m = stages.view.map
    rows = slice(None, None, max(1, -(-len(m.navigable) // _MOST_CELLS)))
    xyz = np.asarray(m.origin) + m.navigable[rows] * m.voxel_size
    return {
        "xyz": base64_of(xyz.astype("<f4")),
        "storey": base64_of(navigable_storeys(m)[rows]),
        "distance": base64_of(stages.drawn.distance[rows].astype("<f4")),
    }


def _distance(stages: FileStages) -> dict[str, Any]:
    count = len(stages.view.map.viewpoints)
    return {
        "note": "Horizontal distance to the edge of the navigable volume, and the "
        f"{count:,} viewpoints at its maxima.",
        **_cells(stages),
        "eyes": _eyes(stages),
    }


def _eyes(stages: FileStages) -> dict[str, Any]:
    m = stages.view.map
    return {
        "xyz": np.round(m.viewpoints.astype(np.float64), 2).tolist(),
        "storey": eye_storeys_of(m, stages.drawn.config).tolist(),
    }


def _isovist(stages: FileStages, points: ViewPoints) -> dict[str, Any]:
    """Return which of the page's points viewpoints see, those that see most first.

    The rows of the points, sorted, as the difference of each to the one before less one, the first
    to -1: LEB128 varints, `sizes` bytes for each viewpoint of `of`.
    """
    seen, radius = stages.drawn.seen, stages.drawn.config.views.visibility.radius
    sizes = seen.sizes()
    kept: list[int] = []
    packed: list[NDArray[np.uint8]] = []
    left = _ISOVISTS
    for view in np.argsort(-sizes, kind="stable").tolist():
        rows = seen.rows(view)
        rows = rows[rows % points.step == 0] // points.step
        steps = np.diff(rows, prepend=-1) - 1
        packed.append(varint_encode(steps.astype(np.uint64)))
        left -= len(packed[-1])
        if left < 0 and kept:
            packed.pop()
            break
        kept.append(view)
    note = f"What one viewpoint sees within {number(radius, 1, 'm')}. Click on another one."
    if len(kept) < len(sizes):
        note += f" The {len(kept):,} of {len(sizes):,} that see most can be shown."
    return {
        "note": note,
        "radius": radius,
        "eyes": _eyes(stages),
        "of": kept,
        "seen": sizes.tolist(),
        "sizes": [len(part) for part in packed],
        "rows": base64_of(np.concatenate(packed)),
    }


def _similarity(stages: FileStages) -> dict[str, Any]:
    similarity, clusters = stages.drawn.similarity, stages.drawn.clusters
    count = int(clusters.max()) + 1
    return {
        "note": f"Jaccard index of every two of {len(clusters):,} views, in {count:,} clusters. "
        f"Lines join views of a storey from {DRAWN} on.",
        "eyes": _eyes(stages),
        "clusters": clusters.tolist(),
        "colours": [hex_colour(colour) for colour in room_colours(np.arange(count))],
        "order": np.argsort(clusters, kind="stable").tolist(),
        "drawn": DRAWN,
        "matrix": base64_of(np.round(similarity * 255).astype(np.uint8)),
    }


def _trajectories(stages: FileStages) -> dict[str, Any]:
    view = stages.view
    ways = [
        {
            "name": name_of(trajectory),
            "colour": colour_of(view, trajectory),
            "legs": [
                {"storey": storey, "path": np.round(places, 2).tolist()}
                for storey, places in legs_of(view.map, trajectory)
            ],
        }
        for trajectory in trajectories_of(view)
    ]
    return {"note": "Where the agents' sensors were; a dot marks the start.", "ways": ways}


def _matches(stages: FileStages) -> dict[str, Any]:
    alignments, maps = stages.matched
    pairs = []
    for alignment in alignments:
        a, b = (maps[agent] for agent in alignment.agents)
        sides = _sides(a, b, alignment)
        places = [{room["id"]: room["node"] for room in side["rooms"]} for side in sides]
        colours = room_colours([match.room_a for match in alignment.matches])
        links = [
            {
                "rooms": (match.room_a, match.room_b),
                "colour": hex_colour(colour),
                "path": [places[0][match.room_a], places[1][match.room_b]],
            }
            for match, colour in zip(alignment.matches, colours, strict=True)
        ]
        name = f"{' – '.join(alignment.agents)}: {alignment.status}, {len(links)} rooms matched"
        pairs.append({"name": name, "sides": sides, "links": links})
    return {"note": "Two agents' own maps; rooms held to be the same are joined.", "pairs": pairs}


def _sides(a: TopometricMap, b: TopometricMap, alignment: Alignment) -> list[dict[str, Any]]:
    """Return two maps next to each other, b turned as in a where there is a transform."""
    T = np.eye(4) if alignment.T_a_b is None else level_transform(a, b, alignment.T_a_b)
    points = [view_points(single_view(m), 2 * _MOST_IN_PAIR) for m in (a, b)]
    xyz = [p.xyz[~p.upper].astype(np.float64) for p in points]
    rooms = [p.room[~p.upper] for p in points]
    if not all(len(places) for places in xyz):
        raise ViewError("a map is empty")
    xyz[1] = xyz[1] @ T[:3, :3].T + T[:3, 3]
    # Beside the longer side, so that the two stay near each other.
    axis = int(np.argmin(np.ptp(xyz[0][:, :2], axis=0)))
    shift = np.zeros(3)
    shift[axis] = xyz[0][:, axis].max() - xyz[1][:, axis].min() + _GAP
    moves = (np.eye(4), T.copy())
    moves[1][:3, 3] += shift
    xyz[1] += shift
    return [
        _side(m, places, room, move)
        for m, places, room, move in zip((a, b), xyz, rooms, moves, strict=True)
    ]


def _side(
    m: TopometricMap,
    xyz: NDArray[np.float64],
    room: NDArray[np.int32],
    T_page_level: NDArray[np.float64],
) -> dict[str, Any]:
    nodes = np.array([r.centroid for r in m.rooms]).reshape(-1, 3)
    nodes = nodes @ T_page_level[:3, :3].T + T_page_level[:3, 3]
    top = float(xyz[:, 2].max())
    return {
        "agent": m.agent,
        "label": np.round([*xyz[:, :2].mean(axis=0), top + 2.5], 2).tolist(),
        "xyz": base64_of(xyz.astype("<f4")),
        "room": base64_of(room.astype("<i4")),
        "rooms": [
            {"id": entry.id, "node": np.round(node, 2).tolist()}
            for entry, node in zip(m.rooms, nodes, strict=True)
        ],
    }


def base64_of(array: NDArray[Any]) -> str:
    """Return an array's bytes as text."""
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode("ascii")
