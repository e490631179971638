"""The agents file: which extractors and which merger make up a fleet, for `launch` and `run` alike.

    agents:
      - id: robot1
        namespace: /robot1       # default: /ID
        cloud: cloud_map         # topic that `cloud` is remapped to; relative to the namespace
        mode: auto               # auto, map or scan
        params: {}               # parameters of this extractor, nested or dotted
      - id: monday
        map: monday.tmap         # instead of all that: a map of another day, beside this file
    extractor:
      params: {}                 # parameters of every extractor
    merger:
      namespace: ""              # default: none
      params: {global_frame: global}
    simulation:                  # only for a fleet that is simulated
      params: {building: "office:rooms=6"}

A file says everything that a process needs: :func:`extractor_arguments` and
:func:`merger_arguments` turn it into the ROS arguments of the executables.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import yaml

from topometric_ros.errors import ConfigurationError, TopometricError
from topometric_ros.yaml_text import load_yaml

MODES = ("auto", "map", "scan")

_TOKEN = r"[A-Za-z_][A-Za-z0-9_]*"
_ID = re.compile(rf"^{_TOKEN}$")
_NAMESPACE = re.compile(rf"^(/{_TOKEN})*/?$")
_TOPIC = re.compile(rf"^/?{_TOKEN}(/{_TOKEN})*$")

_LIVE_KEYS = ("namespace", "cloud", "mode", "params")
_AGENT_KEYS = ("id", *_LIVE_KEYS, "map")
_SHARED = ("global_frame",)
"""Parameters of the merger that its extractors must know."""

_ROOT_KEYS = ("agents", "extractor", "merger", "simulation")


class AgentsFileError(TopometricError):
    """An agents file that cannot be read or that names something wrong."""


@dataclass(frozen=True)
class AgentEntry:
    """One agent: its extractor's namespace, input topic, mode and own parameters (dotted).

    With `map`, the path of a .tmap file, it is a map of another day and has no extractor.
    """

    id: str
    namespace: str
    cloud: str = "cloud"
    mode: str = "auto"
    params: Mapping[str, Any] = field(default_factory=dict)
    map: str = ""


@dataclass(frozen=True)
class AgentsFile:
    """A fleet: its agents in order, the parameters of all extractors and those of the merger.

    `simulation` are the parameters of the player, None where the agents are real.
    """

    agents: tuple[AgentEntry, ...]
    extractor_params: Mapping[str, Any] = field(default_factory=dict)
    merger_namespace: str = ""
    merger_params: Mapping[str, Any] = field(default_factory=dict)
    simulation: Mapping[str, Any] | None = None

    @property
    def live(self) -> tuple[AgentEntry, ...]:
        """The agents that have an extractor."""
        return tuple(agent for agent in self.agents if not agent.map)


def read_agents_file(path: Path | str) -> AgentsFile:
    """Read and check an agents file.

    Raises
    ------
    AgentsFileError
        The file is missing, is not YAML, or holds an unknown key, a bad name or a duplicate.
    """
    try:
        text = Path(path).read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise AgentsFileError(f"cannot read agents file {path}: {error}") from error
    try:
        tree = load_yaml(text)
    except ConfigurationError as error:
        raise AgentsFileError(f"{path}: {error}") from error
    return parse_agents(tree, str(path), Path(path).parent)


def parse_agents(tree: Any, where: str = "agents file", folder: Path = Path()) -> AgentsFile:
    """Check the content of an agents file; `where` begins every error message.

    Paths of maps are relative to `folder`.

    Raises
    ------
    AgentsFileError
        As :func:`read_agents_file`.
    """
    root = _mapping(tree, _ROOT_KEYS, where)
    entries = root.get("agents")
    if not isinstance(entries, list) or not entries:
        raise AgentsFileError(f"{where}: expected a list `agents` with at least one agent")
    agents = tuple(
        _agent(entry, f"{where}: agents[{i}]", folder) for i, entry in enumerate(entries)
    )
    for name in ("id", "namespace"):
        values = [getattr(agent, name) for agent in agents]
        twice = sorted({value for value in values if values.count(value) > 1})
        if twice:
            raise AgentsFileError(f"{where}: {name} {', '.join(twice)} is used more than once")
    extractor = _mapping(root.get("extractor"), ("params",), f"{where}: extractor")
    merger = _mapping(root.get("merger"), ("namespace", "params"), f"{where}: merger")
    namespace = _text(merger, "namespace", "", _NAMESPACE, f"{where}: merger")
    return AgentsFile(
        agents=agents,
        extractor_params=_params(extractor.get("params"), f"{where}: extractor"),
        merger_namespace=namespace.rstrip("/"),
        merger_params=_params(merger.get("params"), f"{where}: merger"),
        simulation=_simulation(root, where),
    )


def simulated_fleet(params: Mapping[str, Any], agents: int) -> AgentsFile:
    """Return a fleet of so many simulated agents, see :func:`simulated_names`."""
    names = simulated_names(agents)
    entries = tuple(AgentEntry(name, f"/{name}", "scan_cloud", "scan") for name in names)
    return AgentsFile(entries, simulation={**params, "agents": agents})


def simulated_names(agents: int) -> tuple[str, ...]:
    """Return what the agents of a live simulated fleet are called, as in the layouts that ship.

    Examples
    --------
    >>> simulated_names(2)
    ('robot1', 'robot2')
    """
    return tuple(f"robot{number}" for number in range(1, agents + 1))


def agent_of_namespace(namespace: str) -> str:
    """Return the id of an agent that is known by its namespace only.

    Examples
    --------
    >>> agent_of_namespace("/fleet/robot1")
    'fleet_robot1'
    """
    return namespace.strip("/").replace("/", "_")


def extractor_arguments(fleet: AgentsFile, agent: AgentEntry) -> list[str]:
    """Return the arguments with which `topometric-extractor` becomes this agent's extractor."""
    told = {name: fleet.merger_params[name] for name in _SHARED if name in fleet.merger_params}
    params = {
        **told,
        **fleet.extractor_params,
        **agent.params,
        "agent": agent.id,
        "mode": agent.mode,
    }
    arguments = ["--ros-args", "-r", f"__ns:={agent.namespace}"]
    if agent.cloud != "cloud":
        arguments += ["-r", f"cloud:={agent.cloud}"]
    return arguments + _parameter_arguments(params)


def merger_arguments(fleet: AgentsFile) -> list[str]:
    """Return the arguments with which `topometric-merger` merges this fleet."""
    arguments = ["--ros-args"]
    if fleet.merger_namespace:
        arguments += ["-r", f"__ns:={fleet.merger_namespace}"]
    agents = [_merger_entry(agent) for agent in fleet.agents]
    return arguments + _parameter_arguments({**fleet.merger_params, "agents": agents})


def player_arguments(fleet: AgentsFile) -> list[str]:
    """Return the arguments with which the player simulates this fleet."""
    return ["--ros-args", *_parameter_arguments(fleet.simulation or {})]


def _merger_entry(agent: AgentEntry) -> str:
    """Return an agent as the merger's parameter `agents` names it."""
    if agent.map:
        return f"{agent.id}={agent.map}"
    told = agent_of_namespace(agent.namespace) == agent.id
    return agent.namespace if told else f"{agent.id}={agent.namespace}"


def _parameter_arguments(params: Mapping[str, Any]) -> list[str]:
    arguments: list[str] = []
    for name, value in params.items():
        flow = yaml.safe_dump(value, default_flow_style=True, width=float("inf"))
        arguments += ["-p", f"{name}:={flow.removesuffix(chr(10)).removesuffix('...').strip()}"]
    return arguments


def _agent(entry: Any, where: str, folder: Path | str) -> AgentEntry:
    tree = _mapping(entry, _AGENT_KEYS, where)
    if "id" not in tree:
        raise AgentsFileError(f"{where}: an agent needs an `id`")
    name = _text(tree, "id", "", _ID, where)
    if "map" in tree:
        return AgentEntry(name, f"/{name}", map=_map_path(tree, where, folder))
    namespace = _text(tree, "namespace", f"/{name}", _NAMESPACE, where)
    mode = tree.get("mode", "auto")
    if mode not in MODES:
        raise AgentsFileError(f"{where}: mode: expected one of {', '.join(MODES)}, got {mode!r}")
    return AgentEntry(
        id=name,
        namespace=f"/{namespace.strip('/')}",
        cloud=_text(tree, "cloud", "cloud", _TOPIC, where),
        mode=mode,
        params=_params(tree.get("params"), where),
    )


def _map_path(tree: Mapping[str, Any], where: str, folder: Path | str) -> str:
    """Return the absolute path of an agent's map file, which must be there."""
    live = [key for key in _LIVE_KEYS if key in tree]
    if live:
        raise AgentsFileError(f"{where}: an agent that is a `map` has no `{live[0]}`")
    name = tree["map"]
    if not isinstance(name, str) or not name.endswith(".tmap"):
        raise AgentsFileError(f"{where}: map: expected a .tmap file, got {name!r}")
    path = (Path(folder) / Path(name).expanduser()).absolute()
    if not path.is_file():
        raise AgentsFileError(f"{where}: map: no file {path}")
    return str(path)


def _simulation(root: Mapping[str, Any], where: str) -> dict[str, Any] | None:
    if "simulation" not in root:
        return None
    tree = _mapping(root["simulation"], ("params",), f"{where}: simulation")
    return _params(tree.get("params"), f"{where}: simulation")


def _mapping(tree: Any, known: tuple[str, ...], where: str) -> Mapping[str, Any]:
    if tree is None:
        return {}
    if not isinstance(tree, Mapping):
        raise AgentsFileError(f"{where}: expected keys {', '.join(known)}, got {tree!r}")
    for key in tree:
        if key not in known:
            raise AgentsFileError(f"{where}: unknown key {key!r}; known: {', '.join(known)}")
    return tree


def _text(
    tree: Mapping[str, Any], key: str, default: str, pattern: re.Pattern[str], where: str
) -> str:
    value = tree.get(key, default)
    if not isinstance(value, str) or not pattern.match(value):
        raise AgentsFileError(f"{where}: {key}: {value!r} is no valid ROS name")
    return value


def _params(tree: Any, where: str) -> dict[str, Any]:
    """Return nested parameters as dotted names."""
    if tree is None:
        return {}
    if not isinstance(tree, Mapping):
        raise AgentsFileError(f"{where}: params: expected names and values, got {tree!r}")
    flat: dict[str, Any] = {}
    for key, value in tree.items():
        if isinstance(value, Mapping):
            flat |= {f"{key}.{name}": v for name, v in _params(value, where).items()}
        elif isinstance(value, (bool, int, float, str, list)):
            flat[str(key)] = value
        else:
            raise AgentsFileError(f"{where}: params.{key}: {value!r} is no parameter value")
    return flat
