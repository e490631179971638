#!/usr/bin/env bash
# Build both packages with colcon on the wheels, in a scratch folder, and try what was installed.
#
#   scripts/colcon_build.sh VENV
set -euo pipefail
cd "$(dirname "$0")/.."
venv=$(realpath "$1"); scratch="$PWD/build/colcon"; prefix="$scratch/install"
rm -rf "$scratch"; mkdir -p "$scratch"
export AMENT_PREFIX_PATH="$venv" CMAKE_PREFIX_PATH="$venv" PATH="$venv/bin:$PATH"

echo "colcon build (its output goes to build/colcon/log.txt)"
if ! "$venv/bin/python" -m colcon --log-base "$scratch/log" build \
  --build-base "$scratch/build" --install-base "$prefix" \
  --cmake-args -G Ninja -DBUILD_TESTING=OFF -DPython3_EXECUTABLE="$venv/bin/python" \
  -DCMAKE_PROJECT_INCLUDE="$PWD/scripts/wheel_targets.cmake" >"$scratch/log.txt" 2>&1; then
  tail -n 40 "$scratch/log.txt" >&2
  exit 1
fi
tail -n 1 "$scratch/log.txt"

for file in topometric_msgs/share/topometric_msgs/msg/TopometricMap.msg \
  topometric_ros/share/ament_index/resource_index/packages/topometric_ros \
  topometric_ros/share/topometric_ros/package.xml \
  topometric_ros/lib/topometric_ros/{extractor,merger,replay,topometric-extractor,topometric-merger}; do
  [ -e "$prefix/$file" ] || { echo "colcon did not install $file" >&2; exit 1; }
done
# The installed copy, not the source tree: from another folder, with its own path first.
site=$(dirname "$(find "$prefix/topometric_ros" -path '*/topometric_ros/__init__.py' | head -n 1)")
cd "$scratch"
PYTHONPATH="$(dirname "$site")" "$venv/bin/python" -c "
from topometric_ros.io import schemas
assert '/build/colcon/' in schemas.__file__, schemas.__file__
print(len(schemas.message_definitions()), 'message definitions are installed')"
