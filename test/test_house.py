"""The house holds: imports point downward, versions agree, what is shipped is what is written."""

import ast
import re
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator
from pathlib import Path

import pytest

import topometric_ros
from topometric_ros.io.schemas import message_definitions

ROOT = Path(__file__).resolve().parents[1]
SOURCES = sorted((ROOT / "topometric_ros").rglob("*.py"))
INTERFACES = ROOT / "msg_schemas" / "topometric_msgs"
LONGEST_FILE = 350

LAYERS = (
    {
        "errors",
        "configuration",
        "stopwatch",
        "map_checks",
        "topometric_map",
        "alignment",
        "yaml_text",
    },
    {"voxels"},
    {"extraction"},
    {"matching"},
    {"fusion", "io"},
    {"runtime"},
    {"visualization"},
    {"simulation"},
    {"evaluation"},
    {"cli"},
    {"nodes", "__main__"},
)
"""From the bottom up; what shares a line must not import each other, the bottom line excepted."""

HEIGHT = {name: height for height, layer in enumerate(LAYERS) for name in layer}
ROS = re.compile(
    r"^(rclpy|tf2_ros|launch|launch_ros|builtin_interfaces|\w+_(msgs|interfaces|srvs))$"
)


def imported_modules(path: Path) -> Iterator[tuple[int, str]]:
    """Yield (line, dotted name) of every import, those inside functions too."""
    package = path.relative_to(ROOT).with_suffix("").parts[:-1]
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            yield from ((node.lineno, alias.name) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            base = package[: len(package) - node.level + 1] if node.level else ()
            module = ".".join([*base, *([node.module] if node.module else [])])
            # `from topometric_ros import voxels` names a module too.
            yield from ((node.lineno, f"{module}.{alias.name}") for alias in node.names)


def area(path: Path) -> str:
    """Return the package below topometric_ros, or the top-level module, that a file belongs to."""
    return path.relative_to(ROOT / "topometric_ros").with_suffix("").parts[0]


def version_of(package_xml: Path) -> str | None:
    return ElementTree.parse(package_xml).getroot().findtext("version")


def test_every_module_has_a_place_in_the_layers():
    unknown = {area(path) for path in SOURCES} - set(HEIGHT) - {"__init__"}
    assert not unknown


def test_imports_point_downward():
    wrong = []
    for path in SOURCES:
        here = area(path)
        for line, name in imported_modules(path):
            parts = name.split(".")
            if parts[0] != "topometric_ros" or len(parts) < 2 or parts[1] not in HEIGHT:
                continue
            there = parts[1]
            at_the_bottom = HEIGHT[here] == 0 == HEIGHT[there]
            if there != here and not at_the_bottom and HEIGHT[there] >= HEIGHT[here]:
                wrong.append(f"{path.relative_to(ROOT)}:{line}: {here} imports {there}")
    assert not wrong


def test_only_nodes_know_ros():
    wrong = [
        f"{path.relative_to(ROOT)}:{line}: {name}"
        for path in SOURCES
        if area(path) != "nodes"
        for line, name in imported_modules(path)
        if ROS.match(name.split(".")[0])
    ]
    assert not wrong


def test_files_are_short():
    files = [*SOURCES, *(ROOT / "test").glob("*.py"), *(ROOT / "scripts").iterdir()]
    lengths = {
        str(path.relative_to(ROOT)): path.read_text(encoding="utf-8").count("\n")
        for path in files
        if path.is_file()
    }
    assert not {name: lines for name, lines in lengths.items() if lines > LONGEST_FILE}


def test_versions_agree():
    versions = {
        str(p.relative_to(ROOT)): version_of(p)
        for p in (ROOT / "package.xml", INTERFACES / "package.xml")
    }
    assert set(versions.values()) == {topometric_ros.__version__}, versions


@pytest.mark.parametrize("folder", [ROOT, INTERFACES])
def test_changelogs_begin_with_the_version(folder: Path):
    headings = re.findall(
        r"^(\d+\.\d+\.\d+) ", (folder / "CHANGELOG.rst").read_text(), re.MULTILINE
    )
    assert headings[0] == topometric_ros.__version__


def test_the_licence_is_apache_2():
    text = (ROOT / "LICENSE").read_text(encoding="utf-8")
    assert "Apache License" in text
    assert "Version 2.0, January 2004" in text
    for package_xml in (ROOT / "package.xml", INTERFACES / "package.xml"):
        assert ElementTree.parse(package_xml).getroot().findtext("license") == "Apache-2.0"


def test_every_interface_is_built():
    files = {
        str(p.relative_to(INTERFACES))
        for p in INTERFACES.glob("*/*.*")
        if p.suffix in (".msg", ".srv")
    }
    listed = set(
        re.findall(r'"((?:msg|srv)/\w+\.\w+)"', (INTERFACES / "CMakeLists.txt").read_text())
    )
    assert files == listed


def test_every_field_says_what_it_is():
    """Numbers with a unit or a frame need words; names alone need none."""
    bare = [
        f"{path.name}: {line}"
        for path in [*INTERFACES.glob("msg/*.msg"), *INTERFACES.glob("srv/*.srv")]
        for line in path.read_text(encoding="utf-8").splitlines()
        if re.match(r"(float|geometry_msgs)", line) and "#" not in line
    ]
    assert not bare


def test_the_installed_package_ships_the_interfaces_and_what_ros_looks_for(tmp_path: Path):
    library, prefix = tmp_path / "lib", tmp_path / "prefix"
    setup = [sys.executable, "-W", "ignore", "setup.py", "-q"]
    for command in (
        ["egg_info", "--egg-base", str(tmp_path), "build_py", "--build-lib", str(library)],
        ["install_data", "--install-dir", str(prefix)],
    ):
        subprocess.run([*setup, *command], cwd=ROOT, check=True, capture_output=True)
    for kind in ("msg", "srv"):
        written = {p.name: p.read_bytes() for p in (INTERFACES / kind).iterdir()}
        shipped = library / "topometric_ros" / "schemas" / kind
        assert {p.name: p.read_bytes() for p in shipped.iterdir()} == written
    assert {f"{name.split('/')[-1]}.msg" for name in message_definitions()} == {
        p.name for p in (INTERFACES / "msg").iterdir()
    }
    share = prefix / "share"
    assert (share / "ament_index/resource_index/packages/topometric_ros").is_file()
    for name in ("config", "config/suites", "launch", "rviz", "security"):
        folder = share / "topometric_ros" / name
        shipped_names = {p.name for p in folder.iterdir() if p.is_file()}
        assert shipped_names == {p.name for p in (ROOT / name).iterdir() if p.is_file()}
    for name in ("extractor", "merger", "replay"):
        assert (prefix / "lib/topometric_ros" / name).stat().st_mode & 0o111


def test_every_dependency_has_its_reason():
    setup = (ROOT / "setup.py").read_text(encoding="utf-8")
    block = setup[setup.index("install_requires") : setup.index("entry_points")]
    names = set(re.findall(r'f?"([a-z0-9][a-z0-9-]+)(?:\[\w+\])?(?:[><=]|")', block))
    names -= {"las", "ros", "test", "dev"}
    reasons = (ROOT / "docs" / "dependencies.md").read_text(encoding="utf-8")
    assert {"numpy", "open3d-cpu", "laspy", "ros-jazzy-rclpy", "ruff"} <= names
    assert not {name for name in names if f"`{name}`" not in reasons}
