"""`topometric evaluate`: extraction, matching and fusion of a suite measured against the truth."""

from __future__ import annotations

import argparse
from dataclasses import asdict
from typing import Any

from topometric_ros.cli.common import (
    add_json,
    add_output,
    add_verbose,
    output_folder,
    progress_of,
    report,
)


def add_parser(commands: Any) -> None:
    """Add this command to the parser."""
    command = commands.add_parser(
        "evaluate",
        help="measure extraction, matching and fusion on a suite of cases",
        description="Write OUT/rows.csv (one row a case and preset), seconds.csv, tables.md and "
        "report.html. A run that was broken off goes on where it stopped. Exit status 1: every "
        "case failed.",
    )
    command.add_argument("suite", help="YAML file, or a bundled suite: short, pairs, ...")
    add_output(command)
    command.add_argument("--jobs", type=_jobs, metavar="N", help="processes (default: all cores)")
    command.add_argument(
        "--presets", nargs="+", metavar="P", help="default, thesis: in place of the suite's own"
    )
    command.add_argument(
        "--fresh", action="store_true", help="compute all rows again, after the code has changed"
    )
    add_json(command)
    add_verbose(command)
    command.set_defaults(command=evaluate)


def evaluate(options: argparse.Namespace) -> int:
    """Run the suite and write rows, tables and the report."""
    from topometric_ros.evaluation.report import report_html
    from topometric_ros.evaluation.rows import clear
    from topometric_ros.evaluation.runner import run_suite
    from topometric_ros.evaluation.suite import read_suite, with_presets
    from topometric_ros.evaluation.table_cells import markdown
    from topometric_ros.evaluation.tables import tables

    suite = read_suite(options.suite)
    if options.presets:
        suite = with_presets(suite, options.presets)
    folder, progress = output_folder(options), progress_of(options)
    if options.fresh:
        clear(folder)
    run = run_suite(suite, folder, processes=options.jobs, progress=progress)
    made = markdown(f"Suite {suite.name}", tables(run.rows, run.seconds))
    (folder / "tables.md").write_text(made, encoding="utf-8")
    html = report_html(suite.name, run.rows, run.seconds, folder, progress=progress)
    (folder / "report.html").write_text(html, encoding="utf-8")
    content = {"suite": suite.name, "rows": [asdict(row) for row in run.rows]}
    report(options, content, (made, f"written to {folder}"))
    return 1 if all(row.failed for row in run.rows) else 0


def _jobs(text: str) -> int:
    """Return a number of processes; raises ArgumentTypeError below 1."""
    if not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"expected a number of at least 1, got {text!r}")
    return int(text)
