"""One YAML file configures extraction and merging; a wrong one is told in one line."""

from __future__ import annotations

from pathlib import Path

import pytest

from topometric_ros.errors import ConfigurationError
from topometric_ros.runtime.config import (
    dump_config,
    load_config,
    parse_config,
    preset_config,
    with_voxel_size,
)


@pytest.mark.parametrize("preset", ["default", "thesis"])
def test_a_dumped_preset_loads_as_itself(tmp_path: Path, preset: str) -> None:
    config = load_config(preset)
    (tmp_path / "c.yaml").write_text(dump_config(config))
    assert load_config(tmp_path / "c.yaml") == config == preset_config(preset)


def test_a_file_names_only_what_it_changes() -> None:
    tree = {"preset": "thesis", "extraction": {"voxel_size": 0.2}, "merge": None}
    config = parse_config(tree)
    assert config.extraction.voxel_size == 0.2
    assert config.extraction.method == preset_config("thesis").extraction.method
    assert config.merge == preset_config("thesis").merge
    assert parse_config(None) == preset_config("default")


def test_the_voxel_size_of_the_command_line_wins() -> None:
    assert with_voxel_size(preset_config("default"), 0.25).extraction.voxel_size == 0.25
    assert with_voxel_size(preset_config("default"), None) == preset_config("default")
    with pytest.raises(ConfigurationError, match=r"voxel_size: expected 0\.02\.\.1\.0 m, got"):
        with_voxel_size(preset_config("default"), 5)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("preset: fast", "unknown preset 'fast'; known: default, thesis"),
        ("voxel_size: 0.1", "unknown key 'voxel_size'; known: preset, extraction, merge"),
        ("extraction: {voxels: 1}", "unknown parameter 'voxels'"),
        ("extraction: {voxel_size: big}", "voxel_size: expected float, got 'big'"),
        ("extraction: {voxel_size: .nan}", "expected a finite number"),
        ("extraction: 3", "extraction: expected parameter names and values, got 3"),
        ("[1, 2]", "expected the keys preset, extraction, merge"),
        ("a: [", "not YAML"),
    ],
)
def test_a_wrong_file_is_refused_in_one_line(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "c.yaml").write_text(text)
    with pytest.raises(ConfigurationError, match=message) as caught:
        load_config(tmp_path / "c.yaml")
    assert "c.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_told_with_the_presets() -> None:
    with pytest.raises(ConfigurationError, match=r"neither a preset \(default, thesis\) nor"):
        load_config("nowhere.yaml")
