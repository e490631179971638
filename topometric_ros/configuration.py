"""Configuration dataclasses as the single source of defaults, units, ranges and descriptions.

A stage's configuration is a frozen dataclass whose fields are made by :func:`parameter`. Nested
dataclasses give dotted names (``rooms.visibility_range``); the same names are the keys of the YAML
files, the ROS parameters of the nodes and the rows of the reference in ``docs/``.
"""

from __future__ import annotations

import array
import dataclasses
import difflib
import importlib.util
import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar, get_args, get_type_hints

from topometric_ros.errors import ConfigurationError

ConfigT = TypeVar("ConfigT")

_MANY = 20
"""More names than this are not all told."""

_SCALARS = (bool, int, float, str)


@dataclass(frozen=True)
class ParameterInfo:
    """What is known of one parameter: its dotted name, type, default and limits.

    `kind` is bool, int, float, str or tuple, `item` what a tuple holds: float or str. The limits of
    a tuple are those of its items, and it has `count` of them: least and most.
    """

    name: str
    kind: type
    item: type
    default: Any
    unit: str
    description: str
    minimum: float | None
    maximum: float | None
    choices: tuple[str, ...]
    count: tuple[int, int | None]
    rule: Callable[[Any], object] | None

    @property
    def constraint(self) -> str:
        """What a value must be that no range of numbers says, in words; empty: nothing."""
        if self.kind is not tuple:
            return f"one of {', '.join(self.choices)}" if self.choices else ""
        least, most = self.count
        what = "numbers" if self.item is float else "texts"
        if least or most:
            what = f"{least} {what}" if least == most else f"{least} or more {what}"
        among = f" out of {', '.join(self.choices)}" if self.choices else ""
        limits = self.limits()
        return f"a list of {what}{among}{limits and f', each {limits}'}"

    def limits(self) -> str:
        """Return the range in words with its unit; empty: there is none."""
        if self.minimum is None and self.maximum is None:
            return ""
        if self.maximum is None:
            return f"at least {self.minimum} {self.unit}".rstrip()
        if self.minimum is None:
            return f"at most {self.maximum} {self.unit}".rstrip()
        return f"{self.minimum}..{self.maximum} {self.unit}".rstrip()

    def check(self, value: Any) -> Any:
        """Return `value` in the parameter's own type.

        Raises
        ------
        ConfigurationError
            Wrong type, not finite, outside the range, not one of the choices, or against the
            parameter's own rule.
        """
        value = self._items(value) if self.kind is tuple else self._scalar(value)
        if self.rule is not None:
            try:
                self.rule(value)
            except ConfigurationError as error:
                raise ConfigurationError(f"{self.name}: {error}") from error
        return value

    def _items(self, value: Any) -> tuple[Any, ...]:
        """Return a list's items in their type; numbers may come as texts."""
        value = value.tolist() if isinstance(value, array.array) else value
        wrong = f"{self.name}: expected {self.constraint}, got {value!r}"
        if not isinstance(value, (list, tuple)):
            raise ConfigurationError(wrong)
        try:
            items = tuple(self.item(item) for item in value)
        except (TypeError, ValueError) as error:
            raise ConfigurationError(wrong) from error
        least, most = self.count
        fits = least <= len(items) and (most is None or len(items) <= most)
        if not fits or not all(map(self._is_allowed, items)):
            raise ConfigurationError(wrong)
        return items

    def _is_allowed(self, value: Any) -> bool:
        """Whether a number or a text is within the limits."""
        if self.choices:
            return value in self.choices
        if self.item is float and not math.isfinite(value):
            return False
        below = self.minimum is not None and value < self.minimum
        return not below and (self.maximum is None or value <= self.maximum)

    def _scalar(self, value: Any) -> Any:
        if self.kind is float and isinstance(value, int) and not isinstance(value, bool):
            value = float(value)
        if type(value) is not self.kind:
            raise ConfigurationError(f"{self.name}: expected {self.kind.__name__}, got {value!r}")
        if self.kind is float and not math.isfinite(value):  # type: ignore[arg-type]
            raise ConfigurationError(f"{self.name}: expected a finite number, got {value!r}")
        if not self._is_allowed(value):
            expected = self.constraint or self.limits()
            raise ConfigurationError(f"{self.name}: expected {expected}, got {value!r}")
        return value


def parameter(
    default: Any,
    description: str,
    *,
    unit: str = "",
    minimum: float | None = None,
    maximum: float | None = None,
    choices: tuple[str, ...] = (),
    count: tuple[int, int | None] = (0, None),
    rule: Callable[[Any], object] | None = None,
) -> Any:
    """Declare a dataclass field with its unit, range and one-sentence description.

    `rule` raises ConfigurationError, without the parameter's name, for a value of the right type
    that makes no sense. Of a tuple, range and choices are those of its items, and `count` says how
    many there are, least and most.
    """
    return dataclasses.field(
        default=default,
        metadata={
            "description": description,
            "unit": unit,
            "minimum": minimum,
            "maximum": maximum,
            "choices": choices,
            "count": count,
            "rule": rule,
        },
    )


def missing_extra(needed_by: str, module: str, extra: str) -> ConfigurationError:
    """Return the error that says which extra of the package brings a module that is missing."""
    return ConfigurationError(f"{needed_by} needs {module}: pip install 'topometric_ros[{extra}]'")


def needs_extras(needed: Mapping[str, tuple[str, str]]) -> Callable[[Any], None]:
    """Return a rule for choices that need more than what is always installed.

    It is told where they are chosen, not when they are first used.

    Parameters
    ----------
    needed : module and extra of the package, by choice
    """

    def rule(value: Any) -> None:
        for choice in value if isinstance(value, tuple) else (value,):
            module, extra = needed.get(choice, ("", ""))
            if module and importlib.util.find_spec(module) is None:
                raise missing_extra(choice, module, extra)

    return rule


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
        item = get_args(kinds[field.name])[0] if kind is tuple else kind
        yield ParameterInfo(name=name, kind=kind, item=item, default=value, **field.metadata), value


def flatten(config: Any) -> dict[str, Any]:
    """Return ``{dotted name: value}`` of a configuration."""
    return {info.name: value for info, value in parameters(config)}


def validate(config: Any) -> None:
    """Check every value of a configuration that was not made by :func:`with_values`.

    Raises
    ------
    ConfigurationError
        As :func:`with_values`.
    """
    for info, value in parameters(config):
        info.check(value)


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
            raise ConfigurationError(f"unknown parameter {name!r}; {_likely(name, list(known))}")
    return _replace(config, {n: known[n].check(v) for n, v in values.items()}, "")


def near_names(name: str, known: Sequence[str]) -> list[str]:
    """Return which of the known names may have been meant by an unknown one, likeliest first."""
    leaves = [other for other in known if other.rsplit(".", 1)[-1] == name.rsplit(".", 1)[-1]]
    return list(dict.fromkeys([*leaves, *difflib.get_close_matches(name, known)]))


def _likely(name: str, known: list[str]) -> str:
    """Return which names may have been meant: those like it, or all where they are few."""
    near = near_names(name, known)
    if near and len(known) > _MANY:
        return f"did you mean {' or '.join(near)}?"
    shown = known if len(known) <= _MANY else [*known[:_MANY], f"and {len(known) - _MANY} more"]
    return f"known: {', '.join(shown)}"


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
