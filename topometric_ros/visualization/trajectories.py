"""Where agents walked, over the map that they made: for the stage and for the page."""

from __future__ import annotations

import itertools
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from topometric_ros.io.trajectories import AgentTrajectory
from topometric_ros.topometric_map import NO_ROOM, TopometricMap
from topometric_ros.visualization.figures import draw_paper, hex_colour
from topometric_ros.visualization.page import number
from topometric_ros.visualization.sheet import PAPER, Sheet, bounds_of
from topometric_ros.visualization.view import View, ViewError, point_storeys
from topometric_ros.voxels.palette import agent_colour

NONE_KNOWN = (
    "nothing says where the agents were: bags of scans with /tf do, "
    "and NAME.trajectories.json beside a map or a cloud"
)


def trajectory_figure(view: View) -> bytes:
    """Draw where each agent walked over the floor plan; a dot marks where it began.

    Raises
    ------
    ViewError
        No trajectory is known.
    """
    ways = trajectories_of(view)
    sheet, starts = Sheet(), dict[int, NDArray[np.float64]]()
    legs = [(t, colour_of(view, t), list(legs_of(view.map, t))) for t in ways]
    for _, pose, storey in draw_paper(sheet, view.map, "#8b929a"):
        for k, (_, colour, parts) in enumerate(legs):
            for index, places in parts:
                if index == storey:
                    placed = pose.apply(places[:, :2])
                    sheet.line(placed, colour, 2.2, casing=0.8)
                    sheet.include(bounds_of(placed))
                    starts.setdefault(k, placed[0])
    for k, (_, colour, _) in enumerate(legs):
        if k in starts:
            sheet.dot(starts[k], colour, 7.0)
    entries = [(name_of(t), colour, "line") for t, colour, _ in legs]
    sheet.legend([("start", PAPER, "dot"), *entries])
    return sheet.png()


def trajectories_of(view: View) -> tuple[AgentTrajectory, ...]:
    """Return the trajectories of a view; raises ViewError where it has none."""
    ways = tuple(way for way in view.trajectories if len(way.positions))
    if not ways:
        raise ViewError(f"stage trajectories: {NONE_KNOWN}")
    return ways


def legs_of(
    m: TopometricMap, trajectory: AgentTrajectory
) -> Iterator[tuple[int, NDArray[np.float64]]]:
    """Yield the stretches of a trajectory by storey: its index in the map and places (n, 3), m.

    A stretch ends with the first place of the next one, so that stairs leave no gap.
    """
    places = trajectory.positions
    storeys = point_storeys(m, places[:, 2], np.full(len(places), NO_ROOM, np.int32))
    starts = [0, *(np.flatnonzero(np.diff(storeys)) + 1).tolist(), len(places)]
    for start, end in itertools.pairwise(starts):
        yield int(storeys[start]), places[start : end + 1]


def colour_of(view: View, trajectory: AgentTrajectory) -> str:
    """Return the colour of a trajectory: its agent's."""
    known = trajectory.agent in view.agents
    return hex_colour(agent_colour(view.agents.index(trajectory.agent) if known else 0))


def name_of(trajectory: AgentTrajectory) -> str:
    """Return whose way it is and how long."""
    steps = np.linalg.norm(np.diff(trajectory.positions, axis=0), axis=1)
    return f"{trajectory.agent}, {number(float(steps.sum()), 0, 'm')}"
