"""Print the CPU seconds of each stage, from the timings that the command line writes.

bench.py [CLOUD [OUT]]: the extraction of one cloud; without one, the replay of the bundled bag.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]


def main() -> int:
    """Run the command and print its timings.json as a table; return its status."""
    job = ["extract", sys.argv[1]] if len(sys.argv) > 1 else ["replay", str(ROOT / "bags/demo")]
    out = Path(sys.argv[2] if len(sys.argv) > 2 else ROOT / "out/bench")
    # A process of its own, as users run it; twice, because the first run compiles the kernels.
    for _ in range(2):
        command = [sys.executable, "-m", "topometric_ros", *job, "-o", str(out)]
        status = subprocess.run(command, check=False).returncode
        if status:
            return status
    timings = json.loads((out / "timings.json").read_text(encoding="utf-8"))
    rows = list(_rows(timings, ""))
    width = max(len(name) for name, _ in rows)
    for name, seconds in rows:
        print(f"{name:<{width}}  {seconds:8.2f}")
    return 0


def _rows(timings: dict[str, Any], prefix: str) -> Iterator[tuple[str, float]]:
    """Yield the dotted names and values of nested timings (CPU seconds)."""
    for name, value in timings.items():
        if isinstance(value, dict):
            yield from _rows(value, f"{prefix}{name}.")
        elif isinstance(value, int | float):
            yield f"{prefix}{name}", value


if __name__ == "__main__":
    sys.exit(main())
