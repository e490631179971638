"""What goes wrong between a surface and an agent's map: dropout, drift, moved furniture, ceilings.

Each is one function of its input and a random generator; range noise is drawn with the scan.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from topometric_ros.configuration import parameter
from topometric_ros.errors import ConfigurationError
from topometric_ros.matching.hypotheses import register_positions
from topometric_ros.simulation.agents import rotation, translation
from topometric_ros.simulation.labelled import LabelledBuilding

_CEILING = 0.25
"""What lies less than this below a room's upper end counts as its ceiling, m."""


@dataclass(frozen=True)
class DegradeConfig:
    """How an agent's map falls short of the building."""

    dropout: float = parameter(
        0.0, "Share of the returns that are lost.", minimum=0.0, maximum=0.99
    )
    drift: float = parameter(
        0.0,
        "Standard deviation of the horizontal drift, along each axis, over the first metre "
        "walked; it grows with the root of the way.",
        unit="m",
        minimum=0.0,
        maximum=1.0,
    )
    yaw_drift: float = parameter(
        0.0,
        "Standard deviation of the heading's drift over the first metre walked.",
        unit="deg",
        minimum=0.0,
        maximum=10.0,
    )
    moved: float = parameter(
        0.0,
        "Share of the furniture that is pushed elsewhere for every agent after the first; a piece "
        "that would then reach into a wall or another room stays.",
        minimum=0.0,
        maximum=1.0,
    )
    moved_by: float = parameter(
        1.0, "How far moved furniture goes, at most.", unit="m", minimum=0.0, maximum=10.0
    )
    ceiling: str = parameter(
        "seen", "Which agents see ceilings: all, the first only, or none.",
        choices=("seen", "first", "none"),
    )  # fmt: skip
    resolution: float = parameter(
        0.02,
        "Edge of the cells that keep one point each; 0 keeps all.",
        unit="m",
        minimum=0.0,
        maximum=1.0,
    )
    resolutions: tuple[float, ...] = parameter(
        (),
        "Edge of those cells for each agent, in their order; those not named have `resolution`.",
        unit="m",
        minimum=0.0,
        maximum=1.0,
    )
    frame_offset: float = parameter(
        30.0,
        "How far an agent's frame lies from the building's along x and y, at most.",
        unit="m",
        minimum=0.0,
    )
    frame_height: float = parameter(
        0.5, "How far it lies above or below, at most.", unit="m", minimum=0.0
    )


def random_frame(config: DegradeConfig, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return a T_agent_building (4, 4) of any yaw and a translation within the limits."""
    yaw = rng.uniform(-np.pi, np.pi)
    limit = np.array([config.frame_offset, config.frame_offset, config.frame_height])
    x, y, z = rng.uniform(-limit, limit)
    return translation(x, y, z) @ rotation(0.0, 0.0, yaw)


def drifted(
    poses: NDArray[np.float64], config: DegradeConfig, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return where an agent believes that it was: (S, 4, 4).

    The steps between poses are a random walk in x, y and yaw. The whole walk is then moved, by
    yaw and translation, onto the true one, so that the truth is the transform that leaves least.

    Parameters
    ----------
    poses : (S, 4, 4) T_building_sensor
    """
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    draws = rng.standard_normal((max(len(poses) - 1, 0), 3)) * np.sqrt(steps)[:, None]
    if config.drift == 0.0 and config.yaw_drift == 0.0:
        return poses
    believed = [poses[0]]
    for i, (dx, dy, turn) in enumerate(draws):
        step = np.linalg.inv(poses[i]) @ poses[i + 1]
        # The error of a step is made about the vertical, where the agent believes that it stands.
        at = believed[-1][:3, 3]
        turned = rotation(0.0, 0.0, np.radians(config.yaw_drift) * turn)
        slip = translation(config.drift * dx, config.drift * dy, 0.0)
        about = slip @ translation(*at) @ turned @ translation(*-at)
        believed.append(about @ believed[-1] @ step)
    result = np.array(believed)
    back, _ = register_positions(poses[:, :3, 3], result[:, :3, 3])
    return back @ result


def furniture_pieces(building: LabelledBuilding) -> int:
    """Return how many things of a building can be moved; none in a cloud."""
    tags = building.face_tag
    return 0 if tags is None or building.is_cloud else len(np.unique(tags[tags > 0]))


def move_furniture(
    building: LabelledBuilding, config: DegradeConfig, rng: np.random.Generator
) -> NDArray[np.float64]:
    """Return the vertices (V, 3), m, with some of the furniture moved within its rooms."""
    vertices = building.vertices.copy()
    tags = building.face_tag
    if config.moved == 0.0 or tags is None:
        return vertices
    for tag in np.unique(tags[tags > 0]):
        chosen = rng.random() < config.moved
        angle, distance = rng.uniform(0.0, 2 * np.pi), config.moved_by * np.sqrt(rng.random())
        if not chosen:
            continue
        own = np.unique(building.faces[tags == tag])
        moved = vertices[own] + distance * np.array([np.cos(angle), np.sin(angle), 0.0])
        # Without a way to move along, a point in a wall belongs to no room.
        rooms = building.room_of(moved, np.zeros_like(moved))
        # What would reach into another room or a wall stays where it is.
        if rooms[0] >= 0 and (rooms == rooms[0]).all():
            vertices[own] = moved
    return vertices


def resolutions_of(config: DegradeConfig, agents: int) -> list[float]:
    """Return the edge of the cells that keep one point each, for each agent, m; 0 keeps all.

    Raises
    ------
    ConfigurationError
        There are more `resolutions` than agents.
    """
    cells = config.resolutions
    if len(cells) > agents:
        raise ConfigurationError(
            f"degrade.resolutions: expected at most {agents}, one an agent, got {list(cells)}"
        )
    return [*cells, *[config.resolution] * (agents - len(cells))]


def sees_ceiling(config: DegradeConfig, agent: int) -> bool:
    """True where the agent of that index sees ceilings."""
    return config.ceiling == "seen" or (config.ceiling == "first" and agent == 0)


def below_ceiling(
    building: LabelledBuilding, hits: NDArray[np.float64], room: NDArray[np.int32]
) -> NDArray[np.bool_]:
    """Return which points (N, 3) lie clearly below the upper end of their room (N,): (N,)."""
    upper = np.array([np.inf, *(r.z_high for r in building.rooms)])
    below: NDArray[np.bool_] = hits[:, 2] < upper[room + 1] - _CEILING
    return below


def thinned(points: NDArray[np.float64], cell: float) -> NDArray[np.int64]:
    """Return the index of the first point in each cell of edge `cell` (m), sorted; 0: of all."""
    if cell == 0.0 or len(points) == 0:
        return np.arange(len(points))
    return np.sort(np.unique(cell_codes(points, cell), return_index=True)[1])


def cell_codes(points: NDArray[np.float64], cell: float) -> NDArray[np.int64]:
    """Return a number for the cell that holds each point (N, 3): (N,), equal in equal cells."""
    coords = np.floor(points / cell).astype(np.int64) + (1 << 20)
    return (coords[:, 0] << 42) | (coords[:, 1] << 21) | coords[:, 2]
