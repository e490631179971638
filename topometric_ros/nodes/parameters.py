"""ROS parameters declared from the configuration dataclasses, validated at start and on change.

The dotted names, defaults, ranges and descriptions are those of the dataclasses; nothing is said
twice. A parameter file that was dumped from a running node starts it again.
"""

from __future__ import annotations

import array
import sys
from collections.abc import Callable, Collection, Sequence
from typing import Any

from rcl_interfaces.msg import (
    FloatingPointRange,
    IntegerRange,
    ParameterDescriptor,
    SetParametersResult,
)
from rclpy.node import Node
from rclpy.parameter import Parameter

from topometric_ros.configuration import ParameterInfo, near_names, parameters, with_values
from topometric_ros.errors import ConfigurationError

_OF_RCLPY = ("use_sim_time", "start_type_description_service", "qos_overrides.")

_INT64_MAX = 2**63 - 1

Configs = tuple[Any, ...]


def override(node: Node, name: str, default: Any) -> Any:
    """Return what the command line or a parameter file says of a parameter, before declaring it.

    The node must be made with `automatically_declare_parameters_from_overrides`.
    """
    value = node.get_parameter(name).value if node.has_parameter(name) else default
    return value.tolist() if isinstance(value, array.array) else value


def infos(configs: Sequence[Any]) -> list[ParameterInfo]:
    """Return what is known of every parameter of some configurations, in order."""
    return [info for config in configs for info, _ in parameters(config)]


def declare(node: Node, configs: Sequence[Any], fixed: Collection[str]) -> Configs:
    """Declare every parameter of some configurations and return them with the overrides in.

    Parameters
    ----------
    node
        Made with `automatically_declare_parameters_from_overrides`.
    configs
        Configuration dataclasses without a name in common; their values are the defaults.
    fixed
        Names of the parameters that cannot change while the node runs.

    Raises
    ------
    ConfigurationError
        An override has a wrong type or lies outside its range.
    """
    known = infos(configs)
    overrides = {info.name: override(node, info.name, info.default) for info in known}
    updated = _updated(configs, overrides)
    _warn_of_unknown(node, {info.name for info in known})
    values = [value for config in updated for _, value in parameters(config)]
    for info, value in zip(known, values, strict=True):
        if node.has_parameter(info.name):
            node.undeclare_parameter(info.name)
        _declare(node, info, value, info.name in fixed)
    return updated


def _declare(node: Node, info: ParameterInfo, value: Any, read_only: bool) -> None:
    """Declare one parameter with its value; an empty list is not taken for one of bytes."""
    if value != ():
        value = list(value) if isinstance(value, tuple) else value
        node.declare_parameter(info.name, value, _descriptor(info, read_only), True)
        return
    numbers = info.item is float
    kind = Parameter.Type.DOUBLE_ARRAY if numbers else Parameter.Type.STRING_ARRAY
    node.declare_parameter(info.name, kind, _descriptor(info, False), True)
    node.set_parameters([Parameter(info.name, kind, [])])
    descriptor = _descriptor(info, read_only)
    descriptor.type = kind.value
    node.set_descriptor(info.name, descriptor)


def on_change(node: Node, configs: Configs, changed: Callable[[Configs], None]) -> None:
    """Call `changed` with the new configurations whenever valid values are set.

    What is not valid is refused, with the reason in the result of the set; so is what `changed`
    raises a ConfigurationError for.
    """
    present = [configs]

    def check(changes: list[Parameter]) -> SetParametersResult:
        known = {info.name for info in infos(configs)}
        values = {p.name: p.value for p in changes if p.name in known}
        if not values:
            return SetParametersResult(successful=True)
        try:
            updated = _updated(present[0], values)
            changed(updated)
        except ConfigurationError as error:
            return SetParametersResult(successful=False, reason=str(error))
        present[0] = updated
        return SetParametersResult(successful=True)

    node.add_on_set_parameters_callback(check)


def _updated(configs: Sequence[Any], values: dict[str, Any]) -> Configs:
    result = []
    for config in configs:
        own = {info.name for info, _ in parameters(config)}
        result.append(with_values(config, {n: v for n, v in values.items() if n in own}))
    return tuple(result)


def _warn_of_unknown(node: Node, known: set[str]) -> None:
    """Name overrides that no configuration knows: a misspelt parameter must not go unseen."""
    given = [name for name in node.get_parameters_by_prefix("") if name not in known]
    unknown = sorted(name for name in given if not name.startswith(_OF_RCLPY))
    if unknown:
        near = {name: near_names(name, sorted(known)) for name in unknown}
        told = [f"{n} (did you mean {near[n][0]}?)" if near[n] else n for n in unknown]
        node.get_logger().warning(f"unknown parameters are ignored: {', '.join(told)}")


def _descriptor(info: ParameterInfo, read_only: bool) -> ParameterDescriptor:
    unit = f" [{info.unit}]" if info.unit else ""
    descriptor = ParameterDescriptor(description=info.description + unit, read_only=read_only)
    descriptor.additional_constraints = info.constraint
    if info.minimum is None and info.maximum is None:
        return descriptor
    if info.kind is int:
        low = -_INT64_MAX if info.minimum is None else int(info.minimum)
        high = _INT64_MAX if info.maximum is None else int(info.maximum)
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=0)]
    elif info.kind is float:
        low_f = -sys.float_info.max if info.minimum is None else float(info.minimum)
        high_f = sys.float_info.max if info.maximum is None else float(info.maximum)
        descriptor.floating_point_range = [
            FloatingPointRange(from_value=low_f, to_value=high_f, step=0.0)
        ]
    return descriptor
