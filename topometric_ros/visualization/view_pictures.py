"""The same view as PNG files, drawn without a display: from above at a slant, and as a plan."""

from __future__ import annotations

import io
from pathlib import Path
from typing import Any

import numpy as np

from topometric_ros.io.summaries import write_atomically
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.figures import map_figure
from topometric_ros.visualization.view import View, ViewPoints, colours_of, view_points
from topometric_ros.visualization.view_page import GRAPH_HEIGHT
from topometric_ros.voxels.palette import room_colours

_MOST_POINTS = 40_000
_INK = "#1d2228"


def save_pictures(view: View, folder: Path) -> list[Path]:
    """Write the pictures and return their paths.

    `rooms.png`, `agents.png` and `storeys.png` show the points without ceilings and the graph over
    them, agents and storeys only where there are several; `plan.png` every storey from above.
    """
    folder.mkdir(parents=True, exist_ok=True)
    kinds = ["room"]
    kinds += ["agent"] if len(view.agents) > 1 else []
    kinds += ["storey"] if len(view.map.storeys) > 1 else []
    points = view_points(view, _MOST_POINTS)
    pictures = {f"{kind}s.png": _scene(view.map, points, kind) for kind in kinds}
    plan = map_figure(view.map)
    if plan is not None:
        pictures["plan.png"] = plan
    for name, data in pictures.items():
        write_atomically(folder / name, data)
    return [folder / name for name in pictures]


def _scene(m: TopometricMap, points: ViewPoints, by: str) -> bytes:
    """Return a picture of the points in 3D with the graph."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 7.5))
    FigureCanvasAgg(figure)
    axes: Any = figure.add_subplot(projection="3d", computed_zorder=False)
    low = ~points.upper
    shown = points.xyz[low].astype(float)
    colours = colours_of(points, by)[low] / 255.0
    axes.scatter(*shown.T, c=colours, s=3.0, linewidths=0, depthshade=False, zorder=1)
    _graph(axes, m)
    extent = np.ptp(shown, axis=0) if len(shown) else np.ones(3)
    axes.set_box_aspect(np.maximum(extent, 0.05 * extent.max()), zoom=1.25)
    axes.view_init(elev=55, azim=-65)
    axes.set_xlabel("x (m)")
    axes.set_ylabel("y (m)")
    axes.set_zticks([round(storey.floor_z, 1) for storey in m.storeys])
    if by == "agent":
        for name, colour in points.classes:
            axes.scatter([], [], [], color=np.array(colour) / 255.0, label=name)
        axes.legend(loc="upper left", frameon=False)
    stream = io.BytesIO()
    # No software name or date: equal pictures have equal bytes.
    figure.savefig(stream, format="png", dpi=120, bbox_inches="tight", metadata={"Software": None})
    return stream.getvalue()


def _graph(axes: Any, m: TopometricMap) -> None:
    floors = {storey.id: storey.floor_z for storey in m.storeys}
    nodes = {r.id: (*r.centroid[:2], floors[r.storey] + GRAPH_HEIGHT) for r in m.rooms}
    for passage in m.passages:
        ends = [nodes[room] for room in passage.rooms]
        middle = (*passage.position[:2], (ends[0][2] + ends[1][2]) / 2)
        axes.plot(*np.array([ends[0], middle, ends[1]]).T, color=_INK, lw=1.2, zorder=2)
    for room_id, node in nodes.items():
        colour = room_colours([room_id])[0] / 255.0
        axes.plot(*node, "o", ms=6, mfc=colour, mec=_INK, mew=0.8, zorder=3)
        axes.text(*node, f" {room_id}", size=8, color=_INK, zorder=4)
