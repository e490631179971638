"""The documents name files that exist and numbers of commands that are in the repository."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from topometric_ros.cli.main import parser

ROOT = Path(__file__).resolve().parents[1]
DOCUMENTS = [ROOT / "README.md", ROOT / "SECURITY.md", *sorted((ROOT / "docs").glob("*.md"))]
FOLDERS = "topometric_ros|test|scripts|config|launch|docs|bags|wheels|training|security|examples"
NAMED = re.compile(rf"`((?:{FOLDERS})/[\w./-]+)`")
LINK = re.compile(r"\]\((?!https?:|#)([^)#]+)")
HEADING = re.compile(r"(?m)^#+ (.+)$")
BLOCK = re.compile(r"(?ms)^```[^\n]*\n(.*?)^```")
COMMAND = re.compile(r"(?m)(?:^|&& )(topometric \w+ [^\n#&]*|(?:python )?\S*\.py [^\n#&]*)")
TO_HEADING = re.compile(r"\]\((?!https?:)([^)#]*)#([^)]+)\)")


def anchor(heading: str) -> str:
    """What a link to the heading names after `#`, as GitHub spells it."""
    return re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-")


def anchors(document: Path) -> set[str]:
    return {anchor(heading) for heading in HEADING.findall(document.read_text(encoding="utf-8"))}


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_file_that_a_document_names_exists(document):
    text = document.read_text(encoding="utf-8")
    named = {ROOT / name for name in NAMED.findall(text)}
    named |= {document.parent / name for name in LINK.findall(text)}
    missing = sorted(str(path) for path in named if not path.exists())
    assert not missing


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_no_document_holds_the_marks_of_a_conflict(document):
    text = document.read_text(encoding="utf-8")
    assert not re.findall(r"(?m)^(?:<{7}|={7}|>{7})", text)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_link_to_a_heading_finds_it(document):
    links = TO_HEADING.findall(document.read_text(encoding="utf-8"))
    missing = [
        f"{name}#{heading}"
        for name, heading in links
        if heading not in anchors(document.parent / name if name else document)
    ]
    assert not missing


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda path: path.name)
def test_every_command_in_a_block_of_code_exists_with_its_options(document):
    blocks = BLOCK.findall(document.read_text(encoding="utf-8").replace("\\\n", ""))
    for command in (c for block in blocks for c in COMMAND.findall(block) if "..." not in c):
        name, *arguments = shlex.split(command.removeprefix("python ").split(" [-")[0])
        if name == "topometric":
            parser().parse_args(arguments)
        elif (script := ROOT / name[name.find("scripts/") :]).is_file():
            text = script.read_text(encoding="utf-8")
            options = [word for word in arguments if word.startswith("--")]
            assert not [option for option in options if f'"{option}"' not in text], command


def test_the_benchmarks_are_all_in_their_contents():
    text = (ROOT / "docs" / "benchmarks.md").read_text(encoding="utf-8")
    contents, _, rest = text.partition("\n## ")
    listed = {heading for _, heading in TO_HEADING.findall(contents)}
    sections = re.findall(r"(?m)^###? (.+)$", "## " + rest)
    assert not [title for title in sections if anchor(title) not in listed]


def test_the_thesis_table_covers_every_algorithm_and_equation():
    text = (ROOT / "docs" / "thesis.md").read_text(encoding="utf-8")
    algorithms = {int(n) for n in re.findall(r"Algorithm (\d)", text)}
    algorithms |= {int(n) for pair in re.findall(r"Algorithms (\d) and (\d)", text) for n in pair}
    assert algorithms == set(range(1, 8))
    covered: set[int] = set()
    for first, last in re.findall(r"eq\. (\d+)(?:–(\d+))?", text):
        covered |= set(range(int(first), int(last or first) + 1))
    assert covered >= set(range(1, 54))
