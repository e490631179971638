"""Parameter files that say nothing to a node: ROS passes over other names in silence."""

from __future__ import annotations

import difflib
import itertools
import re
from collections.abc import Sequence
from pathlib import Path

from topometric_ros.errors import ConfigurationError
from topometric_ros.yaml_text import load_yaml

_ALIKE = 0.75
"""From how alike two names are (`difflib`) one may be meant for the other."""


def passed_over(arguments: Sequence[str], node: str) -> list[str]:
    """Return in words which parameter files name a node like this one, but not this one.

    A file without anything for the node is no wonder where several nodes share it; one with a
    section for a node called the same in another namespace, or nearly the same, is.

    Parameters
    ----------
    arguments : the process's, with `--params-file FILE`
    node : full name of the node

    Examples
    --------
    >>> passed_over(["merger", "--ros-args"], "/merger")
    []
    """
    lines = []
    for flag, file in itertools.pairwise(arguments):
        names = _sections(file) if flag == "--params-file" else []
        own = node.rpartition("/")[2]
        alike = [
            n for n in names if difflib.get_close_matches(n.rpartition("/")[2], [own], 1, _ALIKE)
        ]
        if alike and not any(re.fullmatch(_pattern(name), node) for name in names):
            lines.append(f"{file} holds nothing for {node}: it names {', '.join(alike)}")
    return lines


def _sections(file: str) -> list[str]:
    """Return the full names of the nodes that a parameter file is for; rcl has read it before."""
    try:
        tree = load_yaml(Path(file).read_text(encoding="utf-8"))
    except (OSError, ValueError, ConfigurationError):
        return []
    names: list[str] = []

    def walk(branch: object, name: str) -> None:
        if not isinstance(branch, dict):
            return
        if "ros__parameters" in branch:
            names.append(name)
            return
        for key, value in branch.items():
            walk(value, f"{name}/{str(key).strip('/')}")

    walk(tree, "")
    return names


def _pattern(name: str) -> str:
    """Return a regular expression for a section's name, in which * is a part and ** any number."""
    parts = {"*": "/[^/]+", "**": "(/[^/]+)*"}
    return "".join(parts.get(part, "/" + re.escape(part)) for part in name.strip("/").split("/"))
