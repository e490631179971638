"""Places that look alike: made buildings in variants, wings, storeys and rows, and maps of walks.

`measure_negatives.py` crosses what agents map in them. Every made map is extracted once and kept.
"""

from __future__ import annotations

import itertools
import json
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from measure_merging import Saved, write_maps
from numpy.typing import NDArray

from topometric_ros.evaluation.case import pair_folders
from topometric_ros.fusion.poses import apply, inverse
from topometric_ros.io.map_files import load_map, save_map
from topometric_ros.runtime.config import ToolConfig
from topometric_ros.runtime.extract_map import extract_map
from topometric_ros.simulation import cases
from topometric_ros.simulation.buildings import load_building
from topometric_ros.simulation.case_files import read_case
from topometric_ros.simulation.cases import SimulationConfig, Walk
from topometric_ros.simulation.labelled import LabelledBuilding
from topometric_ros.simulation.trajectories import OVERLAP_VOXEL

BASES = (
    "office:seed=41,rooms=9",
    "hospital:seed=42,rooms=8",
    "home:seed=43,rooms=7",
    "office:seed=44,rooms=10,alike=0.6",
    "hospital:seed=45,rooms=9,corridor=L",
    "home:seed=46,rooms=8,twins=2",
)
VARIANTS = {
    "plain": "furnished=1",
    "other furniture": "furnished=2",
    "mirrored": "furnished=1,mirrored=true",
    "bare": "furnished=1,furniture=0",
}
WINGS = ("office:seed=51,rooms=16,wings=2", "hospital:seed=52,rooms=15,wings=2")
STOREYS = (
    "office:seed=61,rooms=16,storeys=2,stacked=true,furnished=1",
    "hospital:seed=62,rooms=14,storeys=2,stacked=true,furnished=1",
)
ROWS = (
    "hospital:seed=71,rooms=18,alike=1,furnished=1",
    "office:seed=72,rooms=18,alike=1,furnished=1",
)
ROOMS_WALKED = 7


@dataclass(frozen=True)
class Place:
    """A map and where it stands for: `part` names a variant, a wing or a storey of `saved`."""

    saved: Saved
    part: str


def made_places(folder: Path, config: ToolConfig, later: int = 0) -> Iterable[list[Place]]:
    """Yield the maps of each made building, which are made where `folder` lacks them.

    Parameters
    ----------
    later : added to the seed of every building: other buildings of the same kinds
    """
    for base, (part, options) in itertools.product(_seeded(BASES, later), VARIANTS.items()):
        yield _walked(f"{base},{options}", base, folder, config, {part: ()})
    for spec in _seeded(WINGS, later):
        yield _walked(spec, spec, folder, config, _wings(load_building(spec)))
    for spec in _seeded(STOREYS, later):
        yield _walked(spec, spec, folder, config, _storeys(load_building(spec)))
    for spec in _seeded(ROWS, later):
        yield _walked(spec, spec, folder, config, {"row": ()}, overlap=0.0)


def _seeded(specs: Iterable[str], later: int) -> list[str]:
    """Return the buildings with a number added to their seeds."""
    return [re.sub(r"seed=(\d+)", lambda m: f"seed={int(m[1]) + later}", s) for s in specs]


def _walked(
    spec: str,
    building: str,
    folder: Path,
    config: ToolConfig,
    parts: dict[str, tuple[int, ...]],
    overlap: float = 0.5,
) -> list[Place]:
    """Return the maps of two agents in each part; a part without rooms is walked at will."""
    places = []
    for number, (part, rooms) in enumerate(parts.items()):
        target = folder / f"{spec}__{part.replace(' ', '_')}"
        if not (target / "truth.json").is_file():
            simulation = SimulationConfig(overlap=overlap, visits=0 if rooms else ROOMS_WALKED)
            ready = cases.prepare(load_building(spec), simulation)
            walks = [Walk(rooms), Walk(rooms[::-1])] if rooms else []
            write_maps(ready, 7 + number, target, config, walks)
        truth = json.loads((target / "truth.json").read_text(encoding="utf-8"))
        for agent, T in sorted(truth.items()):
            saved = Saved(f"{target.name}/{agent}", building, False, np.array(T), folder)
            places.append(Place(saved, part))
    return places


def _wings(building: LabelledBuilding) -> dict[str, tuple[int, ...]]:
    """Return the rooms of each part of a building that its lobbies join."""
    lobbies = {room.id for room in building.rooms if room.kind == "lobby"}
    part = list(range(len(building.rooms)))
    for link in [link for link in building.links if not lobbies & set(link.rooms)] * len(part):
        part[link.rooms[0]] = part[link.rooms[1]] = min(part[r] for r in link.rooms)
    rooms = [r for r in range(len(part)) if r not in lobbies]
    groups = [tuple(r for r in rooms if part[r] == p) for p in sorted({part[r] for r in rooms})]
    return {f"wing {k}": group[:ROOMS_WALKED] for k, group in enumerate(groups)}


def _storeys(building: LabelledBuilding) -> dict[str, tuple[int, ...]]:
    """Return the first rooms of each storey, the corridor and the stairs among them."""
    return {
        f"storey {storey}": tuple(r.id for r in building.rooms if r.storey == storey)[:ROOMS_WALKED]
        for storey in sorted({room.storey for room in building.rooms})
    }


def corpus(folder: Path) -> list[Saved]:
    """Return the maps that `measure_merging.py` wrote."""
    saved = []
    for path in sorted(folder.glob("*/truth.json")):
        walk = path.parent.name
        for agent, T in sorted(json.loads(path.read_text(encoding="utf-8")).items()):
            noisy = "_noisy" in walk
            saved.append(Saved(f"{walk}/{agent}", walk.split("__")[0], noisy, np.array(T), folder))
    return saved


def of_pairs(folders: Sequence[Path], maps: Path, config: ToolConfig) -> list[Saved]:
    """Return the maps of pairs with truth (`a.ply`, `b.ply`, `truth.json`), extracted once."""
    saved = []
    given = [[f] if (f / "truth.json").is_file() else pair_folders(f) for f in folders]
    for folder in itertools.chain.from_iterable(given):
        target = maps / folder.name
        if not (target / "truth.json").is_file():
            target.mkdir(parents=True, exist_ok=True)
            case = read_case(folder)
            for agent in case.agents:
                m = extract_map(
                    agent.points, config.extraction, config.merge.matching, agent=agent.id
                ).map
                save_map(target / f"{agent.id}.tmap", m)
            truth = {agent.id: agent.T_agent_building.tolist() for agent in case.agents}
            text = json.dumps({"plan": case.plan, "truth": truth})
            (target / "truth.json").write_text(text + "\n", encoding="utf-8")
        told = json.loads((target / "truth.json").read_text(encoding="utf-8"))
        for agent_id, T in sorted(told["truth"].items()):
            noisy = "_noisy" in folder.name
            saved.append(Saved(f"{folder.name}/{agent_id}", told["plan"], noisy, np.array(T), maps))
    return saved


def building_cells(saved: Saved) -> NDArray[np.int64]:
    """Return the cells of 0.2 m that a map holds in its building's frame, sorted."""
    m = load_map(saved.folder / f"{saved.name}.tmap")
    T = inverse(saved.T_agent_building) @ inverse(m.T_level_input)
    cells = np.floor(apply(T, m.surface()) / OVERLAP_VOXEL).astype(np.int64)
    return np.unique(cells @ np.array([1, 1 << 20, 1 << 40]))


def shared_cells(one: NDArray[np.int64], other: NDArray[np.int64]) -> float:
    """Return the part of the smaller map's cells that both maps hold, 0..1."""
    both = np.intersect1d(one, other, assume_unique=True)
    return len(both) / max(1, min(len(one), len(other)))
