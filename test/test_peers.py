"""The peers find what they should, say what they lack, and the tables do not flatter anybody."""

from __future__ import annotations

import json
import re
import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

from test.helpers import box_room, moved, yaw_transform
from topometric_ros.cli.benchmark import PEERS
from topometric_ros.cli.main import main
from topometric_ros.evaluation.benchmark import (
    BenchmarkRow,
    read_benchmark,
    run_benchmark,
    write_benchmark,
)
from topometric_ros.evaluation.benchmark_pairs import BenchmarkError, PairFolder, find_pairs
from topometric_ros.evaluation.benchmark_tables import benchmark_tables, false_merges, share_of
from topometric_ros.evaluation.peers.base import PeerError
from topometric_ros.evaluation.peers.birdseye import Birdseye
from topometric_ros.evaluation.peers.registry import DEFAULT_PEERS, PEER_NAMES, make_peer
from topometric_ros.evaluation.suite import parse_suite
from topometric_ros.fusion.poses import angle, apart, inverse

T_A_B = yaw_transform(2.1, (3.0, -7.5, 0.4))


def flat() -> tuple[np.ndarray, np.ndarray]:
    """Two agents' points of three different rooms: a saw the first two, b the last two."""
    rooms = [
        box_room((0.0, 0.0, 0.0), (6.0, 4.0, 2.6), (("x+", 1.2),)),
        box_room((6.2, -2.0, 0.0), (3.5, 7.0, 2.6), (("x-", 3.2), ("x+", 5.0))),
        box_room((9.9, 1.0, 0.0), (5.0, 3.0, 2.6), (("x-", 2.0),)),
    ]
    in_a, in_b = np.concatenate(rooms[:2]), np.concatenate(rooms[1:])
    return in_a, moved(in_b, inverse(T_A_B))


def row(**changes: object) -> BenchmarkRow:
    values: dict[str, object] = {
        **dict.fromkeys(("displacement", "angle", "score", "cpu", "peak_mb"), 0.01),
        **{"pair": "p", "peer": "one", "overlap": 0.5, "accepted": True},
    }
    return BenchmarkRow(**{**values, **changes})  # type: ignore[arg-type]


def write_pair(folder: Path, overlap: float = 0.5) -> Path:
    folder.mkdir(parents=True)
    for name, points in zip("ab", flat(), strict=True):
        head = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        head += "".join(f"property float {axis}\n" for axis in "xyz") + "end_header\n"
        data = points.astype("<f4").tobytes()
        (folder / f"{name}.ply").write_bytes(head.encode() + data)
    truth = {"plan": folder.name, "overlap": overlap, "a_from_b": T_A_B.tolist()}
    (folder / "truth.json").write_text(json.dumps(truth), encoding="utf-8")
    return folder


def pairs_in(folder: Path) -> tuple[PairFolder, ...]:
    return find_pairs([str(folder)], folder / "out").pairs


def test_birdseye_finds_a_known_transform():
    a, b = flat()
    found = Birdseye().align(a, b)
    assert found.T_a_b is not None
    assert apart(found.T_a_b, T_A_B, b) < 0.15
    assert np.degrees(angle(inverse(T_A_B) @ found.T_a_b)) < 1.0


def test_birdseye_proposes_nothing_where_there_are_no_walls():
    floor = np.random.default_rng(0).uniform((0, 0, 0), (5, 5, 0.02), (5000, 3))
    found = Birdseye().align(floor, floor)
    assert found.T_a_b is None
    assert not found.accepted


def test_a_missing_kiss_matcher_gives_one_clear_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
):
    monkeypatch.setitem(sys.modules, "kiss_matcher", None)
    pair = write_pair(tmp_path / "pair")
    assert main(["benchmark", str(pair), "-o", str(tmp_path), "--peers", "kiss_matcher"]) == 2
    said = capsys.readouterr().err.strip()
    assert "\n" not in said
    assert "kiss-matcher" in said
    assert 'pip install -e ".[benchmark]"' in said


def test_an_unknown_peer_is_told_with_the_known_ones():
    with pytest.raises(PeerError, match="unknown peer 'icp'; known: topometric, "):
        make_peer("icp")
    assert set(DEFAULT_PEERS) < set(PEER_NAMES)
    assert ", ".join(PEER_NAMES) == PEERS


def test_a_benchmark_goes_on_where_it_stopped(tmp_path: Path):
    pairs = pairs_in(write_pair(tmp_path / "pairs" / "one").parent)
    assert [pair.cell for pair in pairs] == ["pairs"]
    first = run_benchmark(pairs, ["birdseye"], tmp_path / "out")
    assert first[0].right
    assert 0 < first[0].cpu < 20
    assert 20 < first[0].peak_mb < 4000
    told: list[str] = []
    again = run_benchmark(pairs, ["birdseye"], tmp_path / "out", progress=told.append)
    assert not told
    assert again[0].pair == "one"


def test_a_run_out_of_time_is_a_row_that_says_so(tmp_path: Path):
    pairs = pairs_in(write_pair(tmp_path / "one"))
    rows = run_benchmark(pairs, ["birdseye"], tmp_path / "out", timeout=0.01)
    assert rows[0].error == "ended after 0.01 s"
    assert not rows[0].accepted
    assert not rows[0].right
    assert not run_benchmark(pairs, ["birdseye"], tmp_path / "out")[0].error


def test_rows_survive_the_file(tmp_path: Path):
    rows = [row(), row(peer="two", accepted=False, displacement=float("nan"), error="no, thanks")]
    write_benchmark(tmp_path / "rows.csv", rows)
    read = read_benchmark(tmp_path / "rows.csv")
    assert read["p", "one"] == rows[0]
    assert read["p", "two"].error == "no, thanks"
    assert np.isnan(read["p", "two"].displacement)


def test_a_suite_gives_pairs_that_are_kept_and_equal(tmp_path: Path):
    suite = tmp_path / "tiny.yaml"
    tree = {"pairs": str(tmp_path / "ready"), "cross": 1, "buildings": ["home:rooms=3"]}
    tree |= {"seeds": [4], "degradations": {"noisy": {"sensor.lidar.noise": 0.03}}}
    suite.write_text(json.dumps(tree), encoding="utf-8")
    for name in ("one", "two"):
        write_pair(tmp_path / "ready" / name)
    found = find_pairs([str(suite)], tmp_path / "out")
    assert found.origin == "4 pairs; 1 simulated: 1 building, 1 seed of each in every cell (4)"
    cells = {pair.cell: pair for pair in found.pairs}
    assert list(cells) == ["pairs", "crossed", "noisy, overlap 0.5"]
    made = cells["noisy, overlap 0.5"]
    assert made.name.startswith("home_rooms=3_noisy_overlap_0.5_seed_4-")
    assert 0.2 < made.overlap < 0.8
    assert cells["crossed"].overlap == 0.0
    kept = made.path / "a.ply"
    written = kept.read_bytes(), kept.stat().st_mtime_ns
    again = find_pairs([str(suite)], tmp_path / "out", progress=lambda text: None)
    assert again == found
    assert (kept.read_bytes(), kept.stat().st_mtime_ns) == written
    assert made in find_pairs([str(tmp_path / "out/pairs")], tmp_path).pairs
    assert made.cell in {
        case.group for case in parse_suite({"pairs": f"{tmp_path}/out/pairs"}).cases
    }
    other = find_pairs([str(suite)], tmp_path / "other").pairs[-1]
    assert (other.path / "a.ply").read_bytes() == written[0]


def test_a_limit_is_spread_over_all_pairs(tmp_path: Path):
    write_pair(tmp_path / "0")
    for k in range(1, 5):
        shutil.copytree(tmp_path / "0", tmp_path / str(k))
    found = find_pairs([str(tmp_path)], tmp_path / "out", limit=3)
    assert [pair.name for pair in found.pairs] == ["0", "1", "3"]


def test_a_suite_of_no_use_is_told_in_one_line(tmp_path: Path, capsys):
    assert main(["benchmark", "no_such", "-o", str(tmp_path), "--peers", "birdseye"]) == 2
    said = capsys.readouterr().err.strip()
    assert "\n" not in said
    assert "no folder of pairs, and no suite: no_such" in said
    suite = tmp_path / "three.yaml"
    suite.write_text("buildings: [home]\nagents: 3\n")
    with pytest.raises(BenchmarkError, match="3 agents"):
        find_pairs([str(suite)], tmp_path)


def test_a_case_that_cannot_be_simulated_is_told_and_the_others_are_run(tmp_path: Path):
    suite = tmp_path / "one.yaml"
    suite.write_text(f"pairs: {tmp_path / 'ready'}\nbuildings: [{tmp_path / 'no.npz'}]\n")
    write_pair(tmp_path / "ready" / "one")
    found = find_pairs([str(suite)], tmp_path / "out")
    assert [pair.name for pair in found.pairs] == ["one"]
    assert list(found.failed) == ["no.npz clean overlap 0.5 seed 0"]
    assert "- no.npz clean overlap 0.5 seed 0: " in benchmark_tables([row()], "", found.failed)


def test_pairs_that_are_not_there_are_told(tmp_path: Path):
    with pytest.raises(BenchmarkError, match=r"no pair \(a\.ply, b\.ply, truth\.json\)"):
        pairs_in(tmp_path)
    (tmp_path / "truth.json").write_text("{}", encoding="utf-8")
    with pytest.raises(BenchmarkError, match="not the truth of a pair"):
        pairs_in(tmp_path)


def test_a_pose_for_a_pair_without_overlap_is_a_false_merge():
    assert row(overlap=0.0).false_merge
    assert row(displacement=0.6).false_merge
    assert row(angle=6.0).false_merge
    assert not row(accepted=False, displacement=9.0).false_merge
    assert not row().false_merge


def test_a_rate_of_zero_has_its_bound():
    none = [row(displacement=9.0, accepted=False)] * 59
    assert false_merges(none) == "0 % (0/59; below 5.0 %)"
    assert share_of(none, lambda one: one.right) == "0 % (0/59; below 5.0 %)"
    assert share_of([row()] * 3, lambda one: one.right) == "100 % (3/3)"


def test_tables_hold_every_method_and_pair():
    rows = [row(), row(pair="q", overlap=0.0), row(peer="two", cpu=float("nan"), error="broke")]
    text = benchmark_tables(rows)
    assert "| one" + 4 * " | 100 % (1/1)" + " | 50 % (1/2; " in text
    assert re.search(r"\| q \| 0.00 \| \*\*0.010\*\* \|  \|", text)
    assert "- two on p: broke" in text


def test_cells_have_a_table_a_measure():
    rows = [row(cell="clean"), row(pair="q", cell="noisy", displacement=9.0, accepted=False)]
    rows += [row(peer="two", cell="clean", overlap=0.01, cpu=float("nan"))]
    text = benchmark_tables(rows, "2 pairs")
    assert text.startswith("2 pairs.")
    right = text.partition("Right and accepted, by cell:")[2].partition("Strictly")[0]
    assert "| clean | 100 % (1/1) | – |" in right
    assert "| noisy | 0 % (0/1; below 95.0 %) | – |" in right
    assert "| clean | 0.0 | – |" in text.partition("CPU seconds, median")[2]
