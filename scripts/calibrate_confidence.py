#!/usr/bin/env python3
"""Tell how far the confidence of alignments may be believed: Brier score and reliability.

    calibrate_confidence.py PAIRS.json [PAIRS.json ...]

Reads what `measure_merging.py` writes. Counted are the answers that name a best pose (accepted and
ambiguous); it is right under 0.5 m and 5 degrees. Prints the Brier score as told and with the odds
fitted anew on all other buildings (one building left out at a time), and a reliability table.
"""

from __future__ import annotations

import argparse
import itertools
import json
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

EDGES = (0.0, 0.25, 0.5, 0.7, 0.8, 0.9, 0.95, 0.99, 1.0)
Numbers = NDArray[np.float64]


def main() -> None:
    """Print the score and the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("pairs", type=Path, nargs="+")
    rows: list[dict[str, Any]] = []
    for path in parser.parse_args().pairs:
        rows += json.loads(path.read_text(encoding="utf-8"))
    rows = [row for row in rows if row["status"] in ("accepted", "ambiguous")]
    told = np.array([row["confidence"] for row in rows])
    right = np.array([float(row["rank"] == 1) for row in rows])
    accepted = np.array([row["status"] == "accepted" for row in rows])
    building = np.array([row["a"].split("__")[0] for row in rows])
    for name, some in (("accepted", accepted), ("accepted and ambiguous", told >= 0.0)):
        fitted = _left_out(told[some], right[some], building[some])
        print(
            f"{name}: {int(right[some].sum())} of {some.sum()} right, Brier score "
            f"{np.mean((told[some] - right[some]) ** 2):.3f}, with odds fitted on other buildings "
            f"{np.mean((fitted - right[some]) ** 2):.3f}"
        )
    print("\n| told | N | mean told | right |\n|---|---:|---:|---:|")
    for low, high in itertools.pairwise(EDGES):
        some = (told >= low) & ((told < high) | (high == EDGES[-1]))
        if some.any():
            share = f"{right[some].mean():.2f} ({int(right[some].sum())})"
            print(f"| {low:g} to {high:g} | {some.sum()} | {told[some].mean():.2f} | {share} |")


def _left_out(told: Numbers, right: Numbers, building: NDArray[np.str_]) -> Numbers:
    """Return the probabilities by a logistic fit of the told odds on all other buildings."""
    clipped = np.clip(told, 1e-4, 1.0 - 1e-6)
    x = np.log(clipped / (1.0 - clipped))
    result = np.zeros_like(told)
    for name in np.unique(building):
        here = building == name
        a, b = _fitted(x[~here], right[~here])
        result[here] = 1.0 / (1.0 + np.exp(-(a + b * x[here])))
    return result


def _fitted(x: Numbers, right: Numbers) -> tuple[float, float]:
    """Return intercept and slope; a weak prior at 0 and 1 keeps them finite where all are right."""

    def loss(w: Numbers) -> float:
        odds = w[0] + w[1] * x
        prior = 0.05 * (w[0] ** 2 + (w[1] - 1.0) ** 2)
        return float(np.sum(np.log1p(np.exp(-(2.0 * right - 1.0) * odds))) + prior)

    a, b = minimize(loss, np.array([0.0, 1.0])).x
    return float(a), float(b)


if __name__ == "__main__":
    main()
