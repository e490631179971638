"""The merger's parameter `agents`: namespaces, or ``id=namespace`` where the two differ."""

from __future__ import annotations

from collections.abc import Sequence

from topometric_ros.errors import ConfigurationError
from topometric_ros.runtime.agents_file import agent_of_namespace


def parse_agents(entries: Sequence[str]) -> dict[str, str]:
    """Return ``{agent: namespace}`` in order.

    Raises
    ------
    ConfigurationError
        An agent or a namespace is empty or named twice.

    Examples
    --------
    >>> parse_agents(["/robot1", "left=/fleet/robot2"])
    {'robot1': '/robot1', 'left': '/fleet/robot2'}
    """
    agents: dict[str, str] = {}
    for entry in entries:
        before, separator, after = entry.partition("=")
        namespace = (after if separator else before).rstrip("/")
        agent = before if separator else agent_of_namespace(namespace)
        if not agent:
            raise ConfigurationError(f"expected a namespace or id=namespace, got {entry!r}")
        if agent in agents or namespace in agents.values():
            raise ConfigurationError(f"{entry!r} names an agent twice")
        agents[agent] = namespace
    return agents
