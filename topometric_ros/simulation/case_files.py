"""Cases as folders: a.ply, a.trajectories.json, ..., truth.json, truth.npz and, on demand, a bag.

`truth.json` holds plan, seed, overlap, a_from_b, X_from_world, rooms_X, points, poses, edges and
room_names;
`truth.npz` the room of every point under the agent's id and, as poses_X and scan_X, from where it
was seen. Other writers leave some of that out.
"""

from __future__ import annotations

import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.errors import one_line
from topometric_ros.io.clouds import DAMAGED_NUMPY
from topometric_ros.io.ply import read_ply_points, write_ply
from topometric_ros.io.trajectories import AgentTrajectory, write_trajectories
from topometric_ros.runtime.track import Track
from topometric_ros.simulation.case import Case, CaseError, SimulatedAgent
from topometric_ros.simulation.recording import PERIOD, START


def write_case(case: Case, folder: Path, bag: str = "") -> None:
    """Write a case into a folder, which is made; what an earlier case left there is removed.

    Parameters
    ----------
    bag : "scans" writes the bag folder/bag of single scans with /tf, "maps" one of growing map
        clouds; empty writes none

    Raises
    ------
    TopometricError
        The kind of bag is unknown or folder/bag holds what no case has written.
    """
    from topometric_ros.simulation.case_bags import write_bag

    folder.mkdir(parents=True, exist_ok=True)
    _clear(folder)
    if bag:
        write_bag(case, folder / "bag", bag)
    arrays: dict[str, NDArray[Any]] = {}
    for agent in case.agents:
        table = np.empty(len(agent.points), [(axis, "<f4") for axis in "xyz"])
        for axis, values in zip("xyz", agent.points.T, strict=True):
            table[axis] = values
        write_ply(folder / f"{agent.id}.ply", table)
        write_trajectories(folder / f"{agent.id}.ply", _trajectory(agent))
        arrays[agent.id] = agent.room.astype(np.int16)
        arrays[f"poses_{agent.id}"] = agent.poses
        arrays[f"scan_{agent.id}"] = agent.scan_of_point.astype(np.int32)
    np.savez_compressed(folder / "truth.npz", **arrays)  # type: ignore[arg-type]
    (folder / "truth.json").write_text(json.dumps(_truth(case)) + "\n")


def _clear(folder: Path) -> None:
    """Remove the files of an earlier case, which may have had more agents, or a bag."""
    own = ["truth.json", "truth.npz", "[a-z].ply", "[a-z].trajectories.json"]
    for pattern in [*own, "bag/metadata.yaml", "bag/*.mcap"]:
        for path in folder.glob(pattern):
            path.unlink()
    bag = folder / "bag"
    if bag.is_dir() and not any(bag.iterdir()):
        bag.rmdir()


def read_case(folder: Path) -> Case:
    """Read a case; its `building` is None, and what its writer left out is empty.

    Raises
    ------
    TopometricError
        A file is missing or not what it should be.
    """
    try:
        truth = json.loads((folder / "truth.json").read_text())
        with np.load(folder / "truth.npz") as arrays:
            ids = [key for key in arrays.files if len(key) == 1]
            agents = tuple(_read_agent(folder, key, truth, arrays) for key in sorted(ids))
        pairs = list(itertools.combinations(range(len(agents)), 2))
        overlap = np.array(truth.get("overlaps", [truth["overlap"]] * len(pairs)), dtype=float)
        edges = tuple((int(a), int(b)) for a, b in truth.get("edges", ()))
        return Case(str(truth["plan"]), int(truth["seed"]), agents, overlap, edges)
    except (OSError, KeyError, TypeError, *DAMAGED_NUMPY) as error:
        raise CaseError(f"{folder}: not a simulated case: {one_line(error)}") from error


def _read_agent(folder: Path, key: str, truth: Any, arrays: Any) -> SimulatedAgent:
    points = read_ply_points(folder / f"{key}.ply")
    room = arrays[key].astype(np.int32)
    if len(points) != len(room):
        raise ValueError(f"{key}.ply has {len(points)} points, truth.npz {len(room)}")
    known = f"poses_{key}" in arrays.files
    unknown = np.full(len(points), -1, dtype=np.int32)
    return SimulatedAgent(
        id=key,
        points=points,
        room=room,
        poses=arrays[f"poses_{key}"] if known else np.zeros((0, 4, 4)),
        scan_of_point=arrays[f"scan_{key}"] if known else unknown,
        T_agent_building=np.array(truth[f"{key}_from_world"], dtype=float),
        rooms_walked=tuple(int(room) for room in truth[f"rooms_{key}"]),
    )


def _trajectory(agent: SimulatedAgent) -> list[AgentTrajectory]:
    """Return where the agent believes that its sensor was, in its own frame."""
    track = Track()
    for i, pose in enumerate(agent.poses):
        track.add(START + i * PERIOD, pose[:3, 3])
    found = track.trajectory(agent.id, f"{agent.id}/map")
    return [found] if found else []


def _truth(case: Case) -> dict[str, Any]:
    """Return the content of truth.json."""
    agents = case.agents
    truth: dict[str, Any] = {
        "plan": case.plan,
        "seed": case.seed,
        "overlap": float(case.overlap[0]) if len(case.overlap) else 0.0,
    }
    if len(agents) > 1:
        truth["a_from_b"] = case.T_a_b(0, 1).tolist()
    for agent in agents:
        truth[f"{agent.id}_from_world"] = agent.T_agent_building.tolist()
    for agent in agents:
        truth[f"rooms_{agent.id}"] = list(agent.rooms_walked)
    truth["points"] = {agent.id: len(agent.points) for agent in agents}
    truth["poses"] = {agent.id: len(agent.poses) for agent in agents}
    truth["edges"] = [list(edge) for edge in case.edges]
    if case.building is not None:
        truth["room_names"] = [room.name for room in case.building.rooms]
    if len(agents) > 2:
        truth["overlaps"] = case.overlap.tolist()
    return truth
