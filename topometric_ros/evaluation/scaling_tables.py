"""The tables and the picture of what sizes cost."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping
from typing import Any

from topometric_ros.evaluation.scaling import Measures, Size, seconds_of
from topometric_ros.evaluation.table_cells import markdown_table

Known = Mapping[Size, Measures]
STEPS = ("extract", "merge")
_MB = 2.0**20
_LEAST = 1e-3
"""Fewer CPU seconds are drawn as so many: the axis has no zero."""


def scaling_tables(known: Known, failed: Mapping[Size, str]) -> str:
    """Return a summary and the seconds of every stage, as Markdown."""
    head = ["rooms × agents", "true rooms", "found", "true links", "passages", "points"]
    head += ["extract CPU s", "merge CPU s"]
    head += ["extract peak MB", "merge peak MB", "map kB", "global map kB"]
    head += ["pairs", "sharing half", "accepted", "wrong"]
    parts = [markdown_table(head, [_summary(size, m) for size, m in known.items()])]
    for step in STEPS:
        stages = list(dict.fromkeys(s for m in known.values() for s in seconds_of(m, step)))
        lines = []
        for size, m in known.items():
            seconds = seconds_of(m, step)
            cells = [f"{seconds[s]:.2f}" if s in seconds else "–" for s in stages]
            lines.append([_name(size), *cells])
        parts.append(f"CPU seconds of {step} by stage:\n\n" + markdown_table(["", *stages], lines))
    if failed:
        said = "\n".join(f"- {_name(size)}: {error}" for size, error in failed.items())
        parts.append("Sizes that gave nothing:\n\n" + said)
    return "\n\n".join(parts) + "\n"


def scaling_picture(known: Known) -> bytes:
    """Draw seconds by stage, memory and bytes against rooms and against agents; PNG."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(18, 8), layout="constrained")
    FigureCanvasAgg(figure)
    axes: Any = figure.subplots(2, 4)
    fewest = min(size.agents for size in known)
    most = max(size.agents for size in known)
    # The building that all numbers of agents were tried in.
    middle = next(size.rooms for size in sorted(known) if size.agents == most)
    by_rooms = {s.rooms: m for s, m in sorted(known.items()) if s.agents == fewest}
    by_agents = {s.agents: m for s, m in sorted(known.items()) if s.rooms == middle}
    _draw(axes[0], by_rooms, f"rooms ({fewest} agents)")
    _draw(axes[1], by_agents, f"agents ({middle} rooms)")
    stream = io.BytesIO()
    # No software name: equal pictures have equal bytes.
    figure.savefig(stream, format="png", dpi=110, metadata={"Software": None})
    return stream.getvalue()


def _draw(row: Any, by_size: Mapping[int, Measures], across: str) -> None:
    sizes = list(by_size)
    for axes, step in zip(row, STEPS, strict=False):
        stages = dict.fromkeys(s for m in by_size.values() for s in seconds_of(m, step))
        for k, stage in enumerate(stages):
            seconds = [seconds_of(m, step).get(stage, float("nan")) for m in by_size.values()]
            shown = [max(s, _LEAST) for s in seconds]
            # There are ten colours and more stages.
            line = "-" if k < 10 else "--"
            axes.plot(sizes, shown, line, marker="o", ms=3, label=stage)
        axes.set_ylabel(f"{step}, CPU s")
    lines: dict[str, Callable[[Measures], float]] = {
        "extract": lambda m: m["extract.peak_mb"],
        "merge": lambda m: m["merge.peak_mb"],
    }
    _lines(row[2], by_size, lines, "peak MB")
    lines = {
        "largest agent's map": lambda m: m["map_bytes"] / _MB,
        "global map": lambda m: m["global_bytes"] / _MB,
        "its cloud, 12 bytes a point": lambda m: 12 * m["points"] / _MB,
    }
    _lines(row[3], by_size, lines, "message, MB")
    for axes in row:
        axes.set_xscale("log")
        if axes is row[2]:
            axes.set_ylim(bottom=0.0)
        else:
            axes.set_yscale("log")
        axes.set_xticks(sizes, [str(size) for size in sizes])
        axes.minorticks_off()
        axes.set_xlabel(across)
        axes.grid(visible=True, alpha=0.3)
        axes.legend(fontsize=7, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))


def _lines(
    axes: Any,
    by_size: Mapping[int, Measures],
    lines: Mapping[str, Callable[[Measures], float]],
    up: str,
) -> None:
    for label, value in lines.items():
        axes.plot(
            list(by_size), [value(m) for m in by_size.values()], marker="o", ms=3, label=label
        )
    axes.set_ylabel(up)


def _summary(size: Size, m: Measures) -> list[str]:
    extract, merge = (sum(seconds_of(m, step).values()) for step in STEPS)
    whole = ["true_rooms", "rooms_found", "true_links", "passages_found", "points"]
    counts = ["pairs", "sharing", "accepted", "wrong"]
    return [
        _name(size),
        *(f"{m[name]:,.0f}" for name in whole),
        f"{extract:.1f}",
        f"{merge:.1f}",
        f"{m['extract.peak_mb']:,.0f}",
        f"{m['merge.peak_mb']:,.0f}",
        f"{m['map_bytes'] / 1024:,.0f}",
        f"{m['global_bytes'] / 1024:,.0f}",
        *(f"{m[name]:.0f}" for name in counts),
    ]


def _name(size: Size) -> str:
    return f"{size.rooms} × {size.agents}"
