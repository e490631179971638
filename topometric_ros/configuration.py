"""Configuration dataclasses as the single source of defaults, units, ranges and descriptions.

A stage's configuration is a frozen dataclass whose fields are made by :func:`parameter`. Nested
dataclasses give dotted names (``rooms.visibility_range``); the same names are the keys of the YAML
files, the ROS parameters of the nodes and the rows of the reference in ``docs/``.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, TypeVar, get_type_hints

from topometric_ros.errors import ConfigurationError

ConfigT = TypeVar("ConfigT")

_SCALARS = (bool, int, float, str)


@dataclass(frozen=True)
class ParameterInfo:
    """What is known of one parameter: its dotted name, type, default and limits."""

    name: str
    kind: type
    default: Any
    unit: str
    description: str
    minimum: float | None
    maximum: float | None
    choices: tuple[str, ...]

    def check(self, value: Any) -> Any:
        """Return `value` in the parameter's own type.

        Raises
        ------
        ConfigurationError
            Wrong type, not finite, outside the range or not one of the choices.
        """
        if self.kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if self.kind is tuple and isinstance(value, (list, tuple)):
            return tuple(str(item) for item in value)
        if type(value) is not self.kind:
            raise ConfigurationError(f"{self.name}: expected {self.kind.__name__}, got {value!r}")
        if self.kind is float and not math.isfinite(value):  # type: ignore[arg-type]
            raise ConfigurationError(f"{self.name}: expected a finite number, got {value!r}")
        below = self.minimum is not None and value < self.minimum  # type: ignore[operator]
        above = self.maximum is not None and value > self.maximum  # type: ignore[operator]
        if below or above:
            raise ConfigurationError(
                f"{self.name}: expected {self.minimum}..{self.maximum} {self.unit}".rstrip()
                + f", got {value!r}"
            )
        if self.choices and value not in self.choices:
            raise ConfigurationError(
                f"{self.name}: expected one of {', '.join(self.choices)}, got {value!r}"
            )
        return value


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
) -> Any:
    """Declare a dataclass field with its unit, range and one-sentence description."""
    return dataclasses.field(
        default=default,
        metadata={
            "description": description,
            "unit": unit,
            "minimum": minimum,
            "maximum": maximum,
            "choices": choices,
        },
    )


def parameters(config: Any, prefix: str = "") -> Iterator[tuple[ParameterInfo, Any]]:
    """Yield every parameter below a configuration with its present value, in declaration order.

    The `default` of each is the value that `config` holds.
    """
    kinds = get_type_hints(type(config))
    for field in dataclasses.fields(config):
        value = getattr(config, field.name)
        name = f"{prefix}{field.name}"
        if dataclasses.is_dataclass(value):
            yield from parameters(value, f"{name}.")
            continue
        kind = next((k for k in _SCALARS if kinds[field.name] is k), tuple)
        meta = field.metadata
        yield (
            ParameterInfo(
                name=name,
                kind=kind,
                default=value,
                unit=meta["unit"],
                description=meta["description"],
                minimum=meta["minimum"],
                maximum=meta["maximum"],
                choices=meta["choices"],
            ),
            value,
        )


def flatten(config: Any) -> dict[str, Any]:
    """Return ``{dotted name: value}`` of a configuration."""
    return {info.name: value for info, value in parameters(config)}


def with_values(config: ConfigT, values: Mapping[str, Any]) -> ConfigT:
    """Return a copy of `config` with the dotted names in `values` replaced.

    Raises
    ------
    ConfigurationError
        Unknown name, wrong type or a value outside its range.
    """
    known = {info.name: info for info, _ in parameters(config)}
    for name in values:
        if name not in known:
            raise ConfigurationError(f"unknown parameter {name!r}; known: {', '.join(known)}")
    return _replace(config, {n: known[n].check(v) for n, v in values.items()}, "")


def _replace(config: Any, values: Mapping[str, Any], prefix: str) -> Any:
    changes = {}
    for field in dataclasses.fields(config):
        name = f"{prefix}{field.name}"
        value = getattr(config, field.name)
        if dataclasses.is_dataclass(value):
            changes[field.name] = _replace(value, values, f"{name}.")
        elif name in values:
            changes[field.name] = values[name]
    return dataclasses.replace(config, **changes)


def nested(config: Any) -> dict[str, Any]:
    """Return a configuration as the nested dictionary that its YAML file holds."""
    result: dict[str, Any] = {}
    for name, value in flatten(config).items():
        *path, leaf = name.split(".")
        branch = result
        for key in path:
            branch = branch.setdefault(key, {})
        branch[leaf] = list(value) if isinstance(value, tuple) else value
    return result


def from_nested(config: ConfigT, tree: Mapping[str, Any]) -> ConfigT:
    """Return a copy of `config` with the values of a nested dictionary replaced.

    Raises
    ------
    ConfigurationError
        As :func:`with_values`.
    """
    flat: dict[str, Any] = {}

    def walk(branch: Mapping[str, Any], prefix: str) -> None:
        for key, value in branch.items():
            if isinstance(value, Mapping):
                walk(value, f"{prefix}{key}.")
            else:
                flat[f"{prefix}{key}"] = value

    walk(tree, "")
    return with_values(config, flat)
