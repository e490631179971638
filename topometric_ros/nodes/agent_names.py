"""The merger's parameter `agents`: namespaces, ``id=namespace`` where the two differ, map files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import PurePath

from topometric_ros.errors import ConfigurationError
from topometric_ros.runtime.agents_file import agent_of_namespace
from topometric_ros.runtime.bag_sources import AGENT_NAME, NAME_EXPECTED

_NAMESPACE = re.compile(r"/?[A-Za-z_][A-Za-z0-9_]*(/[A-Za-z_][A-Za-z0-9_]*)*")


def check_agent(agent: str) -> None:
    """Raise ConfigurationError for a name that no agent can have; the command's are the same."""
    if not AGENT_NAME.fullmatch(agent):
        raise ConfigurationError(f"agent: {NAME_EXPECTED}, got {agent!r}")


def is_map_file(place: str) -> bool:
    """Whether an agent's maps come from a file: no namespace has a dot in it."""
    return place.endswith(".tmap")


def parse_agents(entries: Sequence[str]) -> dict[str, str]:
    """Return ``{agent: namespace}`` in order; for an agent that is a file, its path.

    Raises
    ------
    ConfigurationError
        An agent or a namespace is impossible or named twice.

    Examples
    --------
    >>> parse_agents(["/robot1", "left=/fleet/robot2"])
    {'robot1': '/robot1', 'left': '/fleet/robot2'}
    >>> parse_agents(["/maps/monday.tmap", "old=/maps/b.tmap"])
    {'monday': '/maps/monday.tmap', 'old': '/maps/b.tmap'}
    """
    agents: dict[str, str] = {}
    for entry in entries:
        before, separator, after = entry.partition("=")
        namespace = (after if separator else before).rstrip("/")
        name = PurePath(before).stem if is_map_file(before) else agent_of_namespace(namespace)
        agent = before if separator else name
        possible = is_map_file(namespace) or _NAMESPACE.fullmatch(namespace)
        if not (AGENT_NAME.fullmatch(agent) and possible):
            raise ConfigurationError(f"expected a namespace or id=namespace, got {entry!r}")
        if agent in agents or namespace in agents.values():
            raise ConfigurationError(f"{entry!r} names an agent twice")
        agents[agent] = namespace
    return agents
