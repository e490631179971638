#!/usr/bin/env bash
# Create a virtual environment and install the wheels and this package, editable, into it.
#
#   scripts/create_venv.sh VENV
#
# Editable, because an edit is then seen at once and numba's compiled kernels outlive it. What an
# editable install leaves out, the files below share/ and lib/, install_share.sh adds.
set -euo pipefail
cd "$(dirname "$0")/.."
venv=$1
if [ ! -x "$venv/bin/pip" ]; then
  python=$(scripts/find_python.sh)
  echo "Creating $venv with $("$python" --version)"
  "$python" -m venv "$venv"
fi
echo "Installing the Python packages (a minute or two the first time)"
pip=("$venv/bin/python" -m pip --disable-pip-version-check)
# Most of what the wheels bring is never imported: leave compiling it to the first import.
"${pip[@]}" -qq install --no-compile -r wheels/build-tools.txt
"${pip[@]}" -qq install --no-compile --no-build-isolation -e '.[las,ros,test,dev]'
