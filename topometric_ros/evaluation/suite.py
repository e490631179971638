"""A suite: which cases are run, read from YAML.

    name: short
    presets: [default, thesis]
    pairs: ../shared/data/pairs      # ready pairs; relative to the working folder
    cross: 12                        # so many of A of one building with B of another
    data: ../shared/data             # where "{data}" below points; an error where it is missing
    source: where to get the data
    buildings: ["office:rooms=12,seed={seed}", "{data}/buildings/duplex.npz"]
    released: ["{data}/House"]       # scenes whose own maps are the agents
    agents: 2
    seeds: [1, 2]
    overlaps: [0.35, 0.7, 0.0]
    degradations:                    # dotted names of SimulationConfig
      clean: {}
      noisy: {sensor.lidar.noise: 0.02}

Every part may be left out. Simulated cases are all combinations of buildings, degradations,
overlaps and seeds.
"""

from __future__ import annotations

import itertools
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from topometric_ros.configuration import with_values
from topometric_ros.errors import ConfigurationError, TopometricError
from topometric_ros.evaluation.case import cell_of, crossed_folders, pair_folders
from topometric_ros.extraction.config import PRESETS
from topometric_ros.yaml_text import load_yaml

RELEASED = 0
"""`agents` of a case whose agents are the maps that a scene has."""
_KEYS = {
    **{"name": str, "note": str, "presets": list, "pairs": str, "cross": int, "buildings": list},
    **{
        "data": str,
        "source": str,
        "released": list,
        "agents": int,
        "seeds": list,
        "overlaps": list,
        "degradations": dict,
    },
}


class SuiteError(TopometricError):
    """A suite that cannot be read or names what does not exist."""


@dataclass(frozen=True)
class CaseSpec:
    """How to get one case; plain values, so that it travels to other processes and hashes.

    `group` is the row of the tables that the case belongs to. `folders` are those of ready pairs:
    one for a pair, two for a cross pair, none where `building` is simulated or, with `agents`
    `RELEASED`, a scene's own maps.
    """

    name: str
    group: str
    folders: tuple[str, ...] = ()
    building: str = ""
    agents: int = 2
    seed: int = 0
    overlap: float = 0.0
    degradation: str = ""
    settings: Mapping[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Suite:
    """Cases in the order of the rows, and the presets to run each with."""

    name: str
    presets: tuple[str, ...]
    cases: tuple[CaseSpec, ...]


def read_suite(text: str) -> Suite:
    """Read a suite's file, or the bundled one of that name.

    Raises
    ------
    SuiteError
        No such file, not YAML, an unknown key or a wrong value.
    EvaluationCaseError
        The folder of pairs is missing or empty.
    """
    path = _path_of(text)
    try:
        source = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise SuiteError(f"{path}: the suite cannot be read: {error}") from error
    try:
        return parse_suite(load_yaml(source), path.stem)
    except (ConfigurationError, SuiteError) as error:
        raise SuiteError(f"{path}: {error}") from error


def parse_suite(tree: Any, name: str = "suite") -> Suite:
    """Return the suite that the content of a YAML file describes; raises as `read_suite`."""
    if not isinstance(tree, Mapping):
        raise SuiteError(f"expected the keys {', '.join(_KEYS)}, got {tree!r}")
    for key, value in tree.items():
        if key not in _KEYS:
            raise SuiteError(f"unknown key {key!r}; known: {', '.join(_KEYS)}")
        if not isinstance(value, _KEYS[key]) or isinstance(value, bool):
            raise SuiteError(f"{key}: expected {_KEYS[key].__name__}, got {value!r}")
    presets = _checked(tree.get("presets", PRESETS))
    cases = (*_ready(tree), *_simulated(tree), *_released(tree))
    if not cases:
        raise SuiteError("no cases: expected pairs, buildings or released")
    names = [case.name for case in cases]
    twice = next((n for n in names if names.count(n) > 1), None)
    if twice is not None:
        raise SuiteError(f"two cases are named {twice!r}")
    return Suite(str(tree.get("name", name)), presets, cases)


def with_presets(suite: Suite, presets: Sequence[str]) -> Suite:
    """Return the suite under other presets; raises SuiteError for an unknown one."""
    return replace(suite, presets=_checked(presets))


def _checked(presets: Sequence[Any]) -> tuple[str, ...]:
    names = tuple(dict.fromkeys(map(str, presets)))
    if not names or not set(names) <= set(PRESETS):
        raise SuiteError(f"presets: expected some of {', '.join(PRESETS)}, got {list(names)}")
    return names


def _ready(tree: Mapping[str, Any]) -> list[CaseSpec]:
    """Return the cases of a folder of ready pairs, then the crossed ones."""
    if "pairs" not in tree:
        return []
    folders = pair_folders(Path(tree["pairs"]))
    limit = tree.get("cross", 0)
    cases = [CaseSpec(p.name, cell_of(p), (str(p),)) for p in folders]
    cases += [
        CaseSpec(f"{p.name} a x {q.name} b", "crossed", (str(p), str(q)))
        for p, q in crossed_folders(folders, limit)
    ]
    return cases


def _simulated(tree: Mapping[str, Any]) -> list[CaseSpec]:
    """Return all combinations of buildings, degradations, overlaps and seeds."""
    if "buildings" not in tree:
        return []
    buildings = _in_data(tree, "buildings")
    agents = tree.get("agents", 2)
    if agents < 2:
        raise SuiteError(f"agents: expected at least 2, got {agents}")
    degradations = tree.get("degradations", {"clean": {}})
    seeds, overlaps = tree.get("seeds", [0]), tree.get("overlaps", [0.5])
    for key, values, kind in (("seeds", seeds, int), ("overlaps", overlaps, (int, float))):
        wrong = [v for v in values if not isinstance(v, kind) or isinstance(v, bool) or v < 0]
        if wrong:
            raise SuiteError(f"{key}: expected numbers of at least 0, got {wrong[0]!r}")
    cases = [
        _simulation(building, str(how), float(overlap), int(seed), agents, degradations[how])
        for building, how, overlap, seed in itertools.product(
            buildings, degradations, overlaps, seeds
        )
    ]
    _check_values(cases)
    return cases


def _released(tree: Mapping[str, Any]) -> list[CaseSpec]:
    """Return the scenes whose own maps are the agents, in frames drawn from the first seed."""
    seed = tree.get("seeds", [0])[0]
    return [
        CaseSpec(
            name=f"{Path(scene).name} released maps",
            group="released maps",
            building=scene,
            agents=RELEASED,
            seed=seed,
        )
        for scene in _in_data(tree, "released")
    ]


def _in_data(tree: Mapping[str, Any], key: str) -> list[str]:
    """Return a list of the suite with `{data}` filled in; raises SuiteError without the data."""
    data, entries = tree.get("data", ""), tree.get(key, [])
    if entries and data and not Path(data).is_dir():
        where = tree.get("source", "the data is not part of this repository")
        raise SuiteError(f"{data}: no such folder; {where}")
    return [str(entry).replace("{data}", data) for entry in entries]


def _check_values(cases: Sequence[CaseSpec]) -> None:
    """Refuse what no case could be simulated with, before hours are spent on the others.

    A building's file is not looked for here: where one of many is missing the others still run.
    """
    from topometric_ros.simulation.cases import SimulationConfig  # Imports Open3D.
    from topometric_ros.simulation.generator import is_generated, parse_generator

    checked: set[str] = set()
    for case in cases:
        values = {"agents": case.agents, "overlap": case.overlap, **case.settings}
        try:
            if is_generated(case.building) and case.building not in checked:
                parse_generator(case.building)
            if repr(values) not in checked:
                with_values(SimulationConfig(), values)
        except ConfigurationError as error:
            raise SuiteError(f"{case.name}: {error}") from error
        checked |= {case.building, repr(values)}


def _simulation(
    building: str, how: str, overlap: float, seed: int, agents: int, settings: Any
) -> CaseSpec:
    if not isinstance(settings, Mapping):
        raise SuiteError(f"degradations: {how}: expected names and values, got {settings!r}")
    spec = building.replace("{seed}", str(seed))
    return CaseSpec(
        name=f"{Path(spec).name} {how} overlap {overlap:g} seed {seed}",
        group=f"{how}, overlap {overlap:g}",
        building=spec,
        agents=agents,
        seed=seed,
        overlap=overlap,
        degradation=how,
        settings=dict(settings),
    )


def _path_of(text: str) -> Path:
    """Return the suite's file: as given, or bundled below config/suites."""
    path = Path(text)
    if path.suffix in (".yaml", ".yml") or path.exists():
        return path
    installed = Path(sys.prefix) / "share/topometric_ros/config/suites"
    folders = (Path("config/suites"), installed)
    for folder in folders:
        if (folder / f"{text}.yaml").is_file():
            return folder / f"{text}.yaml"
    found = (path.stem for folder in folders for path in folder.glob("*.yaml"))
    known = ", ".join(sorted(set(found))) or "none found"
    raise SuiteError(f"{text}: neither a YAML file nor a bundled suite ({known})")
