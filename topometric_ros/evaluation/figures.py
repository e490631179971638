"""Pictures of an evaluation: found rooms with the true rooms over them, and how far the confidence
can be relied on."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.evaluation.metrics_fusion import ReliabilityBin, reliability, upper_bound
from topometric_ros.topometric_map import Room, TopometricMap
from topometric_ros.visualization.figures import draw_map
from topometric_ros.visualization.plan import storey_plan
from topometric_ros.visualization.sheet import INK, PAPER, Sheet
from topometric_ros.voxels.palette import agent_colour

TRUTH = "#d1003f"
_SMALLEST = 1.0
"""Slivers of true rooms, seen through doors, that cover less (m²) get no outline."""
_SPAN = 0.3
"""A room's lowest voxels may lie this far below its storey's floor, m."""


def rooms_over_truth(m: TopometricMap, true_room: NDArray[np.int32]) -> bytes | None:
    """Draw a map with its topological graph and outline the true rooms (N,) of its voxels.

    None where the map is empty.
    """
    sheet = Sheet()
    placed = draw_map(sheet, m)
    if not placed:
        return None
    truth = _with_true_rooms(m, true_room)
    for plan, pose in placed:
        true = storey_plan(truth, plan.storey)
        for room in np.unique(true.rooms[true.rooms >= 0]).tolist():
            mask = true.rooms == room
            if mask.sum() * true.cell**2 >= _SMALLEST:
                sheet.outline(mask, true.origin, true.cell, pose, TRUTH, 1.8)
    sheet.legend([("walls", INK, "patch"), ("true rooms", TRUTH, "line")])
    return sheet.png(width=8.0)


def _with_true_rooms(m: TopometricMap, true_room: NDArray[np.int32]) -> TopometricMap:
    """Return the map with the true rooms in place of the found ones, each on its storey."""
    z = m.centres()[:, 2]
    storeys = sorted(m.storeys, key=lambda storey: storey.floor_z)
    rooms = []
    for room in np.unique(true_room[true_room >= 0]).tolist():
        height = float(np.quantile(z[true_room == room], 0.02)) + _SPAN
        below = [storey for storey in storeys if storey.floor_z <= height] or storeys[:1]
        nowhere = (0.0, 0.0, 0.0)
        rooms.append(Room(room, below[-1].id, nowhere, (nowhere, nowhere), 0, 0.0, True))
    return dataclasses.replace(
        m, room=true_room.astype(np.int32), rooms=tuple(rooms), passages=(), descriptors=()
    )


def reliability_figure(
    forecasts: Mapping[str, tuple[Sequence[float], Sequence[bool]]],
) -> bytes | None:
    """Draw how often alignments are right over the confidence that they were accepted with.

    `forecasts` holds the confidences and outcomes of every preset. Each mark is a tenth of the
    scale with its N and its 95 % interval (Clopper & Pearson 1934); None without any.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    if not any(len(confidences) for confidences, _ in forecasts.values()):
        return None
    figure = Figure(figsize=(6.2, 4.8), facecolor=PAPER, dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.add_subplot()
    axes.plot([0, 1], [0, 1], color="#9aa5b1", lw=1.2, ls="--", label="right as often as it says")
    for k, (preset, (confidences, right)) in enumerate(forecasts.items()):
        bins = reliability(confidences, right)
        _draw_bins(axes, bins, k, f"{preset} (N = {len(confidences)})")
    axes.set_xlim(0.0, 1.04)
    axes.set_ylim(0.0, 1.1)
    axes.set_xlabel("confidence of the accepted alignment")
    axes.set_ylabel("share that is right")
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(loc="upper left", frameon=False)
    stream = io.BytesIO()
    # No software name or date: equal pictures have equal bytes.
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _draw_bins(axes: Any, bins: Sequence[ReliabilityBin], index: int, label: str) -> None:
    """Draw the marks of one preset; those of the next one lie a little beside them."""
    colour = np.array(agent_colour(index)) / 255.0
    x = [b.confidence + 0.008 * index for b in bins]
    right = [round(b.right * b.count) for b in bins]
    counts = list(zip(bins, right, strict=True))
    low = [b.right - (1 - upper_bound(b.count - hits, b.count, 0.975)) for b, hits in counts]
    high = [upper_bound(hits, b.count, 0.975) - b.right for b, hits in counts]
    y = [b.right for b in bins]
    bars = {"fmt": "o-", "ms": 6, "lw": 1.4, "elinewidth": 1.2, "capsize": 3}
    axes.errorbar(x, y, yerr=[low, high], color=colour, label=label, **bars)
    for at, b in zip(x, bins, strict=True):
        place, shift = (at, b.right), (5, 6 - 18 * index)
        axes.annotate(
            str(b.count), place, xytext=shift, textcoords="offset points", color=colour, size=8
        )
