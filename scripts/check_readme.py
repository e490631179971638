"""Run the examples of a Markdown file: the fenced blocks marked ```bash check or ```python check.

Each block runs in the repository's root, in the file's order, with the environment of the Python
that runs this script first on the PATH; a block that fails ends the check.
"""

import os
import re
import subprocess
import sys
import time
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
BLOCK = re.compile(r"^```(bash|python) check\n(.*?)^```$", re.MULTILINE | re.DOTALL)
LIMIT = 600
"""Seconds that a block may take."""


def main() -> int:
    """Run the blocks; return the exit status."""
    name = sys.argv[1] if len(sys.argv) > 1 else "README.md"
    path = ROOT / name
    if not path.is_file():
        print(f"{name} is missing", file=sys.stderr)
        return 1
    text = path.read_text(encoding="utf-8")
    blocks = list(BLOCK.finditer(text))
    if not blocks:
        print(f"{name} has no block marked ```bash check or ```python check", file=sys.stderr)
        return 1
    for match in blocks:
        line = text.count("\n", 0, match.start()) + 1
        start = time.monotonic()
        status = _run(match[1], match[2])
        print(f"{name}:{line}: {match[1]} block, {time.monotonic() - start:.0f} s", flush=True)
        if status:
            print(f"{name}:{line}: the block failed with status {status}", file=sys.stderr)
            return 1
    return 0


def _run(language: str, code: str) -> int:
    """Run one block; return its exit status, 124 where it took too long."""
    # The venv's python re-executes itself with ROS's libraries: let the children do it afresh.
    environment = {k: v for k, v in os.environ.items() if k != "_ROS_WHEELS_BOOTSTRAP_COMPLETE"}
    environment["PATH"] = f"{Path(sys.executable).parent}{os.pathsep}{environment['PATH']}"
    interpreter = ["bash", "-euo", "pipefail"] if language == "bash" else [sys.executable]
    try:
        done = subprocess.run(
            [*interpreter, "-c", code], cwd=ROOT, env=environment, timeout=LIMIT, check=False
        )
    except subprocess.TimeoutExpired:
        return 124
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
