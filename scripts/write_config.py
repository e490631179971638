"""Write config/*.yaml and the parameter tables of the docs from the configuration classes.

python scripts/write_config.py            # write what has changed
python scripts/write_config.py --check    # exit status 1 where something would change
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import yaml

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

from topometric_ros.configuration import ParameterInfo, parameters  # noqa: E402
from topometric_ros.extraction.config import extraction_preset  # noqa: E402
from topometric_ros.fusion.config import merge_preset  # noqa: E402
from topometric_ros.nodes.config import (  # noqa: E402
    PRESETS,
    ExtractorNodeConfig,
    MergerNodeConfig,
    PlayerNodeConfig,
)
from topometric_ros.simulation.cases import SimulationConfig  # noqa: E402

GENERATED = "Written by scripts/write_config.py from the configuration classes: change those."
REFERENCE = ROOT / "docs" / "ros-interface.md"
SIMULATION = ROOT / "docs" / "simulation.md"


def files() -> dict[Path, str]:
    """Return every generated file's path and content."""
    extractor = (ExtractorNodeConfig(), extraction_preset("default"))
    merger = (MergerNodeConfig(), merge_preset("default"))
    contents = {
        ROOT / "config" / "extractor.yaml": node_file("extractor", extractor),
        ROOT / "config" / "merger.yaml": node_file("merger", merger),
        ROOT / "config" / "player.yaml": node_file("player", (PlayerNodeConfig(),)),
        REFERENCE: reference(
            REFERENCE.read_text(), extractor=extractor, merger=merger, player=(PlayerNodeConfig(),)
        ),
        SIMULATION: reference(SIMULATION.read_text(), simulation=(SimulationConfig(),)),
    }
    for preset in PRESETS:
        contents[ROOT / "config" / f"{preset}.yaml"] = preset_file(preset)
    return contents


def node_file(node: str, configs: Iterable[Any]) -> str:
    """Return a ROS parameter file that holds the default of every parameter of a node."""
    head = [
        f"# Every parameter of the {node} with its default. {GENERATED}",
        f"#   topometric-{node} --ros-args --params-file config/{node}.yaml",
        "",
        f"/**/{node}:",
        "  ros__parameters:",
    ]
    body = [line for config in configs for line in _nested_lines(config, indent=4)]
    return "\n".join([*head, *body]) + "\n"


def preset_file(preset: str) -> str:
    """Return a preset as the YAML file that `--config` reads."""
    lines = [f"# Preset `{preset}`. {GENERATED}", "", f"preset: {preset}", "", "extraction:"]
    lines += _nested_lines(extraction_preset(preset), indent=2)
    lines += ["", "merge:"]
    lines += _nested_lines(merge_preset(preset), indent=2)
    return "\n".join(lines) + "\n"


def reference(text: str, **nodes: Iterable[Any]) -> str:
    """Return the page with the parameter table of each program between its two marks."""
    for node, configs in nodes.items():
        begin, end = f"<!-- parameters of {node} -->", f"<!-- end of parameters of {node} -->"
        before, rest = text.split(begin)
        _, after = rest.split(end)
        infos = [info for config in configs for info, _ in parameters(config)]
        text = f"{before}{begin}\n{_table(infos)}\n{end}{after}"
    return text


def _nested_lines(config: Any, indent: int) -> Iterator[str]:
    open_branches: list[str] = []
    for info, value in parameters(config):
        *branches, leaf = info.name.split(".")
        shared = 0
        while branches[: shared + 1] == open_branches[: shared + 1] and shared < len(branches):
            shared += 1
        for depth in range(shared, len(branches)):
            yield f"{' ' * (indent + 2 * depth)}{branches[depth]}:"
        open_branches = branches
        pad = " " * (indent + 2 * len(branches))
        yield f"{pad}# {_sentence(info)}"
        yield f"{pad}{leaf}: {_scalar(value)}"


def _sentence(info: ParameterInfo) -> str:
    limits = _limits(info)
    return info.description + (f" [{limits}]" if limits else "")


def _limits(info: ParameterInfo) -> str:
    if info.choices:
        return " | ".join(info.choices)
    if info.minimum is None and info.maximum is None:
        return info.unit
    low = "" if info.minimum is None else f"{info.minimum:g}"
    high = "" if info.maximum is None else f"{info.maximum:g}"
    return f"{low}..{high} {info.unit}".rstrip()


def _scalar(value: Any) -> str:
    plain = list(value) if isinstance(value, tuple) else value
    text = yaml.safe_dump(plain, default_flow_style=True, width=10_000).strip()
    return text.removesuffix("...").strip()


def _table(infos: Iterable[ParameterInfo]) -> str:
    rows = ["| parameter | default | range | meaning |", "|---|---|---|---|"]
    for info in infos:
        limits = _limits(info).replace("|", "\\|")
        default = _scalar(info.default).replace("''", "empty")
        rows.append(f"| `{info.name}` | {default} | {limits} | {info.description} |")
    return "\n".join(rows)


def main(arguments: list[str] | None = None) -> int:
    """Write or check the files; return the exit status."""
    parser = argparse.ArgumentParser(description="Write config/*.yaml and the parameter tables.")
    parser.add_argument("--check", action="store_true", help="change nothing, fail where it would")
    check = parser.parse_args(arguments).check
    stale = {p: t for p, t in files().items() if not p.exists() or p.read_text() != t}
    for path, text in stale.items():
        print(f"{'stale' if check else 'wrote'}: {path.relative_to(ROOT)}")
        if not check:
            path.write_text(text)
    return 1 if check and stale else 0


if __name__ == "__main__":
    sys.exit(main())
