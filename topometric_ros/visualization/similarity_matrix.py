"""The picture of a similarity matrix (thesis figure 10)."""

from __future__ import annotations

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from topometric_ros.visualization.sheet import INK, PAPER
from topometric_ros.voxels.palette import room_colours


def matrix_figure(similarity: NDArray[np.float64], clusters: NDArray[np.int32]) -> bytes:
    """Draw the Jaccard index of every two views, those of a cluster side by side, as PNG bytes.

    `similarity` is (K, K) float64 in 0..1, `clusters` (K,) int32; each cluster is framed and has
    its colour, that of the similarity graph, beside its rows and columns.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.4, 6.4), facecolor=PAPER, dpi=150, layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.add_subplot()
    order = np.argsort(clusters, kind="stable")
    ends = np.flatnonzero(np.diff(clusters[order], append=-1)) + 1
    shown = axes.imshow(
        similarity[np.ix_(order, order)], vmin=0.0, vmax=1.0, cmap="Blues", interpolation="nearest"
    )
    margin = max(1.0, 0.03 * len(order))
    for start, end in zip([0, *ends[:-1]], ends, strict=True):
        colour = room_colours([clusters[order[start]]])[0] / 255.0
        _frame(axes, (start - 0.5, start - 0.5), end - start, end - start, "none", INK)
        _frame(axes, (-0.5 - margin, start - 0.5), 0.7 * margin, end - start, colour, PAPER)
        _frame(axes, (start - 0.5, -0.5 - margin), end - start, 0.7 * margin, colour, PAPER)
    axes.set_xlim(-0.5 - margin, len(order) - 0.5)
    axes.set_ylim(len(order) - 0.5, -0.5 - margin)
    axes.set_xlabel(f"{len(order)} views, in the order of their {len(ends)} clusters", color=INK)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.spines[:].set_visible(False)
    bar = figure.colorbar(shown, ax=axes, shrink=0.8, aspect=30, label="Jaccard index")
    bar.outline.set_visible(False)
    stream = io.BytesIO()
    # No software name or date: equal pictures have equal bytes.
    figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()


def _frame(
    axes: Any, corner: tuple[float, float], width: float, height: float, face: Any, edge: str
) -> None:
    from matplotlib.patches import Rectangle

    axes.add_patch(Rectangle(corner, width, height, facecolor=face, edgecolor=edge, linewidth=0.9))
