"""PNG files of the extraction's stages, and of the matches that a merge's output folder names."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from topometric_ros.alignment import Alignment, AlignmentStatus, Alternative, RoomMatch
from topometric_ros.errors import one_line
from topometric_ros.io.summaries import write_atomically
from topometric_ros.runtime.bag_sources import parse_source
from topometric_ros.runtime.config import ToolConfig
from topometric_ros.runtime.sources import InputOptions, load_source
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.pair_figures import matches_figure
from topometric_ros.visualization.stages import STAGES, Stages
from topometric_ros.visualization.trajectories import trajectory_figure
from topometric_ros.visualization.view import View, ViewError

_UP = 4
"""How many folders above a merge its sources are looked for: an evaluation's lie three above."""


def stage_names(names: Sequence[str]) -> tuple[str, ...]:
    """Return stages by their names, `all` being every one; raises ViewError for another name.

    Examples
    --------
    >>> stage_names(["rooms", "rooms"])
    ('rooms',)
    """
    unknown = [name for name in names if name not in (*STAGES, "all")]
    if unknown:
        known = ", ".join((*STAGES, "all"))
        raise ViewError(f"unknown stage {unknown[0]!r}; known: {known}")
    return STAGES if "all" in names else tuple(dict.fromkeys(names))


class FileStages:
    """The stages of what a view shows; what several pictures need is made once.

    Parameters
    ----------
    view : what the source holds
    source : as `topometric view` was given it
    config, options : of the extraction, where one is needed
    progress : told in words what is being done
    """

    def __init__(
        self,
        view: View,
        source: str,
        config: ToolConfig,
        options: InputOptions,
        progress: Callable[[str], None],
    ) -> None:
        self.view, self.source, self.progress = view, source, progress
        self.drawn = Stages(view.map, config.extraction)
        self._config, self._options = config, options

    @cached_property
    def matched(self) -> tuple[list[Alignment], dict[str, TopometricMap]]:
        """The pairs that have matched rooms, and the maps of their agents.

        Raises
        ------
        TopometricError
            The source is no output folder of a merge, or a map cannot be found or made again.
        """
        path = Path(self.source)
        folder = path if path.is_dir() else path.parent
        alignments, sources = _summary(folder / "merge.json")
        matched = [alignment for alignment in alignments if alignment.matches]
        if not matched:
            raise ViewError("stage matches: no two agents have matched rooms")
        agents = dict.fromkeys(agent for alignment in matched for agent in alignment.agents)
        maps = {
            agent: _source_map(
                folder, agent, sources[agent], self._config, self._options, self.progress
            )
            for agent in agents
        }
        for alignment in matched:
            first, second = alignment.agents
            _require_rooms(maps[first], [match.room_a for match in alignment.matches])
            _require_rooms(maps[second], [match.room_b for match in alignment.matches])
        return matched, maps

    def pictures(self, stage: str) -> dict[str, bytes]:
        """Return the pictures of a stage by their names; raises ViewError where there are none."""
        self.progress(f"drawing {stage}")
        if stage == "matches":
            return _matches(*self.matched)
        if stage == "trajectories":
            return {"trajectories": trajectory_figure(self.view)}
        return self.drawn.pictures(stage)


def save_stages(
    stages: FileStages, names: Sequence[str], folder: Path
) -> tuple[list[Path], list[ViewError]]:
    """Write `stage_NAME.png` of every stage.

    Returns
    -------
    the files, and an error for every stage that the source cannot show
    """
    pictures: dict[str, bytes] = {}
    missing = []
    for name in names:
        try:
            pictures |= stages.pictures(name)
        except ViewError as error:
            missing.append(ViewError(f"{stages.source}: {error}"))
    folder.mkdir(parents=True, exist_ok=True)
    paths = [folder / f"stage_{name}.png" for name in pictures]
    for path, picture in zip(paths, pictures.values(), strict=True):
        write_atomically(path, picture)
    return paths, missing


def alignment_of(entry: Mapping[str, Any]) -> Alignment:
    """Return an alignment as merge.json holds it."""
    first, second = entry["agents"]
    return Alignment(
        agents=(first, second),
        status=AlignmentStatus(entry["status"]),
        reason=entry["reason"],
        T_a_b=None if entry["T_a_b"] is None else np.array(entry["T_a_b"], np.float64),
        alternatives=tuple(
            Alternative(np.array(other["T_a_b"], np.float64), float(other["score"]))
            for other in entry.get("alternatives", ())
        ),
        matches=tuple(RoomMatch(int(i), int(j), float(d)) for i, j, d in entry["matches"]),
    )


def _matches(matched: Sequence[Alignment], maps: Mapping[str, TopometricMap]) -> dict[str, bytes]:
    """Draw every pair of agents that has matched rooms; numbered where they are several."""
    pictures = {}
    for k, alignment in enumerate(matched):
        a, b = (maps[agent] for agent in alignment.agents)
        picture = matches_figure(a, b, alignment)
        if picture is not None:
            pictures["matches" if len(matched) == 1 else f"matches_{k + 1}"] = picture
    return pictures


def _summary(path: Path) -> tuple[list[Alignment], dict[str, str]]:
    """Return the alignments of a merge.json and the sources of its agents."""
    if not path.is_file():
        raise ViewError("stage matches: only the output folder of merge or replay names matches")
    try:
        summary = json.loads(path.read_text(encoding="utf-8"))
        sources = {str(agent["id"]): str(agent["source"]) for agent in summary["agents"]}
        alignments = [alignment_of(entry) for entry in summary["alignments"]]
        unknown = {name for a in alignments for name in a.agents} - sources.keys()
        if unknown:
            raise ValueError(f"no agent {min(unknown)!r}")
    except (OSError, ValueError, KeyError, TypeError, RecursionError) as error:
        raise ViewError(f"{path}: not the summary of a merge: {one_line(error)}") from error
    return alignments, sources


def _source_map(
    folder: Path,
    agent: str,
    text: str,
    config: ToolConfig,
    options: InputOptions,
    progress: Callable[[str], None],
) -> TopometricMap:
    """Return an agent's own map, from what it was merged from."""
    source = parse_source(text)
    above = folder.resolve()
    places = [Path(), above, *list(above.parents)[:_UP]]
    found = next((place / source.path for place in places if (place / source.path).exists()), None)
    if found is None:
        raise ViewError(f"stage matches: {text}, which agent {agent!r} came from, is not there")
    source = dataclasses.replace(source, path=found, agent=agent)
    return load_source(source, config, options, progress).map


def _require_rooms(m: TopometricMap, rooms: Sequence[int]) -> None:
    missing = sorted(set(rooms) - {room.id for room in m.rooms})
    if missing:
        raise ViewError(
            f"stage matches: the map of {m.agent!r}, extracted again, has no room {missing[0]}; "
            "give the --config that the merge had"
        )
