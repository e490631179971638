"""Time the extraction of one cloud, stage by stage: bench.py [CLOUD [OUT]].

Without a cloud, the first agent's of the bundled bag.
"""

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
CLOUD = f"{ROOT / 'bags/demo'}:/robot1/cloud_map"


def main() -> int:
    """Run `topometric extract` and print its timings.json as a table; return its status."""
    cloud = sys.argv[1] if len(sys.argv) > 1 else CLOUD
    out = Path(sys.argv[2] if len(sys.argv) > 2 else ROOT / "out/bench")
    # A process of its own, as users run it; twice, because the first run compiles the kernels.
    command = [sys.executable, "-m", "topometric_ros", "extract", cloud, "-o", str(out)]
    for _ in range(2):
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
