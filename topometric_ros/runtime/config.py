"""One YAML file for extraction and merging: a preset and what differs from it.

    preset: default            # or thesis
    extraction:
      voxel_size: 0.1
    merge:
      global_frame: global

The names below `extraction` and `merge` are those of the configuration dataclasses, which hold the
defaults; a file need only name what it changes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from topometric_ros.configuration import from_nested, nested, with_values
from topometric_ros.errors import ConfigurationError
from topometric_ros.extraction.config import PRESETS, ExtractionConfig, extraction_preset
from topometric_ros.fusion.config import MergeConfig, merge_preset
from topometric_ros.yaml_text import load_yaml

_KEYS = ("preset", "extraction", "merge")


@dataclass(frozen=True)
class ToolConfig:
    """What the command line needs to know: the preset's name and both configurations."""

    preset: str
    extraction: ExtractionConfig
    merge: MergeConfig


def preset_config(name: str) -> ToolConfig:
    """Return a preset's configuration; raises ConfigurationError for an unknown name."""
    return ToolConfig(name, extraction_preset(name), merge_preset(name))


def load_config(path_or_preset: Path | str = "default") -> ToolConfig:
    """Return a preset's configuration, or read it from a YAML file.

    Raises
    ------
    ConfigurationError
        Neither a preset nor a file, or the file is not YAML or names something unknown.
    """
    if str(path_or_preset) in PRESETS:
        return preset_config(str(path_or_preset))
    path = Path(path_or_preset)
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = error.strerror if isinstance(error, OSError) else error
        raise ConfigurationError(
            f"{path}: neither a preset ({', '.join(PRESETS)}) nor a readable file: {reason}"
        ) from error
    try:
        return parse_config(load_yaml(text))
    except ConfigurationError as error:
        raise ConfigurationError(f"{path}: {error}") from error


def parse_config(tree: Any) -> ToolConfig:
    """Return the configuration that the content of a YAML file describes.

    Raises
    ------
    ConfigurationError
        An unknown key or preset, a wrong type, or a value outside its range.
    """
    tree = {} if tree is None else tree
    if not isinstance(tree, Mapping):
        raise ConfigurationError(f"expected the keys {', '.join(_KEYS)}, got {tree!r}")
    unknown = [key for key in tree if key not in _KEYS]
    if unknown:
        raise ConfigurationError(f"unknown key {unknown[0]!r}; known: {', '.join(_KEYS)}")
    base = preset_config(tree.get("preset") or "default")
    return ToolConfig(
        base.preset,
        from_nested(base.extraction, _branch(tree, "extraction")),
        from_nested(base.merge, _branch(tree, "merge")),
    )


def with_voxel_size(config: ToolConfig, voxel_size: float | None) -> ToolConfig:
    """Return the configuration with another voxel size (m); None leaves it as it is."""
    if voxel_size is None:
        return config
    extraction = with_values(config.extraction, {"voxel_size": float(voxel_size)})
    return ToolConfig(config.preset, extraction, config.merge)


def dump_config(config: ToolConfig) -> str:
    """Return the YAML text of a whole configuration, as :func:`load_config` reads it."""
    tree = {
        "preset": config.preset,
        "extraction": nested(config.extraction),
        "merge": nested(config.merge),
    }
    return yaml.safe_dump(tree, sort_keys=False, allow_unicode=True)


def _branch(tree: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    branch = tree.get(key) or {}
    if not isinstance(branch, Mapping):
        raise ConfigurationError(f"{key}: expected parameter names and values, got {branch!r}")
    return branch
