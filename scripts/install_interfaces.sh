#!/usr/bin/env bash
# Build an interface package with cmake and install it into a virtual environment with ROS wheels.
#
#   scripts/install_interfaces.sh VENV PACKAGE_DIRECTORY
#
# A package that can be imported already and is not one of ours (tf2_msgs from apt, say) is left.
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)
venv=$(realpath "$1"); source=$(realpath "$2"); name=$(basename "$source")
build="$root/build/interfaces/$name-$(basename "$venv")"

owner="$venv/share/$name/package.xml"
if [ ! -e "$owner" ] && "$venv/bin/python" -c "import $name.msg" 2>/dev/null; then
  echo "$name: the installed one is used"; exit 0
fi

# Another environment's libraries must not leak in when this runs from an activated one.
unset LD_LIBRARY_PATH PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE CMAKE_PREFIX_PATH
export AMENT_PREFIX_PATH="$venv" PATH="$venv/bin:$PATH" VIRTUAL_ENV="$venv"
log="$build/log.txt"
rm -rf "$build"; mkdir -p "$build"
if ! {
  cmake -S "$source" -B "$build" -G Ninja -DCMAKE_BUILD_TYPE=Release \
    -DCMAKE_PREFIX_PATH="$venv" -DCMAKE_INSTALL_PREFIX="$venv" -DBUILD_TESTING=OFF \
    -DPython3_EXECUTABLE="$venv/bin/python" \
    -DCMAKE_PROJECT_INCLUDE="$root/scripts/wheel_targets.cmake"
  cmake --build "$build"
  cmake --install "$build"
} >"$log" 2>&1; then
  tail -n 30 "$log" >&2
  echo "$name: the build failed; the whole log is $log" >&2
  exit 1
fi
"$venv/bin/python" -c "import $name.msg"
echo "$name: built and installed"
