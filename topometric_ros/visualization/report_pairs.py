"""The part of the report about one pair of agents: verdict, pictures, other poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from topometric_ros.alignment import Alignment, AlignmentStatus
from topometric_ros.fusion.poses import matrix_lines
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.figures import hex_colour
from topometric_ros.visualization.page import details, number, picture, pill, table, text, tiles
from topometric_ros.visualization.pair_figures import matches_figure, overlay_figure
from topometric_ros.voxels.palette import agent_colour

STATUS = {
    AlignmentStatus.ACCEPTED: ("good", "aligned"),
    AlignmentStatus.AMBIGUOUS: ("warn", "ambiguous"),
    AlignmentStatus.REJECTED: ("bad", "rejected"),
    AlignmentStatus.NONE: ("warn", "no candidate"),
    AlignmentStatus.WITHDRAWN: ("bad", "withdrawn"),
}
_MOST_ALTERNATIVES = 8


def alignment_numbers(alignment: Alignment) -> list[tuple[str, str]]:
    """The transform and how good it is, as (value, what it is)."""
    assert alignment.T_a_b is not None
    return [
        *_pose_numbers(alignment.T_a_b),
        (number(100 * alignment.confidence, 0, "%"), "confidence"),
        (number(100 * alignment.overlap, 0, "%"), "overlap"),
        (number(100 * alignment.rmse, 1, "cm"), "residual (RMSE)"),
    ]


def _pose_numbers(T: NDArray[np.float64]) -> list[tuple[str, str]]:
    """Yaw and translation of a transform; roll and pitch too where it has any."""
    yaw, pitch, roll = angles(T)
    values = [(number(yaw, 1) + "°", "yaw")]
    if max(abs(roll), abs(pitch)) > 0.05:
        values += [(number(roll, 1) + "°", "roll"), (number(pitch, 1) + "°", "pitch")]
    return values + [(number(T[k, 3], 2, "m"), axis) for k, axis in enumerate("xyz")]


def angles(T: NDArray[np.float64]) -> tuple[float, float, float]:
    """Return yaw, pitch and roll (REP-103) of a transform, degrees."""
    yaw = np.arctan2(T[1, 0], T[0, 0])
    pitch = np.arctan2(-T[2, 0], np.hypot(T[0, 0], T[1, 0]))
    roll = np.arctan2(T[2, 1], T[2, 2])
    degrees = np.degrees([yaw, pitch, roll])
    return float(degrees[0]), float(degrees[1]), float(degrees[2])


def sentence(reason: str) -> str:
    """A reason with a full stop."""
    reason = reason.strip()
    if not reason:
        return "No reason was given."
    return reason if reason.endswith((".", "!", "?")) else reason + "."


def alignment_section(
    alignment: Alignment, maps: Mapping[str, TopometricMap], names: Sequence[str]
) -> str:
    """Everything about one pair of agents: verdict, pictures, alternatives."""
    first, second = alignment.agents
    a, b = maps[first], maps[second]
    colours = [hex_colour(agent_colour(names.index(n))) for n in alignment.agents]
    T = alignment.T_a_b
    parts = [
        f"<h2>{text(first)} ↔ {text(second)} {pill(*STATUS[alignment.status])}</h2>",
        '<section class="card">',
        f"<p>{text(sentence(alignment.reason))}</p>",
        # With two agents the verdict above says the numbers already.
        "" if T is None or len(names) == 2 else tiles(alignment_numbers(alignment)),
    ]
    caption = "Walls that one agent alone saw keep its colour; red walls contradict free floor."
    best = best_alternative(alignment)
    if T is None and best is not None:
        T, caption = best
    if T is not None:
        png = overlay_figure(a, b, T, (colours[0], colours[1]))
        parts.append(picture(png, f"{second} laid over {first}", caption))
    if alignment.matches:
        note = f"{len(alignment.matches)} matched rooms; unmatched rooms are grey."
        parts.append(
            picture(matches_figure(a, b, alignment), f"matches of {first} and {second}", note)
        )
        parts.append(details("matched rooms", _matches_table(alignment)))
    parts += [_alternatives(alignment), _transform_details(alignment, a, b), "</section>"]
    return "".join(parts)


def best_alternative(alignment: Alignment) -> tuple[NDArray[np.float64], str] | None:
    """The pose that came nearest to being accepted, with a caption that says it was not."""
    if not alignment.alternatives:
        return None
    best = max(alignment.alternatives, key=lambda x: x.score)
    caption = f"The best pose that was considered (score {best.score:.0f}). It was not accepted."
    return best.T_a_b, caption


def _matches_table(alignment: Alignment) -> str:
    first, second = alignment.agents
    rows = [[str(m.room_a), str(m.room_b), number(m.distance, 3)] for m in alignment.matches]
    head = (f"room of {first}", f"room of {second}", "distance of descriptors")
    return table(head, rows, "nnn")


def _alternatives(alignment: Alignment) -> str:
    """Table of the other poses, best first."""
    if not alignment.alternatives:
        return ""
    ranked = sorted(alignment.alternatives, key=lambda x: -x.score)
    top = max(alignment.score, ranked[0].score)
    rows = []
    for k, other in enumerate(ranked[:_MOST_ALTERNATIVES]):
        share = number(100 * other.score / top, 0, "%") if top > 0 else "–"
        where = [number(other.T_a_b[i, 3], 2) for i in range(3)]
        yaw = number(angles(other.T_a_b)[0], 1) + "°"
        rows.append([str(k + 1), number(other.score, 0), share, yaw, *where])
    head = ("", "score", "of the best", "yaw", "x / m", "y / m", "z / m")
    title = "Other poses considered" if alignment.accepted else "Poses considered"
    return f"<h3>{title}</h3>" + table(head, rows, "nnnnnnn")


def _transform_details(alignment: Alignment, a: TopometricMap, b: TopometricMap) -> str:
    """The 4 x 4 transform to copy."""
    if alignment.T_a_b is None:
        return ""
    rows = "\n".join(matrix_lines(alignment.T_a_b))
    note = f"<p>p in {text(a.frame_id)} = T · p in {text(b.frame_id)}, metres</p>"
    return details("transform as a matrix", f"{note}<pre>{rows}</pre>")
