#!/usr/bin/env bash
# The main job on the bundled bag: two agents' recorded clouds in, one global topometric map out.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=${VENV:-.venv}
"$venv/bin/topometric" replay bags/demo -o out/demo
"$venv/bin/python" scripts/compare_with_truth.py out/demo bags/demo.truth.json
echo "Report:      out/demo/report.html (open it in a browser)"
echo "Output bag:  out/demo/bag (Foxglove, RViz, or ros2 bag play)"
