"""The quality of one agent's extraction as a part of a report: numbers and findings."""

from __future__ import annotations

from topometric_ros.extraction.quality import Quality
from topometric_ros.visualization.page import details, number, pill, table, text


def quality_details(quality: Quality | None) -> str:
    """Return a fold-out of what was found and what looks wrong, "" where nothing is known."""
    if quality is None:
        return ""
    rows = [[text(name), value] for name, value in _numbers(quality)]
    found = [
        [pill("warn" if f.is_warning else "good", f.severity), text(f.message), text(f.advice)]
        for f in quality.findings
    ]
    body = table(("measure", "value"), rows, " n")
    body += table(("", "finding", "what to do"), found) if found else "<p>Nothing looks wrong.</p>"
    return details("quality of the extraction", body)


def _numbers(quality: Quality) -> list[tuple[str, str]]:
    """Return the name and the value of every number worth showing."""
    height = quality.clear_height
    unlabelled = [(f"voxels in no room, {k}", v) for k, v in quality.unlabelled.items()]
    parts = " + ".join(number(area, 0) for _, area in quality.parts[:5])
    return [
        ("points, thinned", f"{quality.points:,}"),
        ("distance of points", number(quality.spacing, 2, "m")),
        ("noise of surfaces", number(100 * quality.noise, 1, "cm")),
        ("points on level or upright surfaces", _share(quality.straight)),
        ("tilt taken out", number(quality.tilt_deg, 2) + "°"),
        ("usual free height", "unknown" if height is None else number(height, 1, "m")),
        ("floor seen in rooms", _share(quality.floor_seen)),
        ("ceiling seen in rooms", _share(quality.ceiling_seen)),
        ("navigable floor", number(quality.navigable_area, 0, "m²")),
        ("parts joined by passages", (parts or "0") + "\u00a0m²"),
        *((name, _share(value)) for name, value in unlabelled),
    ]


def _share(value: float) -> str:
    return number(100 * value, 0) + " %"
