"""Configurations are the one source of defaults, names, units and ranges."""

from dataclasses import dataclass, field

import pytest

from topometric_ros.configuration import (
    flatten,
    from_nested,
    nested,
    parameter,
    parameters,
    with_values,
)
from topometric_ros.errors import ConfigurationError


@dataclass(frozen=True)
class Inner:
    height: float = parameter(0.25, "Height of the stick.", unit="m", minimum=0.0, maximum=2.0)
    method: str = parameter("sum", "Which function.", choices=("sum", "max"))


@dataclass(frozen=True)
class Outer:
    inner: Inner = field(default_factory=Inner)
    steps: int = parameter(3, "How many steps.", minimum=1)
    sources: tuple[str, ...] = parameter(("rooms",), "Where hypotheses come from.")


def test_nested_configurations_have_dotted_names():
    assert flatten(Outer()) == {
        "inner.height": 0.25,
        "inner.method": "sum",
        "steps": 3,
        "sources": ("rooms",),
    }


def test_the_file_form_reads_back_to_the_same_configuration():
    changed = with_values(Outer(), {"inner.height": 0.5, "sources": ["rooms", "search"]})
    assert from_nested(Outer(), nested(changed)) == changed


def test_whole_numbers_serve_where_a_length_is_asked_for():
    assert with_values(Outer(), {"inner.height": 1}).inner.height == 1.0


def test_every_parameter_knows_its_unit_and_description():
    infos = {info.name: info for info, _ in parameters(Outer())}
    assert infos["inner.height"].unit == "m"
    assert infos["steps"].description == "How many steps."


@pytest.mark.parametrize(
    ("values", "said"),
    [
        ({"inner.hight": 1.0}, "inner.height"),
        ({"inner.height": 3.0}, "0.0..2.0 m"),
        ({"inner.height": float("nan")}, "finite"),
        ({"inner.height": "high"}, "float"),
        ({"inner.method": "mean"}, "sum, max"),
        ({"steps": 0}, "steps"),
        ({"steps": True}, "int"),
    ],
)
def test_a_wrong_value_is_refused_with_what_was_expected(values, said):
    with pytest.raises(ConfigurationError, match=said):
        with_values(Outer(), values)
