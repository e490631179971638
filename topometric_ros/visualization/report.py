"""The report of a merge: one HTML file that says at a glance what was aligned, and why not.

The verdict comes first, then the global map, then the evidence of every pair and every agent's
own map. The same result gives the same bytes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePath

from topometric_ros.alignment import (
    AgentPlacement,
    AgentStatus,
    AlignmentStatus,
    MergeResult,
)
from topometric_ros.extraction.quality import Quality
from topometric_ros.topometric_map import TopometricMap
from topometric_ros.visualization.figures import (
    global_figure,
    hex_colour,
    map_figure,
)
from topometric_ros.visualization.page import (
    counted,
    details,
    number,
    page,
    picture,
    pill,
    swatch,
    table,
    text,
    tiles,
)
from topometric_ros.visualization.report_pairs import (
    STATUS,
    alignment_numbers,
    alignment_section,
    angles,
    sentence,
)
from topometric_ros.visualization.report_quality import quality_details
from topometric_ros.voxels.palette import agent_colour, room_colours

_ADVICE = {
    AlignmentStatus.AMBIGUOUS: "Several poses explain the maps about equally well, so none "
    "is used. Walking one more room that only one place has usually decides.",
    AlignmentStatus.REJECTED: "The best pose contradicts what one of the agents saw, so it is not "
    "used. The agents may not have walked through the same rooms.",
    AlignmentStatus.NONE: "Nothing in the two maps fits together. More shared rooms are needed.",
    AlignmentStatus.WITHDRAWN: "It contradicts more certain alignments with other agents.",
}
_AGENT_STATUS = {
    AgentStatus.ANCHOR: ("good", "anchor"),
    AgentStatus.ALIGNED: ("good", "aligned"),
    AgentStatus.UNALIGNED: ("warn", "not aligned"),
}


def write_report(
    result: MergeResult,
    maps: Sequence[TopometricMap],
    path: Path,
    qualities: Mapping[str, Quality] | None = None,
) -> None:
    """Write the report of a merge as one self-contained HTML file.

    Parameters
    ----------
    result : what merging found
    maps : the agents' own maps, in the order of `result.agents`
    path : file to write
    qualities : reports of the extractions by agent, of those that were extracted here
    """
    path.write_text(report_html(result, maps, qualities), encoding="utf-8")


def report_html(
    result: MergeResult,
    maps: Sequence[TopometricMap],
    qualities: Mapping[str, Quality] | None = None,
) -> str:
    """Return the report of a merge as HTML; parameters as of :func:`write_report`."""
    by_agent = {agent.id: m for agent, m in zip(result.agents, maps, strict=True)}
    names = [agent.id for agent in result.agents]
    parts = [
        '<p class="kicker">Topometric map merging</p>',
        _verdict(result),
        _warnings(result, by_agent),
        _global_section(result, names),
        _agents_section(result),
        *(alignment_section(alignment, by_agent, names) for alignment in result.alignments),
        _maps_section(result, by_agent, qualities or {}),
    ]
    return page("Merge report: " + ", ".join(names), "\n".join(p for p in parts if p))


def _verdict(result: MergeResult) -> str:
    """The answer in one line, its numbers, and the reason."""
    placed = [a.id for a in result.agents if a.status is not AgentStatus.UNALIGNED]
    lost = [a.id for a in result.agents if a.status is AgentStatus.UNALIGNED]
    if len(result.agents) < 2:
        kind, headline = "warn", "One agent only: there is nothing to align"
    elif not lost:
        kind, headline = "good", f"{_listed(placed)} are aligned"
    elif len(placed) > 1:
        kind = "warn"
        headline = f"{_listed(placed)} are aligned; {_listed(lost)} {_are(lost)} not"
    else:
        kind, headline = "warn", f"{_listed(lost)} could not be aligned with {_listed(placed)}"
    lines = [f"<h1>{text(headline)}</h1>"]
    if len(result.alignments) == 1:
        (only,) = result.alignments
        if only.accepted and only.T_a_b is not None:
            lines.append(tiles(alignment_numbers(only)))
        lines.append(f"<p>{text(sentence(only.reason))}</p>")
        lines += [f"<p>{text(_ADVICE[only.status])}</p>"] if only.status in _ADVICE else []
    else:
        lines += [
            f"<p>{pill(*STATUS[a.status])} <b>{text(' ↔ '.join(a.agents))}</b>: "
            f"{text(sentence(a.reason))}</p>"
            for a in result.alignments
        ]
    return f'<section class="verdict {kind}">{"".join(lines)}</section>'


def _warnings(result: MergeResult, maps: Mapping[str, TopometricMap]) -> str:
    lines = [text(w) for w in result.warnings]
    lines += [f"{text(name)}: {text(w)}" for name, m in maps.items() for w in m.warnings]
    lines = list(dict.fromkeys(lines))
    if not lines:
        return ""
    items = "".join(f"<li>{line}</li>" for line in lines)
    return f'<section class="card"><b>{pill("warn", "warnings")}</b><ul>{items}</ul></section>'


def _global_section(result: MergeResult, names: Sequence[str]) -> str:
    m = result.global_map.map
    placed = [a.id for a in result.agents if a.T_global_agent is not None]
    png = global_figure(result.global_map, names, placed)
    size = _size(m)
    caption = f"{size}, in frame {result.global_frame}. Outlined: what each agent saw."
    if result.global_map.changes:
        caption += " Filled: what has changed between their visits."
    if len(placed) < 2:
        caption = f"{size}, in frame {result.global_frame}: the map of {_listed(placed)} alone."
    return (
        '<h2>Global map</h2><section class="card">'
        + (picture(png, "global map from above", caption) or "<p>The map is empty.</p>")
        + "</section>"
    )


def _agents_section(result: MergeResult) -> str:
    rows = []
    for k, agent in enumerate(result.agents):
        kind, label = _AGENT_STATUS[agent.status]
        T = agent.T_global_agent
        where = ["–"] * 4 if T is None else [number(angles(T)[0], 1) + "°"]
        where += [] if T is None else [number(T[i, 3], 2) for i in range(3)]
        name = swatch(hex_colour(agent_colour(k))) + text(agent.id)
        rows.append([name, pill(kind, label), *where, text(agent.reason), text(_source(agent))])
    head = ("agent", "place", "yaw", "x / m", "y / m", "z / m", "reason", "source")
    return f'<h2>Agents</h2><section class="card">{table(head, rows, "  nnnn  ")}</section>'


def _maps_section(
    result: MergeResult, maps: Mapping[str, TopometricMap], qualities: Mapping[str, Quality]
) -> str:
    cards = [
        _map_card(k, agent, maps[agent.id], result, qualities.get(agent.id))
        for k, agent in enumerate(result.agents)
    ]
    return f'<h2>Each agent\'s map</h2><div class="pair">{"".join(cards)}</div>'


def _map_card(
    k: int, agent: AgentPlacement, m: TopometricMap, result: MergeResult, quality: Quality | None
) -> str:
    """One agent's picture, its table of rooms and the quality of its extraction."""
    neighbours: dict[int, list[int]] = {room.id: [] for room in m.rooms}
    for passage in m.passages:
        first, second = passage.rooms
        neighbours[first].append(second)
        neighbours[second].append(first)
    rows = [
        [
            swatch(hex_colour(room_colours([room.id])[0].tolist())) + str(room.id),
            str(room.storey),
            number(room.area, 1),
            f"{room.voxels:,}",
            ", ".join(str(n) for n in sorted(set(neighbours[room.id]))) or "none",
            text(_partners(agent.id, room.id, result)) or "–",
        ]
        for room in m.rooms
    ]
    head = ("room", "storey", "area / m²", "voxels", "next to", "the same as")
    rooms = details("rooms", table(head, rows, " nnn  ")) if rows else "<p>No rooms found.</p>"
    title = swatch(hex_colour(agent_colour(k))) + text(agent.id)
    body = picture(map_figure(m), f"map of {agent.id}", _size(m)) or "<p>The map is empty.</p>"
    return f'<section class="card"><b>{title}</b>{body}{rooms}{quality_details(quality)}</section>'


def _partners(agent: str, room: int, result: MergeResult) -> str:
    """Which rooms of other agents one room is held to be."""
    found = []
    for alignment in result.alignments:
        if not alignment.accepted:
            continue
        for match in alignment.matches:
            if (agent, room) == (alignment.agents[0], match.room_a):
                found.append(f"{alignment.agents[1]} {match.room_b}")
            elif (agent, room) == (alignment.agents[1], match.room_b):
                found.append(f"{alignment.agents[0]} {match.room_a}")
    return ", ".join(found)


def _size(m: TopometricMap) -> str:
    """How large a map is, in words."""
    area = sum(room.area for room in m.rooms)
    storeys = f", {len(m.storeys)} storeys" if len(m.storeys) > 1 else ""
    return (
        f"{counted(len(m.rooms), 'room')} ({area:.0f} m²), "
        f"{counted(len(m.passages), 'passage')}{storeys}, {len(m.voxels):,} voxels of "
        f"{m.voxel_size:g} m"
    )


def _source(agent: AgentPlacement) -> str:
    """The last part of where a map came from: the page should not depend on where files lie."""
    file, colon, topic = agent.source.partition(":")
    return PurePath(file).name + colon + topic


def _listed(names: Sequence[str]) -> str:
    """Names as a list in words."""
    return " and ".join([", ".join(names[:-1]), names[-1]]) if len(names) > 1 else "".join(names)


def _are(names: Sequence[str]) -> str:
    return "are" if len(names) > 1 else "is"
