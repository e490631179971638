#!/usr/bin/env bash
# Install what ROS looks for below share/ and lib/ of an environment: launch files, parameters,
# RViz settings, the entry in the package index and the executables of `ros2 run`.
#
#   scripts/install_share.sh VENV
set -euo pipefail
venv=$(realpath "$1")
cd "$(dirname "$0")/.."
rm -rf "$venv/share/topometric_ros" "$venv/lib/topometric_ros"
"$venv/bin/python" -W ignore setup.py -q install_data --install-dir "$venv"
