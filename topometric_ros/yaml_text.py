"""YAML as people write it: whatever is wrong with it is told in one line.

PyYAML raises four kinds of errors, and builds a text of a few hundred bytes whose aliases unfold to
gigabytes: printing such a tree in an error would take all memory.
"""

from __future__ import annotations

from typing import Any

import yaml

from topometric_ros.errors import ConfigurationError, one_line

_MOST_VALUES = 1_000_000
"""Values that a text may hold, those of its aliases counted where they stand."""


def load_yaml(text: str) -> Any:
    """Return what a YAML text holds.

    Raises
    ------
    ConfigurationError
        It is no YAML, holds a number or a date that cannot be, an alias of what it is in, or
        unfolds to more than a million values.
    """
    try:
        loader = yaml.SafeLoader(text)
        node = loader.get_single_node()
        if node is None:
            return None
        values = _values(node, {})
        if values > _MOST_VALUES:
            raise ConfigurationError(f"{values} values with its aliases, at most {_MOST_VALUES}")
        return loader.construct_document(node)
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise ConfigurationError(f"not YAML: {one_line(error)}") from error
    except RecursionError as error:
        raise ConfigurationError("not YAML: nested too deeply") from error


def _values(node: yaml.Node, known: dict[int, int]) -> int:
    """Return how many values a node unfolds to; raises ConfigurationError where it holds itself."""
    if isinstance(node, yaml.ScalarNode):
        return 1
    if id(node) in known:
        if known[id(node)] == 0:
            raise ConfigurationError("an alias in it refers to what holds it")
        return known[id(node)]
    known[id(node)] = 0
    inner = node.value
    if isinstance(node, yaml.MappingNode):
        inner = [part for pair in node.value for part in pair]
    known[id(node)] = 1 + sum(_values(part, known) for part in inner)
    return known[id(node)]
