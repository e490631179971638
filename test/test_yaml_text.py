"""Whatever is wrong with a YAML text is told in one line; nothing is unpacked to gigabytes."""

from __future__ import annotations

import pytest

from topometric_ros.errors import ConfigurationError
from topometric_ros.yaml_text import load_yaml


def test_what_people_write_is_read() -> None:
    text = "base: &base {mode: scan, rate: 2.5}\nagents: [{<<: *base, id: a}, {<<: *base, id: b}]"
    assert load_yaml(text)["agents"][1] == {"mode": "scan", "rate": 2.5, "id": "b"}
    assert load_yaml("") is None


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ("a: [1, 2", "not YAML: while parsing a flow sequence"),
        ("a: \x00", "not YAML: unacceptable character"),
        ("a: 2001-13-45", "not YAML: month must be in 1..12"),
        ("a: " + "9" * 5000, "not YAML: Exceeds the limit"),
        ("a: !!python/name:os.system", "not YAML: could not determine a constructor"),
        ("? [1]\n: 2", "not YAML: while constructing a mapping"),
        ("a: &a [*a]", "an alias in it refers to what holds it"),
        ("[" * 5000, "not YAML: nested too deeply"),
    ],
)
def test_a_bad_text_is_told_in_one_line(text: str, told: str) -> None:
    with pytest.raises(ConfigurationError) as caught:
        load_yaml(text)
    assert str(caught.value).startswith(told)
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 400


def test_aliases_that_unfold_to_gigabytes_are_refused() -> None:
    lines = ["a0: &a0 [1, 1, 1, 1, 1, 1, 1, 1, 1]"]
    lines += [f"a{i}: &a{i} [{', '.join([f'*a{i - 1}'] * 9)}]" for i in range(1, 12)]
    with pytest.raises(ConfigurationError, match="at most 1000000"):
        load_yaml("\n".join(lines))
