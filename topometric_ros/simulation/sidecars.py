"""Files beside a building that a person writes or corrects: its links and its walks.

`<building>.graph.yaml` says which rooms are joined, and replaces the links that the loader found;
`<building>.trajectory.yaml` says where agents walk. Rooms are named by name or by id.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from topometric_ros.errors import ConfigurationError, one_line
from topometric_ros.simulation.building import BuildingError
from topometric_ros.simulation.labelled import LabelledBuilding, Trajectory, TrueLink
from topometric_ros.yaml_text import load_yaml


def graph_path(building: Path) -> Path:
    """Return where a building's file or folder has its links: `office.png`: `office.graph.yaml`."""
    return _beside(building, "graph")


def trajectory_path(building: Path) -> Path:
    """Return where a building's file or folder has its walks."""
    return _beside(building, "trajectory")


def with_sidecars(building: LabelledBuilding, path: Path) -> LabelledBuilding:
    """Return a building with the links and walks of the files beside it, where there are any.

    Raises
    ------
    BuildingError
        A file is not YAML of this kind, or names a room that the building has not.
    """
    if graph_path(path).exists():
        links = _read(graph_path(path), "links", lambda entry: _link(building, entry))
        building = dataclasses.replace(building, links=links)
    if trajectory_path(path).exists():
        walks = _read(trajectory_path(path), "agents", lambda entry: _walk(building, entry))
        building = dataclasses.replace(building, trajectories=walks)
    return building


def write_graph(building: LabelledBuilding, path: Path) -> None:
    """Write a building's links as a proposal for a person to correct, and which rooms have none."""
    joined = {room for link in building.links for room in link.rooms}
    alone = [str(_reference(building, r.id)) for r in building.rooms if r.id not in joined]
    links = [
        {
            "rooms": [_reference(building, room) for room in link.rooms],
            "kind": link.kind,
            "position": [round(float(x), 3) for x in link.position],
            "width": round(float(link.width), 3),
        }
        for link in building.links
    ]
    lines = "# Rooms that are joined: kind is door, opening, virtual or stair; metres.\n"
    lines += f"# Rooms without a link: {', '.join(alone) or 'none'}.\n"
    path.write_text(lines + yaml.safe_dump({"links": links}, sort_keys=False), encoding="utf-8")


def waypoints_of(stops: Sequence[Sequence[float | str]]) -> NDArray[np.float64]:
    """Return waypoints x y z or x y, m, as (W, 3); z is NaN where it is left out.

    Raises
    ------
    ValueError, TypeError
        One has fewer or more numbers, or one that is not finite.
    """
    rows = [[float(number) for number in stop] for stop in stops]
    if any(len(row) not in (2, 3) or not np.isfinite(row).all() for row in rows):
        raise ValueError("expected two or three finite numbers each")
    return np.array([[*row, np.nan][:3] for row in rows]).reshape(-1, 3)


def _beside(building: Path, what: str) -> Path:
    stem = building.name if building.is_dir() else building.stem
    return building.with_name(f"{stem}.{what}.yaml")


def _read(path: Path, key: str, entry: Any) -> tuple[Any, ...]:
    """Read the list `key` of a YAML file, each item through `entry`."""
    try:
        content = load_yaml(path.read_text(encoding="utf-8"))
        return tuple(entry(item) for item in content[key])
    except BuildingError as error:
        raise BuildingError(f"{path}: {error}") from None
    except (OSError, ConfigurationError, KeyError, TypeError, ValueError) as error:
        raise BuildingError(f"{path}: expected a list {key}: {one_line(error)}") from error


def _link(building: LabelledBuilding, entry: dict[str, Any]) -> TrueLink:
    first, second = (_room(building, reference) for reference in entry["rooms"])
    position = np.array(entry["position"], dtype=np.float64).reshape(3)
    return TrueLink((first, second), entry["kind"], position, float(entry.get("width", 0.9)))


def _walk(building: LabelledBuilding, entry: dict[str, Any]) -> Trajectory:
    agent, stops = str(entry["agent"]), entry.get("waypoints", ())
    rooms = tuple(_room(building, reference) for reference in entry.get("rooms", ()))
    try:
        waypoints = waypoints_of(stops)
    except (TypeError, ValueError):
        raise BuildingError(
            f"agent {agent}: waypoints: expected [x, y] or [x, y, z] each, in m, got {stops!r}"
        ) from None
    if len(rooms) + len(waypoints) < 1:
        raise BuildingError(f"agent {agent}: expected rooms or waypoints, got neither")
    return Trajectory(agent, rooms, waypoints)


def _reference(building: LabelledBuilding, room: int) -> str | int:
    """A room's name where only it has that name, else its id."""
    name = building.rooms[room].name
    return name if [r.name for r in building.rooms].count(name) == 1 else room


def _room(building: LabelledBuilding, reference: str | int) -> int:
    found = [room.id for room in building.rooms if reference in (room.name, room.id)]
    if len(found) != 1:
        raise BuildingError(f"{len(found)} rooms of {building.name} are called {reference!r}")
    return found[0]
