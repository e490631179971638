#!/usr/bin/env bash
# Print the path of the Python to use, the variable PYTHON or the first that is new enough.
set -euo pipefail
for candidate in ${PYTHON:-python3 python3.13 python3.12 python3.11}; do
  path=$(command -v "$candidate") || continue
  if "$path" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null; then
    echo "$path"
    exit 0
  fi
done
if [ -n "${PYTHON:-}" ]; then
  echo "PYTHON=$PYTHON is not a Python 3.11 or newer" >&2
else
  echo "No Python 3.11 or newer was found; install one, or name it: make setup PYTHON=/path/to/python3" >&2
fi
exit 1
