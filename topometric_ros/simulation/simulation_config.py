"""What people write about a simulation: a YAML file of parameters, and walks as words.

overlap: 0.35
sensor: {pattern: camera}
degrade: {drift: 0.01, dropout: 0.1}
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from topometric_ros.configuration import from_nested, with_values
from topometric_ros.errors import ConfigurationError
from topometric_ros.simulation.cases import SimulationConfig
from topometric_ros.simulation.sidecars import waypoints_of
from topometric_ros.simulation.trajectories import TrajectoryError, Walk
from topometric_ros.yaml_text import load_yaml


def load_simulation_config(
    path: Path | None,
    values: Mapping[str, Any] | None = None,
    defaults: SimulationConfig | None = None,
) -> SimulationConfig:
    """Return the defaults, changed by a YAML file and then by values that are not None.

    Raises
    ------
    ConfigurationError
        The file is not YAML, or names something unknown or out of its range.
    """
    config = defaults or SimulationConfig()
    if path is not None:
        try:
            tree = load_yaml(path.read_text(encoding="utf-8")) or {}
            if not isinstance(tree, Mapping):
                raise ConfigurationError(f"expected parameter names and values, got {tree!r}")
            config = from_nested(config, tree)
        except OSError as error:
            raise ConfigurationError(f"{path}: {error.strerror}") from error
        except UnicodeDecodeError as error:
            raise ConfigurationError(f"{path}: not YAML: {error}") from error
        except ConfigurationError as error:
            raise ConfigurationError(f"{path}: {error}") from error
    given = {name: value for name, value in (values or {}).items() if value is not None}
    return with_values(config, given)


def parse_walk(text: str) -> Walk:
    """Read a walk: room ids with commas, or waypoints x y [z] in metres with semicolons.

    A waypoint without z lies on the lowest floor there.

    Raises
    ------
    TrajectoryError
        It is neither.

    Examples
    --------
    >>> parse_walk("0, 4, 7").rooms
    (0, 4, 7)
    >>> parse_walk("1.5 2; 4 2 0.1").waypoints.tolist()
    [[1.5, 2.0, nan], [4.0, 2.0, 0.1]]
    """
    try:
        if ";" not in text:
            return Walk(rooms=tuple(int(room) for room in text.split(",")))
        return Walk(waypoints=waypoints_of([stop.split() for stop in text.split(";")]))
    except ValueError as error:
        raise TrajectoryError(
            f"walk: expected room ids (0,4,7) or waypoints (1.5 2 0; 4 2 0), got {text!r}"
        ) from error
