"""Configurations are the one source of defaults, names, units and ranges."""

import array
from dataclasses import dataclass, field

import pytest

from topometric_ros.configuration import (
    flatten,
    from_nested,
    near_names,
    nested,
    parameter,
    parameters,
    validate,
    with_values,
)
from topometric_ros.errors import ConfigurationError
from topometric_ros.extraction.config import extraction_preset
from topometric_ros.fusion.config import merge_preset


@dataclass(frozen=True)
class Inner:
    height: float = parameter(0.25, "Height of the stick.", unit="m", minimum=0.0, maximum=2.0)
    method: str = parameter("sum", "Which function.", choices=("sum", "max"))


@dataclass(frozen=True)
class Outer:
    inner: Inner = field(default_factory=Inner)
    steps: int = parameter(3, "How many steps.", minimum=1)
    sources: tuple[str, ...] = parameter(("rooms",), "Where hypotheses come from.")
    axis: tuple[float, ...] = parameter((0.0, 0.0, 1.0), "Which axis.", count=(3, 3))


def test_nested_configurations_have_dotted_names():
    assert flatten(Outer()) == {
        "inner.height": 0.25,
        "inner.method": "sum",
        "steps": 3,
        "sources": ("rooms",),
        "axis": (0.0, 0.0, 1.0),
    }


def test_the_file_form_reads_back_to_the_same_configuration():
    changed = with_values(Outer(), {"inner.height": 0.5, "sources": ["rooms", "search"]})
    assert from_nested(Outer(), nested(changed)) == changed


def test_a_misspelt_name_is_answered_with_what_may_have_been_meant():
    known = list(flatten(extraction_preset("default")))
    assert near_names("voxelsize", known)[0] == "voxel_size"
    assert near_names("stairs.headroom", known)[0] == "storeys.headroom"
    with pytest.raises(ConfigurationError, match=r"'rooms'; .*and \d+ more$"):
        with_values(extraction_preset("default"), {"rooms": 2})


def test_whole_numbers_serve_where_a_length_is_asked_for():
    assert with_values(Outer(), {"inner.height": 1}).inner.height == 1.0


def test_numbers_of_a_list_may_come_as_texts_as_older_files_have_them():
    assert with_values(Outer(), {"axis": ["0", "1", "0"]}).axis == (0.0, 1.0, 0.0)
    values = array.array("d", [1.0, 0.0, 0.0])
    assert with_values(Outer(), {"axis": values}).axis == (1.0, 0.0, 0.0)


@pytest.mark.parametrize("preset", ["default", "thesis"])
def test_the_presets_are_within_their_own_limits(preset):
    validate(extraction_preset(preset))
    validate(merge_preset(preset))


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
        ({"steps": 0}, "steps: expected at least 1, got 0"),
        ({"sources": "rooms"}, "sources: expected a list of texts, got 'rooms'"),
        ({"axis": [1, 2]}, r"axis: expected a list of 3 numbers, got \[1, 2\]"),
    ],
)
def test_a_wrong_value_is_refused_with_what_was_expected(values, said):
    with pytest.raises(ConfigurationError, match=said):
        with_values(Outer(), values)


@pytest.mark.parametrize(
    ("name", "value", "module"),
    [
        ("registration.method", "gicp", "small_gicp"),
        ("registration.method", "deep_closest_point", "onnxruntime"),
        ("matching.descriptors.names", ["shape", "learned"], "onnxruntime"),
    ],
)
def test_what_needs_an_extra_that_is_not_installed_is_refused_where_it_is_chosen(
    name, value, module, monkeypatch
):
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(ConfigurationError, match=rf"{name}: .* needs {module}: pip install"):
        with_values(merge_preset("default"), {name: value})
    monkeypatch.setattr("importlib.util.find_spec", lambda _: object())
    with_values(merge_preset("default"), {name: value})
