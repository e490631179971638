"""`topometric evaluate`: same bytes for the same suite, resumed where it stopped, honest tables."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

from test.helpers import box_room, moved, yaw_transform
from topometric_ros.cli.main import main
from topometric_ros.evaluation import runner
from topometric_ros.evaluation.case import EvaluationCaseError
from topometric_ros.evaluation.case_result import COLUMNS, CaseResult, from_cells, to_cells
from topometric_ros.evaluation.figures import reliability_figure
from topometric_ros.evaluation.suite import CaseSpec, SuiteError, parse_suite, read_suite
from topometric_ros.evaluation.table_cells import markdown
from topometric_ros.evaluation.tables import tables
from topometric_ros.simulation.case import Case, SimulatedAgent
from topometric_ros.simulation.case_files import write_case

ROOT = Path(__file__).resolve().parents[1]

FLAT = (
    ((0, 0, 0), (4, 3, 2.6), (("x+", 1.5),)),
    ((4.1, 0, 0), (3, 5, 2.6), (("x-", 1.5), ("y+", 0.8))),
    ((4.1, 5.1, 0), (3, 2.5, 2.6), (("y-", 0.8),)),
)
HALL = (((0, 0, 0), (7, 4, 2.6), (("y+", 2.0),)), ((1, 4.1, 0), (2.4, 6, 2.6), (("y-", 1.0),)))


def write_pair(folder: Path, plan: str, rooms, T_agents) -> None:
    """Write a case of two agents that both saw all rooms."""
    agents = []
    for name, T in zip("ab", T_agents, strict=True):
        parts = [box_room(*room) for room in rooms]
        label = np.concatenate([np.full(len(p), k) for k, p in enumerate(parts)])
        points = moved(np.concatenate(parts), T)
        agents.append(
            SimulatedAgent(
                id=name,
                points=points,
                room=label.astype(np.int32),
                poses=np.zeros((0, 4, 4)),
                scan_of_point=np.full(len(points), -1, np.int32),
                T_agent_building=T,
                rooms_walked=tuple(range(len(rooms))),
            )
        )
    edges = tuple((k, k + 1) for k in range(len(rooms) - 1))
    write_case(Case(plan, 0, tuple(agents), np.array([1.0]), edges), folder)


@pytest.fixture(scope="module")
def suite(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A suite of two ready pairs and one crossed pair, under the preset `default`."""
    root = tmp_path_factory.mktemp("suite")
    poses = yaw_transform(0.3, (1, 2, 0)), yaw_transform(-1.1, (4, -3, 0.2))
    write_pair(root / "pairs/flat", "flat", FLAT, poses)
    write_pair(root / "pairs/hall", "hall", HALL, poses)
    tree = {"pairs": str(root / "pairs"), "cross": 1, "presets": ["default"]}
    (root / "tiny.yaml").write_text(json.dumps(tree))
    return root / "tiny.yaml"


@pytest.fixture(scope="module")
def evaluated(suite: Path) -> Path:
    """The output folder of the suite, computed in this process."""
    out = suite.parent / "out"
    assert main(["evaluate", str(suite), "-o", str(out), "--jobs", "1"]) == 0
    return out


def rows_of(out: Path) -> dict[str, CaseResult]:
    with (out / "rows.csv").open(newline="") as file:
        rows = [from_cells(cells) for cells in csv.DictReader(file)]
    return {row.case: row for row in rows}


def test_every_case_has_its_row_with_the_truth_compared(evaluated: Path) -> None:
    rows = rows_of(evaluated)
    assert list(rows) == ["flat", "hall", "flat a x hall b"]
    flat, crossed = rows["flat"], rows["flat a x hall b"]
    assert flat.miou_walked[0] > 0.8
    assert flat.rooms_walked == (3, 3)
    assert flat.overlap == (1.0,)
    if flat.accepted[0]:
        assert flat.displacement[0] < 0.05
        assert flat.right == flat.strict == (1.0,)
    assert crossed.rooms_walked == ()
    assert np.isnan(crossed.displacement[0])
    # A message is far smaller than the cloud that it was made of.
    assert flat.message_bytes[0] < 12 * flat.points[0] / 4


def test_a_run_that_is_done_answers_a_pipe_in_json_and_nothing_else(suite, evaluated, capfd):
    command = ["evaluate", str(suite), "-o", str(evaluated), "--jobs", "1"]
    assert main([*command, "--json"]) == 0
    out, err = capfd.readouterr()
    assert err == ""
    rows = {row["case"]: row for row in json.loads(out)["rows"]}
    assert list(rows) == ["flat", "hall", "flat a x hall b"]
    assert rows["flat"]["overlap"] == [1.0]
    assert rows["flat a x hall b"]["displacement"] == [None]


def test_tables_and_report_stand_alone(evaluated: Path) -> None:
    text = (evaluated / "tables.md").read_text()
    for title in ("Fusion", "Rooms", "Edges of the topological graph", "Matching", "Bytes"):
        assert f"## {title}" in text
    html = (evaluated / "report.html").read_text()
    assert "data:image/png;base64," in html
    assert "flat a x hall b" in html
    assert 'src="http' not in html


def test_more_processes_give_the_same_bytes(suite: Path, evaluated: Path) -> None:
    out = suite.parent / "parallel"
    runner.run_suite(read_suite(str(suite)), out, processes=2)
    assert (out / "rows.csv").read_bytes() == (evaluated / "rows.csv").read_bytes()


def test_a_run_goes_on_where_it_stopped(
    suite: Path, evaluated: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = (evaluated / "rows.csv").read_bytes()
    lines = before.decode().splitlines(keepends=True)
    (evaluated / "rows.csv").write_text("".join(lines[:2] + lines[3:]))
    computed = []
    compute = runner.compute
    monkeypatch.setattr(
        runner, "compute", lambda job, out: computed.append(job.spec.name) or compute(job, out)
    )
    told: list[str] = []
    runner.run_suite(read_suite(str(suite)), evaluated, processes=1, progress=told.append)
    assert computed == ["hall"]
    assert told[0] == "2 of 3 rows done"
    assert (evaluated / "rows.csv").read_bytes() == before


def test_a_case_that_fails_is_a_row_that_says_why_and_is_tried_again(tmp_path: Path) -> None:
    gone = parse_suite({"buildings": ["no/such/folder"], "presets": ["default"]})
    for _ in range(2):
        run = runner.run_suite(gone, tmp_path, processes=1)
        assert "no/such/folder" in run.rows[0].failed
    assert "## Failed" in markdown("x", tables(run.rows, run.seconds))


def test_a_row_survives_the_file() -> None:
    row = CaseResult(
        "k", "a; b, c", "default", "g", "office:rooms=3", 7, "", (1.0, 2.5), (), (np.nan,)
    )
    back = from_cells(dict(zip(COLUMNS, to_cells(row), strict=True)))
    assert to_cells(back) == to_cells(row)
    assert back.points == (1.0, 2.5)


def test_a_false_merge_is_told_with_its_bound() -> None:
    def pair(k: int, right: float) -> CaseResult:
        values = {"overlap": (0.0,), "accepted": (1.0 - right,), "confidence": (0.9,)}
        values |= dict.fromkeys(("displacement", "angle", "nearest"), (np.nan,))
        values |= {"right": (0.0,), "strict": (0.0,)}
        return CaseResult(str(k), str(k), "default", "apart", "", k, **values)

    rows = [pair(0, 0.0), *(pair(k, 1.0) for k in range(1, 10))]
    text = markdown("x", tables(rows, {}))
    assert "10 % (1/10; below 39.4 %)" in text
    assert "0.810 (N = 1)" in text  # Brier: sure by 0.9 and wrong.


def test_the_reliability_of_the_confidence_is_drawn_where_anything_was_accepted() -> None:
    surely = ([0.95, 0.95, 0.97], [True, True, False])
    drawn = reliability_figure({"default": surely, "thesis": ([0.3], [False])})
    assert drawn is not None
    assert drawn.startswith(b"\x89PNG")
    assert reliability_figure({"default": surely, "thesis": ([], [])}) is not None
    assert reliability_figure({"default": ([], [])}) is None


def test_simulated_cases_are_all_combinations() -> None:
    tree = {
        "buildings": ["office:seed={seed}", "home:rooms=5"],
        "overlaps": [0.2, 0.5],
        "seeds": [1, 2],
        "degradations": {"clean": {}, "noisy": {"sensor.lidar.noise": 0.02}},
    }
    cases = parse_suite(tree).cases
    assert len(cases) == 16
    assert cases[0] == CaseSpec(
        "office:seed=1 clean overlap 0.2 seed 1",
        "clean, overlap 0.2",
        building="office:seed=1",
        seed=1,
        overlap=0.2,
        degradation="clean",
    )


@pytest.mark.parametrize(
    ("tree", "words"),
    [
        ({"building": []}, "unknown key 'building'"),
        ({}, "no cases"),
        ({"buildings": ["x"], "presets": ["best"]}, "presets"),
        ({"buildings": ["x"], "seeds": ["one"]}, "seeds"),
        ({"buildings": ["x", "x"]}, "two cases"),
        ({"buildings": ["x"], "degradations": {"a": 3}}, "degradations"),
        ({"buildings": ["x"], "degradations": {"a": {"degrade.dropuot": 0.1}}}, "dropuot"),
        ({"buildings": ["x"], "overlaps": [1.5]}, "overlap"),
        ({"buildings": ["office:roomz=3"]}, "roomz"),
        (["x"], "expected the keys"),
    ],
)
def test_a_wrong_suite_is_told_in_one_line(tree: object, words: str) -> None:
    with pytest.raises(SuiteError, match=words):
        parse_suite(tree)


def test_missing_data_is_told_in_one_line(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "far.yaml"
    path.write_text("pairs: no/such/data\n")
    assert main(["evaluate", str(path), "-o", str(tmp_path / "out")]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert "no/such/data: no such folder of pairs" in error


@pytest.mark.parametrize("name", sorted(p.stem for p in (ROOT / "config/suites").glob("*.yaml")))
def test_the_bundled_suites_are_read_or_name_the_missing_data(name: str) -> None:
    path = ROOT / "config/suites" / f"{name}.yaml"
    try:
        assert read_suite(str(path)).cases
    except (SuiteError, EvaluationCaseError) as error:
        assert "no such folder" in str(error)  # noqa: PT017
