"""Parameters of nodes: declared from the configurations, refused with a reason, changed live."""

from __future__ import annotations

import array
import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import pytest
import yaml

from test.helpers_ros import missing, private_context
from topometric_ros.configuration import parameter
from topometric_ros.errors import ConfigurationError
from topometric_ros.extraction.config import extraction_preset
from topometric_ros.fusion.config import merge_preset
from topometric_ros.nodes.config import ExtractorNodeConfig, MergerNodeConfig

if missing():
    pytest.skip(missing(), allow_module_level=True)

import rclpy
from rclpy.parameter import Parameter, parameter_value_to_python

from topometric_ros.nodes import parameters
from topometric_ros.nodes.parameter_files import passed_over
from topometric_ros.nodes.running import BAD_INPUT, TopometricNode, run


@dataclass(frozen=True)
class Walls:
    thickness: float = parameter(0.1, "Of a wall.", unit="m", minimum=0.0, maximum=1.0)


@dataclass(frozen=True)
class Stage:
    name: str = parameter("a", "A choice.", choices=("a", "b"))
    count: int = parameter(3, "A count.", minimum=1)
    walls: Walls = field(default_factory=Walls)


@dataclass(frozen=True)
class Own:
    agents: tuple[str, ...] = parameter(("x",), "Agents.")
    gates: tuple[float, ...] = parameter((0.5,), "Gates.", unit="m", minimum=0.1, count=(1, None))


@pytest.fixture
def context() -> Iterator[Any]:
    own = private_context()
    yield own
    own.shutdown()


def make_node(context: Any, *overrides: str) -> Any:
    arguments = ["--ros-args", *(text for value in overrides for text in ("-p", value))]
    return rclpy.create_node(
        "parts",
        context=context,
        cli_args=arguments,
        use_global_arguments=False,
        automatically_declare_parameters_from_overrides=True,
    )


def test_overrides_reach_the_configuration_in_its_own_types(context: Any) -> None:
    node = make_node(context, "walls.thickness:=1", "name:=b", "agents:=[/r1, /r2]")
    own, stage = parameters.declare(node, (Own(), Stage()), fixed=("agents",))
    assert own == Own(agents=("/r1", "/r2"))
    assert stage == Stage(name="b", walls=Walls(thickness=1.0))
    assert node.get_parameter("walls.thickness").value == 1.0
    described = node.describe_parameter("walls.thickness")
    assert described.description == "Of a wall. [m]"
    assert described.floating_point_range[0].to_value == 1.0
    node.destroy_node()


def test_a_misspelt_override_is_told_with_the_name_that_it_is_like(
    context: Any, capfd: pytest.CaptureFixture[str]
) -> None:
    node = make_node(context, "wals.thickness:=0.3", "quite_other:=1")
    parameters.declare(node, (Stage(),), fixed=())
    told = "unknown parameters are ignored: quite_other, wals.thickness (did you mean walls.thick"
    assert told in capfd.readouterr().err
    node.destroy_node()


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("walls.thickness:=2.0", "walls.thickness: expected 0.0..1.0 m, got 2.0"),
        ("count:=many", "count: expected int, got 'many'"),
        ("name:=c", "name: expected one of a, b, got 'c'"),
    ],
)
def test_a_wrong_override_is_refused_at_the_start(
    context: Any, override: str, message: str
) -> None:
    node = make_node(context, override)
    with pytest.raises(ConfigurationError, match=message):
        parameters.declare(node, (Stage(),), fixed=())
    node.destroy_node()


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("priors:=['{a: 1}']", "priors: prior '{a: 1}': unknown key 'a'; known: between"),
        ("sources:=[guess]", "sources: expected a list of 1 or more texts out of rooms, search"),
        ("registration.gates:=[0.4, -1.0]", "registration.gates: expected a list of 1 or more"),
        ("consensus.registration.axis:=[0.0, 0.0]", "consensus.registration.axis: expected"),
        ("matching.descriptors.names:=[guess]", "matching.descriptors.names: expected a list"),
        ("agents:=[/a, /a]", "agents: '/a' names an agent twice"),
    ],
)
def test_what_makes_no_sense_is_refused_at_the_start_and_not_at_its_first_use(
    context: Any, override: str, message: str
) -> None:
    node = make_node(context, override)
    with pytest.raises(ConfigurationError, match=re.escape(message)):
        parameters.declare(node, (MergerNodeConfig(), merge_preset("default")), fixed=())
    node.destroy_node()


def test_a_wrong_change_is_refused_with_the_reason_and_a_right_one_is_handed_on(
    context: Any,
) -> None:
    node = make_node(context)
    configs = parameters.declare(node, (Own(), Stage()), fixed=("agents",))
    changes: list[Any] = []
    parameters.on_change(node, configs, changes.append)

    def set_one(name: str, value: Any) -> Any:
        return node.set_parameters([Parameter(name, value=value)])[0]

    assert set_one("walls.thickness", 0.3).successful
    assert changes[-1][1].walls.thickness == 0.3
    assert "range" in set_one("walls.thickness", 7.0).reason
    assert set_one("gates", [0.25, 1.0]).successful
    assert changes.pop()[0].gates == (0.25, 1.0)
    told = "gates: expected a list of 1 or more numbers, each at least 0.1 m, got [0.25, 0.0]"
    assert set_one("gates", [0.25, 0.0]).reason == told
    constraints = node.describe_parameter("gates").additional_constraints
    assert constraints == "a list of 1 or more numbers, each at least 0.1 m"
    assert set_one("name", "c").reason == "name: expected one of a, b, got 'c'"
    assert "read-only" in set_one("agents", ["y"]).reason
    assert len(changes) == 1
    assert node.get_parameter("walls.thickness").value == 0.3
    node.destroy_node()


def dumped(node: Any) -> dict[str, Any]:
    """Return what `ros2 param dump` would write of a node."""
    tree: dict[str, Any] = {}
    for name in node.get_parameters_by_prefix(""):
        value = parameter_value_to_python(node.get_parameter(name).get_parameter_value())
        *branches, leaf = name.split(".")
        branch = tree
        for key in branches:
            branch = branch.setdefault(key, {})
        branch[leaf] = value.tolist() if isinstance(value, array.array) else value
    return {node.get_fully_qualified_name(): {"ros__parameters": tree}}


@pytest.mark.parametrize(
    ("name", "own", "stage"),
    [
        ("merger", MergerNodeConfig(), merge_preset("default")),
        ("extractor", ExtractorNodeConfig(), extraction_preset("default")),
    ],
)
def test_a_dump_of_all_parameters_starts_the_node_again_and_so_does_the_file_that_ships(
    context: Any, tmp_path: Path, name: str, own: Any, stage: Any
) -> None:
    def declared(*arguments: str) -> tuple[Any, dict[str, Any]]:
        node = TopometricNode(
            name,
            context=context,
            cli_args=["--ros-args", *arguments],
            use_global_arguments=False,
            automatically_declare_parameters_from_overrides=True,
        )
        configs = parameters.declare(node, (own, stage), fixed=("agents",))
        content = dumped(node)
        if name == "merger":
            texts = Parameter.Type.STRING_ARRAY
            assert node.get_parameter("priors").type_ is texts
            assert node.describe_parameter("agents").read_only
            prior = "{between: [a, b], position: [1, 0, 0], yaw: 0}"
            assert node.set_parameters([Parameter("priors", texts, [prior])])[0].successful
        node.destroy_node()
        return configs, content

    configs, content = declared("-p", "max_rate:=3.0")
    file = tmp_path / "dump.yaml"
    file.write_text(yaml.safe_dump(content))
    assert declared("--params-file", str(file)) == (configs, content)
    shipped = Path(__file__).parent.parent / "config" / f"{name}.yaml"
    assert declared("--params-file", str(shipped))[0] == (own, stage)


@pytest.mark.parametrize("text", [None, "/**:\n  ros__parameters: [1\n", "/**:\n  rate: 1.0\n"])
def test_a_parameter_file_that_cannot_be_read_ends_the_node_in_one_line(
    text: str | None, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "params.yaml"
    if text is not None:
        file.write_text(text)
    assert run(TopometricNode, ["node", "--ros-args", "--params-file", str(file)]) == BAD_INPUT
    told = capfd.readouterr().err
    assert "params.yaml" in told
    assert "Traceback" not in told


@pytest.mark.parametrize(
    ("names", "told"),
    [
        ("/robot1/extractor", "it names /robot1/extractor"),
        ("extractor", "it names /extractor"),
        ("/robot7/extractr", "it names /robot7/extractr"),
        ("/robot7/extractor /robot1/extractor", ""),
        ("/merger", ""),
        ("/**", ""),
        ("/*/extractor", ""),
        ("/**/extractor", ""),
        ("/**/robot7/extractor", ""),
    ],
)
def test_a_parameter_file_for_a_node_called_otherwise_is_told(
    names: str, told: str, tmp_path: Path
) -> None:
    file = tmp_path / "params.yaml"
    file.write_text("".join(f"{n}:\n  ros__parameters:\n    a: 1\n" for n in names.split()))
    (*lines,) = passed_over(["x", "--ros-args", "--params-file", str(file)], "/robot7/extractor")
    assert [line.partition("; ")[0].partition("extractor: ")[2] for line in lines] == (
        [told] if told else []
    )
