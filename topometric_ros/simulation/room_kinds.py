"""What kind a room is of, from the names that data sets and models give it."""

from __future__ import annotations

import re

_WORDS = {
    "stairs": ("stair", "treppe"),
    "corridor": ("hallway", "corridor", "flur", "diele", "foyer", "lobby", "gard"),
    "meeting room": ("conference", "meeting", "besprechung", "seminar", "auditorium"),
    "laboratory": ("laboratory", "labor", "lab"),
    "toilet": ("wc", "toilet", "restroom"),
    "bathroom": ("bath", "bad"),
    "kitchen": ("kitchen", "pantry", "küche", "kochen"),
    "living room": ("living", "wohnen", "lounge", "galerie"),
    "bedroom": ("bedroom", "schlaf"),
    "office": ("office", "buero", "büro"),
    "store": ("stor", "copy", "keller", "abstell", "utility", "technik", "garage", "hwr", "boden"),
}


def kind_of_name(name: str) -> str:
    """Return the kind that a room's English or German name says, "room" where it says none.

    >>> [kind_of_name(name) for name in ("hallway_3", "WC Herren", "conferenceRoom_1", "A 12")]
    ['corridor', 'toilet', 'meeting room', 'room']
    """
    words = re.findall(r"[a-zäöüß]+", name.lower())
    for kind, beginnings in _WORDS.items():
        if any(word.startswith(beginnings) for word in words):
            return kind
    return "room"
