"""The agents file names a fleet once, for the launch file and for `topometric run`."""

from pathlib import Path

import pytest
import yaml

from topometric_ros.nodes.agent_names import parse_agents as parse_listed
from topometric_ros.runtime.agents_file import (
    AgentsFileError,
    extractor_arguments,
    merger_arguments,
    parse_agents,
    player_arguments,
    read_agents_file,
    simulated_fleet,
)
from topometric_ros.runtime.fleet_processes import (
    PROFILE,
    PROFILE_VARIABLE,
    FleetError,
    FleetOptions,
    dds_environment,
    fleet_processes,
    shipped,
)


def test_an_agent_needs_only_an_id() -> None:
    (agent,) = parse_agents({"agents": [{"id": "robot1"}]}).agents
    assert (agent.namespace, agent.cloud, agent.mode) == ("/robot1", "cloud", "auto")


def test_nested_and_dotted_parameters_are_the_same() -> None:
    nested = parse_agents({"agents": [{"id": "a", "params": {"rooms": {"range": 2.0}}}]})
    dotted = parse_agents({"agents": [{"id": "a", "params": {"rooms.range": 2.0}}]})
    assert nested == dotted


def test_processes_get_their_arguments_from_the_file() -> None:
    fleet = parse_agents(
        {
            "agents": [
                {"id": "a", "cloud": "cloud_map", "params": {"voxel_size": 0.2}},
                {"id": "b"},
            ],
            "extractor": {"params": {"voxel_size": 0.1, "preset": "thesis"}},
            "merger": {"namespace": "/base", "params": {"global_frame": "world"}},
        }
    )
    arguments = extractor_arguments(fleet, fleet.agents[0])
    assert arguments[:5] == ["--ros-args", "-r", "__ns:=/a", "-r", "cloud:=cloud_map"]
    values = dict(text.split(":=") for text in arguments[6::2])
    assert {name: yaml.safe_load(value) for name, value in values.items()} == {
        "voxel_size": 0.2,
        "preset": "thesis",
        "agent": "a",
        "mode": "auto",
        "global_frame": "world",
    }
    merger = merger_arguments(fleet)
    assert "__ns:=/base" in merger
    assert "global_frame:=world" in merger
    assert "agents:=[/a, /b]" in merger


def test_a_player_takes_no_time_from_the_clock_and_the_agents_file_wins(tmp_path: Path) -> None:
    params = tmp_path / "params.yaml"
    params.write_text("{}")
    options = FleetOptions(str(params), use_sim_time=True, log_level="warn", managed=True)
    extractor, player, merger = fleet_processes(simulated_fleet({"seed": 3}, 1), options)
    names = [process.executable for process in (extractor, player, merger)]
    assert names == ["managed_extractor", "player", "managed_merger"]
    assert "use_sim_time:=true" in extractor.arguments
    assert "use_sim_time:=true" in merger.arguments
    assert not any("use_sim_time" in text for text in player.arguments)
    told = extractor.arguments
    assert told.index("--params-file") < told.index("-p"), "rcl lets what is named first lose"
    with pytest.raises(FleetError, match="expected one of debug, info"):
        FleetOptions(log_level="loud")


def test_a_profile_that_the_environment_names_is_left_alone() -> None:
    profile = shipped(PROFILE)
    assert profile is not None
    assert dds_environment(str(profile), {}) == {PROFILE_VARIABLE: str(profile)}
    assert dds_environment(str(profile), {PROFILE_VARIABLE: "own.xml"}) == {}


def test_an_id_that_is_not_its_namespace_is_told_to_the_merger() -> None:
    fleet = parse_agents({"agents": [{"id": "left", "namespace": "/fleet/r1"}]})
    assert "agents:=[left=/fleet/r1]" in merger_arguments(fleet)


@pytest.mark.parametrize(
    ("tree", "message"),
    [
        (None, "at least one agent"),
        ({"agents": []}, "at least one agent"),
        ({"agents": [{"namespace": "/a"}]}, "needs an `id`"),
        ({"agents": [{"id": "a b"}]}, "'a b' is no valid ROS name"),
        ({"agents": [{"id": "a"}, {"id": "a"}]}, "id a is used more than once"),
        ({"agents": [{"id": "a"}, {"id": "b", "namespace": "/a"}]}, "namespace /a is used"),
        ({"agents": [{"id": "a", "mode": "fast"}]}, "expected one of auto, map, scan"),
        ({"agents": [{"id": "a", "topic": "x"}]}, "unknown key 'topic'"),
        ({"agents": [{"id": "a", "params": 3}]}, "expected names and values, got 3"),
        ({"agents": [{"id": "a"}], "fleet": {}}, "unknown key 'fleet'"),
    ],
)
def test_a_wrong_file_is_refused_with_the_wrong_value(tree: object, message: str) -> None:
    with pytest.raises(AgentsFileError, match=message):
        parse_agents(tree)


def test_a_map_of_another_day_is_an_agent_without_an_extractor(tmp_path: Path) -> None:
    (tmp_path / "monday.tmap").write_bytes(b"")
    path = tmp_path / "agents.yaml"
    path.write_text("agents: [{id: old, map: monday.tmap}, {id: robot1}]")
    fleet = read_agents_file(path)
    names = [process.name for process in fleet_processes(fleet, FleetOptions())]
    assert names == ["extractor of robot1", "merger"]
    (listed,) = (text for text in merger_arguments(fleet) if text.startswith("agents:="))
    agents = parse_listed(yaml.safe_load(listed.removeprefix("agents:=")))
    assert agents == {"old": str(tmp_path / "monday.tmap"), "robot1": "/robot1"}
    for entry, message in (
        ("{id: a, map: tuesday.tmap}", "map: no file"),
        ("{id: a, map: cloud.ply}", "expected a .tmap file, got 'cloud.ply'"),
        ("{id: a, map: monday.tmap, mode: scan}", "an agent that is a `map` has no `mode`"),
    ):
        path.write_text(f"agents: [{entry}]")
        with pytest.raises(AgentsFileError, match=message):
            read_agents_file(path)


def test_an_unreadable_file_is_one_line(tmp_path: Path) -> None:
    with pytest.raises(AgentsFileError, match="cannot read"):
        read_agents_file(tmp_path / "missing.yaml")
    (tmp_path / "bad.yaml").write_text("agents: [")
    with pytest.raises(AgentsFileError) as caught:
        read_agents_file(tmp_path / "bad.yaml")
    assert "\n" not in str(caught.value)


def test_a_fleet_may_be_simulated() -> None:
    fleet = parse_agents({"agents": [{"id": "a"}], "simulation": {"params": {"seed": 3}}})
    assert player_arguments(fleet) == ["--ros-args", "-p", "seed:=3"]
    assert parse_agents({"agents": [{"id": "a"}]}).simulation is None
    with pytest.raises(AgentsFileError, match="simulation: unknown key 'seed'"):
        parse_agents({"agents": [{"id": "a"}], "simulation": {"seed": 3}})
    three = simulated_fleet({"building": "home"}, 3)
    assert [(agent.id, agent.cloud, agent.mode) for agent in three.agents] == [
        (name, "scan_cloud", "scan") for name in ("robot1", "robot2", "robot3")
    ]
    assert three.simulation == {"building": "home", "agents": 3}
