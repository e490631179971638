#!/usr/bin/env bash
# Simulate pairs of agents for `topometric benchmark`; those that are there already are kept.
#
#   scripts/simulate_pairs.sh VENV OUT SEEDS [BUILDING ...]
#
# SEEDS pairs of every building at each overlap of 0.2, 0.35, 0.5 and 0.7 and with nothing in
# common, with the simulation's default sensor and noise.
set -euo pipefail
venv=$1 out=$2 seeds=$3
shift 3
for building in "$@"; do
  first=0
  for overlap in 0.2 0.35 0.5 0.7 0; do
    done_file="$out/.${building//[^A-Za-z0-9]/_}_${overlap}_$seeds"
    if [ ! -e "$done_file" ]; then
      "$venv/bin/topometric" simulate "$building" -o "$out" --overlap "$overlap" \
        --seed "$first" --count "$seeds"
      touch "$done_file"
    fi
    # Seeds name the folders, so each overlap has its own.
    first=$((first + 1000))
  done
done
