#!/usr/bin/env bash
# Install the Debian packages that the project needs and this machine lacks; nothing else.
#
#   scripts/system_packages.sh        PYTHON=... picks an interpreter, otherwise Debian's is used
set -euo pipefail

# g++: the message packages; the libraries: Open3D, and numba's threads.
wanted=(g++ libegl1 libgl1 libgomp1 libusb-1.0-0)
python=$("$(dirname "$0")/find_python.sh" 2>/dev/null || true)
case "$python" in
  "") [ -n "${PYTHON:-}" ] || wanted+=(python3 python3-venv python3-dev) ;;
  /usr/bin/*)
    version=$("$python" -c 'import sys; print("python%d.%d" % sys.version_info[:2])')
    wanted+=("$version-venv" "$version-dev") ;;
esac

if ! command -v dpkg-query >/dev/null; then
  echo "Not a Debian system: if a step below fails, install what is ${wanted[*]} on Debian." >&2
  exit 0
fi
missing=()
for package in "${wanted[@]}"; do
  status=$(dpkg-query -W -f '${db:Status-Status}' "$package" 2>/dev/null || true)
  [ "$status" = installed ] || missing+=("$package")
done
[ ${#missing[@]} -gt 0 ] || exit 0

as_root=()
if [ "$(id -u)" -ne 0 ]; then
  if ! sudo -n true 2>/dev/null; then
    echo "Debian packages are missing; run: sudo apt-get install ${missing[*]}" >&2
    exit 1
  fi
  as_root=(sudo -n)
fi
echo "Installing Debian packages: ${missing[*]}"
"${as_root[@]}" apt-get update -qq
"${as_root[@]}" env DEBIAN_FRONTEND=noninteractive \
  apt-get install -y -qq --no-install-recommends "${missing[@]}" >/dev/null
