"""The files in config/ and the reference say what the configuration classes say."""

from __future__ import annotations

import ast
import importlib.util
import re
from pathlib import Path
from types import ModuleType
from xml.etree import ElementTree

import pytest
import yaml

from topometric_ros.configuration import flatten
from topometric_ros.extraction.config import PRESETS, extraction_preset
from topometric_ros.fusion.config import merge_preset
from topometric_ros.nodes.config import ExtractorNodeConfig, MergerNodeConfig
from topometric_ros.runtime.agents_file import read_agents_file, simulated_fleet
from topometric_ros.runtime.config import load_config, preset_config

ROOT = Path(__file__).resolve().parent.parent


def writer() -> ModuleType:
    spec = importlib.util.spec_from_file_location("write_config", ROOT / "scripts/write_config.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_generated_files_are_up_to_date() -> None:
    stale = [str(p) for p, text in writer().files().items() if p.read_text() != text]
    assert not stale, "run scripts/write_config.py"


@pytest.mark.parametrize("preset", PRESETS)
def test_a_preset_file_is_the_preset(preset: str) -> None:
    assert load_config(ROOT / "config" / f"{preset}.yaml") == preset_config(preset)


@pytest.mark.parametrize(
    ("node", "own", "stage"),
    [
        ("extractor", ExtractorNodeConfig(), extraction_preset("default")),
        ("merger", MergerNodeConfig(), merge_preset("default")),
    ],
)
def test_a_node_file_names_every_parameter_once(node: str, own: object, stage: object) -> None:
    own_names, stage_names = set(flatten(own)), set(flatten(stage))
    assert not own_names & stage_names, "a parameter of the node hides one of its stage"
    tree = yaml.safe_load((ROOT / "config" / f"{node}.yaml").read_text())
    assert set(_leaves(tree[f"/**/{node}"]["ros__parameters"])) == own_names | stage_names


def _leaves(tree: dict, prefix: str = "") -> list[str]:
    names = []
    for key, value in tree.items():
        names += _leaves(value, f"{prefix}{key}.") if isinstance(value, dict) else [prefix + key]
    return names


def test_the_agents_file_that_ships_is_valid() -> None:
    fleet = read_agents_file(ROOT / "config" / "agents.yaml")
    assert [agent.id for agent in fleet.agents] == ["robot1", "robot2"]


def test_the_fast_dds_profile_gives_a_cloud_room_in_shared_memory() -> None:
    tree = ElementTree.parse(ROOT / "config" / "fastdds_large_clouds.xml")
    sizes = [int(e.text or 0) for e in tree.iter() if e.tag.endswith("segment_size")]
    assert sizes == [64 * 1024 * 1024]


def test_the_operator_and_nobody_else_may_call_what_the_nodes_offer() -> None:
    tree = ElementTree.parse(ROOT / "security" / "policies.xml")
    offered, called = set(), {}
    for enclave in tree.iter("enclave"):
        path = enclave.get("path", "")
        for services in enclave.iter("services"):
            names = {e.text or "" for e in services.iter("service")}
            if services.get("reply") == "ALLOW":
                offered |= {name.replace("~", path) for name in names}
            else:
                called[path] = names
    assert called == {"/operator": offered}


def test_a_simulated_fleet_ships() -> None:
    fleet = read_agents_file(ROOT / "config" / "simulated_fleet.yaml")
    assert fleet.simulation is not None
    assert fleet.agents == simulated_fleet({}, 2).agents, "as `run --simulate` names them"
    assert fleet.simulation["agents"] == 2


@pytest.mark.parametrize("name", ["rviz/topometric.rviz", "config/foxglove_layout.json"])
def test_what_is_shown_is_what_is_published(name: str) -> None:
    """Every topic in RViz' and Foxglove's settings is one that the reference lists."""
    text = (ROOT / name).read_text()
    yaml.safe_load(text)
    reference = (ROOT / "docs" / "ros-interface.md").read_text()
    published = set(re.findall(r"^\| `/?(\w+)`.*\| out \|", reference, re.MULTILINE))
    shown = re.findall(r"(?<![\w.])/(?:robot\d/)?(\w+)", text)
    assert set(shown) <= published
    assert {"global_cloud", "global_markers", "rooms"} <= set(shown)
    fleets = [
        read_agents_file(ROOT / "config" / f"{f}.yaml") for f in ("agents", "simulated_fleet")
    ]
    for fleet in fleets:
        assert set(re.findall(r"/\w+(?=/rooms)", text)) == {a.namespace for a in fleet.agents}


def test_the_launch_file_describes_every_argument() -> None:
    tree = ast.parse((ROOT / "launch" / "topometric.launch.py").read_text())
    calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
    arguments = [c for c in calls if getattr(c.func, "id", "") == "DeclareLaunchArgument"]
    assert len(arguments) == 7
    assert all("description" in {k.arg for k in call.keywords} for call in arguments)


@pytest.mark.parametrize(
    ("file", "started"),
    [
        ("topometric", ["extractor", "extractor", "merger"]),
        ("simulated_fleet", ["extractor", "extractor", "player", "merger"]),
    ],
)
def test_a_launch_file_starts_an_extractor_for_each_agent_and_a_merger(
    file: str, started: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    launch = pytest.importorskip("launch", reason="ROS 2 launch has no wheel; apt has it")
    pytest.importorskip("launch_ros")
    if not hasattr(launch, "LaunchService"):
        pytest.skip("ROS 2 launch has no wheel; apt has it")
    packages = "ament_index_python.packages.get_package_share_directory"
    monkeypatch.setattr(packages, lambda name: str(ROOT))
    source = launch.launch_description_sources.PythonLaunchDescriptionSource(
        str(ROOT / "launch" / f"{file}.launch.py")
    )
    context = launch.LaunchContext()
    waiting, names = list(source.get_launch_description(context).entities), []
    while waiting:
        entity = waiting.pop(0)
        if type(entity).__name__ == "Node":
            names.append(entity.node_executable)
            continue
        waiting = [*(entity.visit(context) or []), *waiting]
    assert names == started
