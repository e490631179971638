"""One HTML page that shows a map in 3D in any browser, without a network.

The page holds plotly's script, the points as base64 and its own small script; a content security
policy forbids it to fetch anything.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from importlib.resources import files
from typing import Any

import numpy as np

from topometric_ros.topometric_map import Room
from topometric_ros.visualization.figures import hex_colour
from topometric_ros.visualization.page import counted, number, text
from topometric_ros.visualization.page_stages import base64_of
from topometric_ros.visualization.view import (
    Match,
    View,
    ViewPoints,
    room_name,
    room_shares,
    view_points,
)
from topometric_ros.voxels.palette import room_colours

GRAPH_HEIGHT = 2.3
"""Height in metres above a storey's floor at which its part of the graph is drawn."""


def view_html(view: View, stages: Mapping[str, Any] | None = None) -> str:
    """Return the page of a view; `stages` is what `page_stages` made of it."""
    from plotly.offline import get_plotlyjs

    m = view.map
    folder = files("topometric_ros.visualization")
    page = (folder / "view_page.html").read_text(encoding="utf-8")
    counts = [(len(m.rooms), "room"), (len(m.passages), "passage"), (len(m.storeys), "storey")]
    words = [counted(count, word) for count, word in counts]
    words.append(f"{len(m.voxels):,} voxels of {number(m.voxel_size, 2, 'm')}")
    summary = ", ".join(words)
    # "</script>" would end the element and "<!--" keep it open: nothing in the data may do that.
    content = {**_data(view, view_points(view)), "stages": stages or {}}
    data = json.dumps(content, allow_nan=False).replace("<", "\\u003c")
    parts = {
        "@TITLE@": text(view.title),
        "@SUMMARY@": text(summary),
        "@MATCHES@": _matches(view.matches),
        "@DATA@": data,
        "@STAGES@": (folder / "view_stages.js").read_text(encoding="utf-8"),
        "@SCRIPT@": (folder / "view_page.js").read_text(encoding="utf-8"),
        "@PLOTLY@": get_plotlyjs(),
    }
    # In one pass: what is put in is never searched for marks itself.
    return re.sub(r"@[A-Z]+@", lambda mark: parts[mark[0]], page)


def _data(view: View, points: ViewPoints) -> dict[str, Any]:
    m = view.map
    index = {storey.id: k for k, storey in enumerate(m.storeys)}
    floors = [storey.floor_z for storey in m.storeys]
    places = {room.id: index[room.storey] for room in m.rooms}

    def over(place: tuple[float, float, float], storey: int) -> list[float]:
        return [round(v, 3) for v in (place[0], place[1], floors[storey] + GRAPH_HEIGHT)]

    nodes = {room.id: over(room.centroid, places[room.id]) for room in m.rooms}
    edges = []
    for passage in m.passages:
        ends = [places[room] for room in passage.rooms]
        middle = over(passage.position, min(ends))
        if ends[0] != ends[1]:
            middle[2] = (nodes[passage.rooms[0]][2] + nodes[passage.rooms[1]][2]) / 2
        path = [nodes[passage.rooms[0]], middle, nodes[passage.rooms[1]]]
        edges.append({"storeys": sorted(set(ends)), "path": path})
    return {
        "points": {
            "xyz": base64_of(points.xyz.astype("<f4")),
            "room": base64_of(points.room.astype("<i4")),
            "storey": base64_of(points.storey),
            "observers": base64_of(points.observers),
            "upper": base64_of(points.upper.astype(np.uint8)),
        },
        "classes": [{"name": n, "colour": hex_colour(c)} for n, c in points.classes],
        "storeys": [
            {
                "name": f"{storey.id}, floor at {number(storey.floor_z, 2, 'm')}",
                "colour": hex_colour(room_colours([k + 1])[0]),
            }
            for k, storey in enumerate(m.storeys)
        ]
        or [{"name": "0", "colour": hex_colour(room_colours([1])[0])}],
        "rooms": [
            {
                "id": room.id,
                "name": room_name(room.id),
                "storey": places[room.id],
                "colour": hex_colour(room_colours([room.id])[0]),
                "node": nodes[room.id],
                "attributes": _attributes(view, room),
            }
            for room in m.rooms
        ],
        "edges": edges,
    }


def _attributes(view: View, room: Room) -> list[tuple[str, str]]:
    """Return what a click on a room shows, as words."""
    size = np.subtract(room.bounds[1], room.bounds[0])
    neighbours = sorted(
        {i for p in view.map.passages if room.id in p.rooms for i in p.rooms} - {room.id}
    )
    attributes = [
        ("storey", str(room.storey)),
        ("kind", f"{room.kind} ({100 * room.kind_confidence:.0f}\u00a0%)"),
        ("area", number(room.area, 1, "m²")),
        ("floor inside the walls", number(room.floor_area, 1, "m²")),
        ("volume", "no ceiling seen" if room.volume is None else number(room.volume, 1, "m³")),
        ("rim seen", f"{100 * room.completeness:.0f}\u00a0%, {room.frontier:.1f}\u00a0m open"),
        ("size", " × ".join(f"{v:.1f}" for v in size) + "\u00a0m"),
        ("centre", ", ".join(number(v, 2) for v in room.centre or room.centroid)),
        ("voxels", f"{room.voxels:,}"),
        ("passages to", ", ".join(map(str, neighbours)) or "none found"),
    ]
    if len(view.agents) > 1:
        shares = room_shares(view, room.id)
        seen = ", ".join(f"{agent} ({100 * share:.0f} %)" for agent, share in shares.items())
        attributes.append(("seen by", seen or "nobody"))
    own = view.rooms_of.get(room.id, ())
    if own:
        attributes.append(("agents' rooms", ", ".join(f"{agent} {i}" for agent, i in own)))
    for match in view.matches:
        held = "" if match.status == "accepted" else f" ({match.status})"
        attributes += [
            ("match", f"{match.agents[0]} room {a} = {match.agents[1]} room {b}{held}")
            for a, b in match.rooms
            if {(match.agents[0], a), (match.agents[1], b)} & set(own)
        ]
    return attributes


def _matches(matches: tuple[Match, ...]) -> str:
    if not matches:
        return ""
    body = "".join(
        f"<p><b>{text(' – '.join(match.agents))}: {text(match.status)}</b></p>"
        f'<p class="soft">{text(match.reason)}</p>'
        + "".join(
            f"<p>{text(match.agents[0])} room {a} = {text(match.agents[1])} room {b}</p>"
            for a, b in match.rooms
        )
        for match in matches
    )
    return f'<h2>Matches</h2><div id="matches">{body}</div>'
