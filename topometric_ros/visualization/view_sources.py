"""From a cloud, a bag, a .tmap file or an output folder to what the view shows."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np

from topometric_ros.errors import one_line
from topometric_ros.fusion.poses import Transform
from topometric_ros.io.map_files import load_global_map, map_file_of
from topometric_ros.io.trajectories import read_trajectories, trajectory_of
from topometric_ros.runtime.bag_sources import parse_source
from topometric_ros.runtime.config import ToolConfig
from topometric_ros.runtime.sources import MAP_SUFFIX, InputOptions, load_source
from topometric_ros.visualization.view import Match, View, ViewError, single_view

_RoomsOf = dict[int, tuple[tuple[str, int], ...]]


def load_view(
    source: str, config: ToolConfig, options: InputOptions, progress: Callable[[str], None]
) -> View:
    """Return the view of a source.

    Parameters
    ----------
    source : cloud, BAG[:TOPIC], .tmap file, or folder that extract, merge or replay wrote to
    config, options : of the extraction, where one is needed

    Raises
    ------
    TopometricError
        The source cannot be read or holds nothing to show.
    """
    path = Path(source)
    if (held := map_file_of(path)) is not None:
        return _map_file_view(held)
    if path.suffix.lower() == MAP_SUFFIX and path.is_file():
        return _map_file_view(path)
    _require_source(path)
    loaded = load_source(parse_source(source), config, options, progress)
    return single_view(loaded.map, loaded.trajectory)


def _require_source(path: Path) -> None:
    """Raise ViewError for folders of this package that hold no map, with what to open instead."""
    if (path / "truth.json").is_file():
        raise ViewError(f"{path}: a simulated case; view an agent's cloud, as {path / 'a.ply'}")
    if (path / "rows.csv").is_file() and (path / "cases").is_dir():
        case = min(path.glob("cases/*/*/global.tmap"), default=None)
        merged = f", or view a case, as {case.parent}" if case else ""
        raise ViewError(f"{path}: an evaluation; open {path / 'report.html'} in a browser{merged}")
    truth = min(path.glob("*/truth.json"), default=None)
    if truth is not None:
        cloud = truth.with_name("a.ply")
        raise ViewError(f"{path}: simulated cases; view an agent's cloud, as {cloud}")


def _map_file_view(path: Path) -> View:
    """Return the view of a map file, with the matches of the merge.json beside a global map."""
    m, observed_by, agents = load_global_map(path)
    if observed_by is None or not agents:
        return single_view(m, trajectory_of(path, m.agent))
    title = f"global map of {', '.join(_present(observed_by, agents))}"
    summary = path.with_name("merge.json")
    if path.name != "global.tmap" or not summary.is_file():
        return View(title, m, observed_by, tuple(agents))
    matches, rooms_of, placed = _merge_summary(summary)
    ways = [
        entry.moved(m.T_level_input @ placed[entry.agent])
        for entry in read_trajectories(path)
        if entry.agent in placed
    ]
    return View(title, m, observed_by, tuple(agents), matches, rooms_of, tuple(ways))


def _present(observed_by: np.ndarray, agents: tuple[str, ...]) -> list[str]:
    """Return the agents that saw anything of a map."""
    everything = int(np.bitwise_or.reduce(observed_by)) if len(observed_by) else 0
    return [agent for k, agent in enumerate(agents) if everything >> k & 1] or list(agents)


def _merge_summary(path: Path) -> tuple[tuple[Match, ...], _RoomsOf, dict[str, Transform]]:
    """Return the pairs of a merge.json, whose rooms became one, and the T_global_agent it has."""
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        matches = tuple(
            Match(
                (str(entry["agents"][0]), str(entry["agents"][1])),
                str(entry["status"]),
                str(entry["reason"]),
                tuple((int(a), int(b)) for a, b, _ in entry["matches"]),
            )
            for entry in summary["alignments"]
        )
        rooms_of = {
            int(entry["id"]): tuple((str(agent), int(room)) for agent, room in entry["of"])
            for entry in summary.get("rooms", ())
        }
        placed = {
            str(agent["id"]): np.array(agent["T_global_agent"], np.float64).reshape(4, 4)
            for agent in summary["agents"]
            if agent.get("T_global_agent") is not None
        }
    except (OSError, ValueError, KeyError, TypeError, IndexError, RecursionError) as error:
        raise ViewError(f"{path}: not the summary of a merge: {one_line(error)}") from error
    return matches, rooms_of, placed
